"""Threads: every unit once, results in order, failures and interruptions passed on."""

from __future__ import annotations

import threading

import pytest

from gonio.core.parallel import check_threads, for_each, processors
from microgeometry.errors import InputError


@pytest.mark.parametrize("threads", [1, 2, 8, None])
def test_every_unit_once_and_in_order(threads):
    seen = []
    assert for_each(lambda unit: seen.append(unit) or unit**2, 20, threads) == [u**2 for u in range(20)]
    assert sorted(seen) == list(range(20))


@pytest.mark.compiled
def test_two_threads_really_work_at_once():
    barrier = threading.Barrier(2, timeout=60)  # passes only if both tasks stand before it together
    for_each(lambda unit: barrier.wait(), 2, 2)


@pytest.mark.parametrize("failure", [ValueError, KeyboardInterrupt])
def test_failure_is_passed_on_and_the_rest_not_begun(failure):
    seen = []
    stopped = threading.Event()

    def task(unit):
        if unit == 0:
            stopped.set()
            raise failure
        stopped.wait()
        seen.append(unit)

    with pytest.raises(failure):
        for_each(task, 10_000, 2)
    assert len(seen) < 10_000


def test_number_of_threads():
    assert check_threads(None) == processors() >= 1
    assert check_threads(3) == 3
    with pytest.raises(InputError, match="threads: 0; at least 1"):
        check_threads(0)
