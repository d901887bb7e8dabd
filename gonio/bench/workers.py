"""`gonio bench workers`: what the workers of a dask scheduler add, one a processor, against one of them.

The same measurement by one thread here, by as many threads as there are processors, by one worker of a cluster
on this machine, and by one worker a processor. The tables are the same bits; that they are is checked. Batches are
shared, the final table is not: how much that is shows in the rates of the batches alone.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from gonio.core.parallel import processors
from gonio.table.table import Table
from gonio.trace.measure import measure
from microgeometry.specimen import Specimen, parse_specimen

_GOLD = {
    "surface": {"kind": "gaussian", "alpha": 0.5},
    "material": {"kind": "conductor", "name": "Au"},
    "grid": {"channels": "rgb"},
}
_SPECIMENS: dict[str, tuple[dict[str, Any], int]] = {
    f"rough gold, 1-degree table, {millions} M": (_GOLD, millions * 1_000_000) for millions in (20, 60)
}


def run(say: Callable[[str], None]) -> dict[str, Any]:
    """Measure; returns paths/s by who traced: of the whole measurement, and of its batches alone."""
    try:
        import distributed  # noqa: F401
    except ImportError:
        say("workers: the package distributed is not installed: pip install gonio[dask]")
        return {}
    results: dict[str, Any] = {}
    say(
        f"{'specimen':32} {'traced by':>12} {'M paths/s':>10} {'of one worker':>14} {'batches alone':>14} "
        f"{'of one worker':>14}"
    )
    for name, (mapping, rays) in _SPECIMENS.items():
        results[name] = rates = _rates(parse_specimen(mapping), rays)
        for who, (whole, batches) in rates.items():
            one = rates["1 worker"]
            say(
                f"{name:32} {who:>12} {whole / 1e6:10.2f} {whole / one[0]:14.2f} {batches / 1e6:14.2f} "
                f"{batches / one[1]:14.2f}"
            )
    return results


def _rates(specimen: Specimen, rays: int) -> dict[str, tuple[float, float]]:
    """Paths per second of the wall clock, for everyone who may trace."""
    many = processors()
    rates: dict[str, tuple[float, float]] = {}
    measure(specimen, rays=1)  # loads kernels
    tables = [
        _timed(rates, "1 thread", specimen, rays, threads=1),
        _timed(rates, f"{many} threads", specimen, rays, threads=many),
        *(_with_workers(rates, workers, specimen, rays) for workers in (1, many)),
    ]
    if not all(np.array_equal(tables[0].values, table.values) for table in tables):
        raise AssertionError("the table depends on who traced it")
    return rates


def _with_workers(
    rates: dict[str, tuple[float, float]], workers: int, specimen: Specimen, rays: int
) -> Table:
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        dashboard_address=None,
        protocol="tcp",
        silence_logs=logging.CRITICAL,
    ) as cluster:
        address = cluster.scheduler_address
        measure(specimen, rays=1, dask=address)  # loads kernels
        who = "1 worker" if workers == 1 else f"{workers} workers"
        return _timed(rates, who, specimen, rays, dask=address)


def _timed(
    rates: dict[str, tuple[float, float]], who: str, specimen: Specimen, rays: int, **options: Any
) -> Table:
    started = time.perf_counter()
    table = measure(specimen, rays=rays, **options)
    paths = table.ledger["paths"]
    rates[who] = paths / (time.perf_counter() - started), paths / table.provenance["seconds"]
    return table
