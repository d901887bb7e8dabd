"""Benchmarks: speed against error, as ratios within one run. One module each, registered here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

from microgeometry.errors import InputError

BENCHMARKS = {
    "trace": "gonio.bench.trace",
    "suite": "gonio.bench.suite",
    "materials": "gonio.bench.materials",
    "workers": "gonio.bench.workers",
    "compress": "gonio.bench.compress",
    "sample": "gonio.bench.sample",
    "peak": "gonio.bench.peak",
    "anisotropic": "gonio.bench.anisotropic",
}
"""Name to module; a module has ``run(say) -> dict``."""


def run_benchmarks(
    names: Sequence[str] = (), say: Callable[[str], None] = lambda line: None
) -> dict[str, Any]:
    """Run benchmarks by name, all by default.

    Parameters
    ----------
    names : sequence of str
    say : callable
        Called with each line of the report as it comes.

    Returns
    -------
    dict
        Name to results, plain numbers.

    Raises
    ------
    InputError
        An unknown name.
    """
    for name in names:
        if name not in BENCHMARKS:
            raise InputError(f"bench: {name!r} is not a benchmark; there are {', '.join(BENCHMARKS)}")
    return {name: import_module(BENCHMARKS[name]).run(say) for name in names or BENCHMARKS}
