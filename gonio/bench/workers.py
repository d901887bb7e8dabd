"""`gonio bench workers`: what the workers of a dask scheduler add, one a processor, against one of them.

The same measurement by one thread here, by as many threads as there are processors, by one worker of a cluster
on this machine, and by one worker a processor. The tables are the same bits; that they are is checked.
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

_REPEATS = 2  # the fastest counts: whatever else the machine does only slows
_GOLD = {"surface": {"kind": "gaussian", "alpha": 0.5}, "material": {"kind": "conductor", "name": "Au"}}
_SPECIMENS: dict[str, tuple[dict[str, Any], int]] = {
    "rough gold, 1-degree RGB table": ({**_GOLD, "grid": {"channels": "rgb"}}, 5_000_000),
    "rough gold, 5-degree RGB table": (
        {**_GOLD, "grid": {"channels": "rgb", "theta_step_deg": 5, "phi_step_deg": 5}},
        4_000_000,
    ),
}


def run(say: Callable[[str], None]) -> dict[str, Any]:
    """Measure; returns paths/s by who traced, and the ratio of all workers to one."""
    try:
        import distributed  # noqa: F401
    except ImportError:
        say("workers: the package distributed is not installed: pip install gonio[dask]")
        return {}
    results: dict[str, Any] = {}
    say(f"{'specimen':32} {'traced by':>12} {'M paths/s':>10} {'of one worker':>14}")
    for name, (mapping, rays) in _SPECIMENS.items():
        results[name] = rates = _rates(parse_specimen(mapping), rays)
        for who, rate in rates.items():
            say(f"{name:32} {who:>12} {rate / 1e6:10.2f} {rate / rates['1 worker']:14.2f}")
    return results


def _rates(specimen: Specimen, rays: int) -> dict[str, float]:
    """Paths per second of the wall clock, for everyone who may trace."""
    many = processors()
    rates: dict[str, float] = {}
    for _ in range(_REPEATS):
        tables = [
            _timed(rates, "1 thread", specimen, rays, threads=1),
            _timed(rates, f"{many} threads", specimen, rays, threads=many),
            *(_with_workers(rates, workers, specimen, rays) for workers in (1, many)),
        ]
        if not all(np.array_equal(tables[0].values, table.values) for table in tables):
            raise AssertionError("the table depends on who traced it")
    return rates


def _with_workers(rates: dict[str, float], workers: int, specimen: Specimen, rays: int) -> Table:
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


def _timed(rates: dict[str, float], who: str, specimen: Specimen, rays: int, **options: Any) -> Table:
    started = time.perf_counter()
    table = measure(specimen, rays=rays, **options)
    rate = table.ledger["paths"] / (time.perf_counter() - started)
    rates[who] = max(rates.get(who, 0.0), rate)
    return table
