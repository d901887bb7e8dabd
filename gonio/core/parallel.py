"""Threads: kernels run without the interpreter's lock, so plain Python threads share their work.

Work is cut into units that do not depend on the number of threads, each with places of its own to write
to; so results are the same bits for any number of them. numba's own parallel loops would do the same, but
take half as long again to compile, and their OpenMP threads spin for each other where the machine is shared.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import TypeVar

from gonio.core import jit
from microgeometry.errors import InputError

Result = TypeVar("Result")


def processors() -> int:
    """Processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def check_threads(threads: int | None) -> int:
    """The number of threads to use: `threads`, or one a processor.

    Raises
    ------
    InputError
        Less than 1.
    """
    if threads is None:
        return processors()
    if threads < 1:
        raise InputError(f"threads: {threads}; at least 1 is needed")
    return threads


def for_each(task: Callable[[int], Result], units: int, threads: int | None = None) -> list[Result]:
    """Run task(0) ... task(units - 1) on threads.

    Parameters
    ----------
    task : callable
        Calls a kernel; writes only to places of its own unit.
    units : int
    threads : int, optional
        Default: one a processor.

    Returns
    -------
    list
        What the tasks returned, in the order of units.
    """
    threads = check_threads(threads)
    if threads == 1 or units == 1 or jit.disabled:
        return [task(unit) for unit in range(units)]
    futures = [_pool(threads).submit(task, unit) for unit in range(units)]
    try:
        return [future.result() for future in futures]
    except BaseException:  # Ctrl-C too: what has not begun never will
        for future in futures:
            future.cancel()
        raise


@lru_cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="gonio")
