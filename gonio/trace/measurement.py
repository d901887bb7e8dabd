"""A specimen under the instrument: batch after batch, and a table of them at any time."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.core.parallel import check_threads
from gonio.interrupt import uninterrupted
from gonio.trace.batch import BatchTracer, Job
from gonio.trace.combine import combine
from gonio.trace.errors import TraceError
from gonio.trace.estimators import HALF_VECTOR, NEXT_EVENT, choose
from gonio.trace.next_event_cells import JoinedSheet
from gonio.trace.sheets import Sheet
from gonio.trace.stopping import Schedule, Verdict, check_target, judge
from gonio.trace.tabulate import tabulate
from microgeometry.errors import InputError
from microgeometry.specimen import Specimen

MIN_BATCHES = 32
LOST_LIMIT = 1e-6
_MAX_EXPONENT = 16  # of the packets of 16 paths, per row and batch
# A path of next-event estimates is joined to hundreds of detectors: it takes longer, and tells as much as many.
_DEFAULT_RAYS, _NEXT_EVENT_RAYS = 20_000_000, 2_000_000
_ROUNDS = 4  # with a target, the batches before the first decision take such a part of the budget
# paths/s assumed when a time is given, to choose the size of a batch
_TRIAL_RATE, _NEXT_EVENT_RATE = 2e6, 2e5


class Measurement:
    """A specimen under the instrument.

    Call `add_batch` as often as wanted, then `table`; or let `measure` do both.

    Parameters
    ----------
    specimen : Specimen
    rays : int, optional
        Paths planned in all; fixes the size of a batch so that at least 32 make up the plan. Default 20
        million (2 million of next-event estimates), or with a target as many as it needs.
    seed : int
        Everything drawn depends on it, on the batch and on the path, and on nothing else.
    threads : int, optional
        Default: one a processor. The result does not depend on it.
    target_error : float, optional
        Relative standard error at which to stop; see `gonio.trace.stopping`.
    seconds : float, optional
        Time planned; only to choose the size of a batch.
    estimator : str, optional
        One of `gonio.trace.estimators.ESTIMATORS`; default: the best that applies.

    Attributes
    ----------
    job : Job
    batches : BatchTracer
    tracer : Tracer
        How the specimen is traced.
    tally : Tally
        Of the paths binned.
    half_vector : HalfVector or None
        Of single bounces, where these are not taken from the paths.
    averages : bool
        Whether tables are averaged by reciprocity (`gonio.trace.reciprocal`): unless told which estimator.
    schedule : Schedule
    plan : dict
        The arguments that the result depends on.
    paths_per_batch : int
    planned_batches : int or None
        At most so many; None: as many as the target needs.
    seconds, trace_seconds : float
        Spent in all, and of these in the kernel.

    Raises
    ------
    InputError
        A negative or too large seed, no rays, an impossible target, or an estimator that does not apply.
    """

    def __init__(
        self,
        specimen: Specimen,
        rays: int | None = None,
        seed: int = 0,
        threads: int | None = None,
        target_error: float | None = None,
        seconds: float | None = None,
        estimator: str | None = None,
    ) -> None:
        if rays is not None and rays < 1:
            raise InputError(f"rays: {rays}; at least 1 is needed")
        if not 0 <= seed < 2**32:
            raise InputError(f"seed: {seed}; an integer from 0 to 4294967295 is needed")
        self.specimen = specimen
        self.target_error = None if target_error is None else check_target(target_error)
        told = estimator is not None
        estimator = choose(specimen, seed, estimator)
        self.averages = not told and estimator != HALF_VECTOR
        self.plan = {
            "seed": seed,
            "rays": rays,
            "time": seconds,
            "target error": target_error,
            "estimator": estimator,
            "averages": self.averages,
        }
        self.threads = check_threads(threads)
        bounded = rays is not None or (seconds is None and target_error is None)
        joins = estimator == NEXT_EVENT
        usual, rate = (_NEXT_EVENT_RAYS, _NEXT_EVENT_RATE) if joins else (_DEFAULT_RAYS, _TRIAL_RATE)
        if rays is None:
            rays = usual if seconds is None else max(1, int(seconds * rate))
        rows = specimen.grid.n_rows
        # decisions fall between batches: with a target there are more of them, and of a large budget no larger ones
        share = rays if target_error is None else min(rays, usual) // _ROUNDS
        exponent = 0
        while 16 * rows * 2 ** (exponent + 1) * MIN_BATCHES <= share and exponent < _MAX_EXPONENT:
            exponent += 1
        self.job = Job(specimen, seed, exponent, estimator)
        self.batches = BatchTracer(self.job)
        self.tracer = self.batches.tracer
        self.paths_per_batch = rows * self.batches.paths_per_pass
        self.planned_batches = max(MIN_BATCHES, -(-rays // self.paths_per_batch)) if bounded else None
        self.tally = self.batches.new_tally()
        self.half_vector = self.batches.new_half_vector()
        self.schedule = Schedule(rows, self.batches.paths_per_pass, self.planned_batches, self.target_error)
        self.seconds = 0.0
        self._half_done = False

    @property
    def trace_seconds(self) -> float:
        """Seconds spent in the kernel, by this process."""
        return self.batches.seconds

    def add_batch(self) -> None:
        """Trace one more batch; on a random surface, a new realisation of it.

        Raises
        ------
        TraceError
            So many paths are lost that going on is pointless, or a batch before was interrupted.
        """
        started = time.perf_counter()
        with self.adding():
            batch = self.tally.batches
            passes = self.schedule.passes(batch)
            facets = self.batches.trace(batch, passes, self.tally.accumulators, self.threads)
            self.close_batch(facets, started)

    @contextmanager
    def adding(self) -> Iterator[None]:
        """Around what fills the tally's accumulators and closes a batch: left half done, none may follow."""
        if self._half_done:
            raise TraceError("a batch was interrupted and left half done: take the table, or start anew")
        self._half_done = True
        yield
        self._half_done = False

    def close_batch(self, facets: NDArray[np.float64] | None, started: float) -> None:
        """Take what is in the tally's accumulators, and `facets`, as the next batch, begun at `started`.

        Raises
        ------
        TraceError
            So many paths are lost that going on is pointless.
        """
        with uninterrupted():
            passes = self.schedule.passes(self.tally.batches)
            self.tally.close_batch(passes, self.batches.paths_per_pass, self.threads)
            if self.half_vector is not None:
                assert facets is not None  # measured with every batch
                self.half_vector.add(facets)
            self.schedule.advance(self.tally, self.judge)
            self.seconds += time.perf_counter() - started
        self._check_lost(1e-3)

    def table(self) -> Any:
        """The table of all batches so far; an `AnisotropicTable` where [grid] asks for one.

        Raises
        ------
        TraceError
            No batch yet, or more than one path in a million was lost.
        """
        if self.tally.batches == 0:
            raise TraceError("no batch was traced yet: there is no table; trace at least one")
        self._check_lost(LOST_LIMIT)
        return tabulate(self)

    def light(self) -> tuple[list[Sheet], list[list[Sheet]]]:
        """What is known so far: all light of each hemisphere, and for each its orders as in `Tally.orders`."""
        if self.job.estimator == NEXT_EVENT:
            even = self.batches.looks is not None
            joined = [[JoinedSheet(sheet, even) for sheet in sheets] for sheets in self.tally.orders]
            pairs = zip(self.tally.totals, joined, strict=True)
            totals: list[Sheet] = [JoinedSheet(total, even, sheets) for total, sheets in pairs]
            return totals, [list(sheets) for sheets in joined]
        if self.half_vector is None:
            return list(self.tally.totals), [list(orders) for orders in self.tally.orders]
        total, orders = combine(self.half_vector, self.tally, self.batches, self.threads)
        return [total], [orders]

    def judge(self) -> Verdict:
        """How well it is known."""
        peak = None if self.batches.peak is None else self.batches.peak.areas
        return judge(self.light()[0], self.tally.rows, self.batches.areas, peak)

    def state(self) -> dict[str, NDArray]:
        """Everything learned so far, as arrays by name."""
        tally = {f"tally.{name}": array for name, array in self.tally.state().items()}
        schedule = {f"schedule.{name}": array for name, array in self.schedule.state().items()}
        if self.half_vector is not None:
            schedule |= {f"half_vector.{name}": a for name, a in self.half_vector.state().items()}
        return {**tally, **schedule, "seconds": np.array(self.seconds)}

    def restore(self, state: dict[str, NDArray]) -> None:
        """Go on from a `state` of a measurement with the same arguments.

        Raises
        ------
        ValueError, KeyError
            Something in it is missing or of another shape.
        """

        def part(prefix: str) -> dict[str, NDArray]:
            return {n.removeprefix(prefix): a for n, a in state.items() if n.startswith(prefix)}

        self.schedule.restore(part("schedule."))
        self.tally.restore(part("tally."))
        if self.half_vector is not None:
            self.half_vector.restore(part("half_vector."))
        self.seconds = float(state["seconds"])

    def _check_lost(self, limit: float) -> None:
        lost, paths = self.tally.ledger["lost"], self.tally.ledger["paths"]
        if lost > max(1.0, limit * paths):
            raise TraceError(
                f"{self.specimen.name}: {lost:.0f} of {paths:.0f} paths were lost ({lost / paths:.2g}; at most "
                f"{limit:g} may be): they fell through the surface. {self._advice()}"
            )

    def _advice(self) -> str:
        if len(self.specimen.layers) > 1:
            return (
                "Two layers cut through each other, or a mesh is not closed; give the medium between the layers "
                "more thickness, or close the mesh"
            )
        return (
            "The mesh has holes, a rim that does not meet the opposite one, or faces wound clockwise seen from "
            'outside; close it, tile it by mirroring (tiling = "mirror"), or turn its faces over'
        )
