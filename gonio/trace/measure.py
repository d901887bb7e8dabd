"""The measurement: batches of a specimen until the budget is spent or the target met, then a table."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gonio.core.parallel import check_threads
from gonio.interrupt import uninterrupted
from gonio.progress import Report
from gonio.table.table import Table
from gonio.trace.batch import BatchTracer, Job
from gonio.trace.checkpoint import EVERY, Checkpoint
from gonio.trace.errors import TraceError
from gonio.trace.stopping import Schedule, check_target
from gonio.trace.tabulate import tabulate
from microgeometry.errors import InputError
from microgeometry.specimen import Specimen

MIN_BATCHES = 32
LOST_LIMIT = 1e-6
_MAX_EXPONENT = 16  # of the packets of 16 paths, per row and batch
_DEFAULT_RAYS = 20_000_000
_ROUNDS = 4  # with a target, the batches before the first decision take such a part of the budget
_TRIAL_RATE = 2e6  # paths/s assumed when a time is given, to choose the size of a batch


class Measurement:
    """A specimen under the instrument.

    Call `add_batch` as often as wanted, then `table`; or let `measure` do both.

    Parameters
    ----------
    specimen : Specimen
    rays : int, optional
        Paths planned in all; fixes the size of a batch so that at least 32 make up the plan. Default 20
        million, or with a target as many as it needs.
    seed : int
        Everything drawn depends on it, on the batch and on the path, and on nothing else.
    threads : int, optional
        Default: one a processor. The result does not depend on it.
    target_error : float, optional
        Relative standard error at which to stop; see `gonio.trace.stopping`.
    seconds : float, optional
        Time planned; only to choose the size of a batch.

    Attributes
    ----------
    job : Job
    batches : BatchTracer
    tracer : Tracer
        How the specimen is traced.
    traced_all : bool
        All batches, that is: none by others or by a process before.
    tally : Tally
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
        A negative or too large seed, no rays, or an impossible target.
    """

    def __init__(
        self,
        specimen: Specimen,
        rays: int | None = None,
        seed: int = 0,
        threads: int | None = None,
        target_error: float | None = None,
        seconds: float | None = None,
    ) -> None:
        if rays is not None and rays < 1:
            raise InputError(f"rays: {rays}; at least 1 is needed")
        if not 0 <= seed < 2**32:
            raise InputError(f"seed: {seed}; an integer from 0 to 4294967295 is needed")
        self.specimen = specimen
        self.target_error = None if target_error is None else check_target(target_error)
        self.plan = {
            "seed": seed,
            "rays": rays,
            "time": seconds,
            "target error": target_error,
            "estimator": "analog",
        }
        self.threads = check_threads(threads)
        bounded = rays is not None or (seconds is None and target_error is None)
        if rays is None:
            rays = _DEFAULT_RAYS if seconds is None else max(1, int(seconds * _TRIAL_RATE))
        grid = specimen.grid
        rows = round(90 / grid.theta_step_deg) if grid.theta_i_deg is None else len(grid.theta_i_deg)
        # decisions fall between batches: with a target there are more of them, and of a large budget no larger ones
        share = rays if target_error is None else min(rays, _DEFAULT_RAYS) // _ROUNDS
        exponent = 0
        while 16 * rows * 2 ** (exponent + 1) * MIN_BATCHES <= share and exponent < _MAX_EXPONENT:
            exponent += 1
        self.job = Job(specimen, seed, exponent)
        self.batches = BatchTracer(self.job)
        self.tracer = self.batches.tracer
        self.paths_per_batch = rows * self.batches.paths_per_pass
        self.planned_batches = max(MIN_BATCHES, -(-rays // self.paths_per_batch)) if bounded else None
        self.tally = self.batches.new_tally()
        self.schedule = Schedule(rows, self.batches.paths_per_pass, self.planned_batches, self.target_error)
        self.seconds = 0.0
        self.traced_all = True
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
            self.batches.trace(
                self.tally.batches, self.schedule.passes, self.tally.accumulators, self.threads
            )
            self.close_batch(started)

    @contextmanager
    def adding(self) -> Iterator[None]:
        """Around what fills the tally's accumulators and closes a batch: left half done, none may follow."""
        if self._half_done:
            raise TraceError("a batch was interrupted and left half done: take the table, or start anew")
        self._half_done = True
        yield
        self._half_done = False

    def close_batch(self, started: float) -> None:
        """Take what is in the tally's accumulators as the next batch, begun at `started` (perf_counter).

        Raises
        ------
        TraceError
            So many paths are lost that going on is pointless.
        """
        with uninterrupted():
            self.tally.close_batch(self.schedule.passes, self.batches.paths_per_pass, self.threads)
            self.schedule.advance(self.tally, self.batches.areas)
            self.seconds += time.perf_counter() - started
        self._check_lost(1e-3)

    def table(self) -> Table:
        """The table of all batches so far.

        Raises
        ------
        TraceError
            No batch yet, or more than one path in a million was lost.
        """
        if self.tally.batches == 0:
            raise TraceError("no batch was traced yet: there is no table; trace at least one")
        self._check_lost(LOST_LIMIT)
        return tabulate(self)

    def state(self) -> dict[str, NDArray]:
        """Everything learned so far, as arrays by name."""
        tally = {f"tally.{name}": array for name, array in self.tally.state().items()}
        schedule = {f"schedule.{name}": array for name, array in self.schedule.state().items()}
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
        self.seconds = float(state["seconds"])
        self.traced_all = False

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


class Workers(Protocol):
    """Others who trace batches; see `gonio.trace.cluster`."""

    def add_batch(self, measurement: Measurement) -> None:
        """Trace the next batch of a measurement and add it."""
        ...


def measure(
    specimen: Specimen,
    rays: int | None = None,
    seconds: float | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: Report | None = None,
    target_error: float | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    every: float = EVERY,
    resume: bool = False,
    dask: str | None = None,
) -> Table:
    """Trace a specimen to a table.

    Parameters
    ----------
    specimen : Specimen
        From `microgeometry.specimen.load_specimen`.
    rays : int, optional
        Paths to trace, over all rows; rounded up to whole batches, at least 32. Default 20 million.
    seconds : float, optional
        Trace for that long instead (and at least two batches).
    seed, threads : int, optional
        The result is the same for any number of threads.
    progress : callable, optional
        Called after every batch.
    target_error : float, optional
        Stop as soon as the relative standard error of the cells that hold 99 % of the light is below this
        (95th percentile, in every row) and that of the albedo below a tenth of it; or when `rays` or
        `seconds` are spent. The table's provenance says ``target_met``.
    checkpoint : path, optional
        The file the table will be written to: what was traced is kept beside it, in <checkpoint>.checkpoint,
        until the measurement is complete.
    every : float, optional
        Seconds between checkpoints; 0: none.
    resume : bool, optional
        Go on from there, if there is one: the table is the same bit for bit.
    dask : str, optional
        Address of a dask.distributed scheduler whose workers trace the batches; the result is the same.

    Returns
    -------
    Table

    Raises
    ------
    InputError
        Both or an impossible budget; an unfinished measurement that is another or not to be resumed; no
        scheduler at the address.
    TraceError
        Paths were lost.
    """
    measurement = start(specimen, rays, seconds, seed, threads, target_error)
    keeper = None
    if checkpoint is not None:
        keeper = Checkpoint(checkpoint, measurement, every)
        keeper.begin(resume)
    elif resume:
        raise InputError("resume: needs `checkpoint`, the file the table will be written to")
    run(measurement, seconds, progress, keeper, dask)
    table = measurement.table()
    if keeper is not None:
        keeper.remove()
    return table


def start(
    specimen: Specimen,
    rays: int | None,
    seconds: float | None,
    seed: int,
    threads: int | None,
    target_error: float | None = None,
) -> Measurement:
    """Prepare a measurement with the arguments of `measure`."""
    if rays is not None and seconds is not None:
        raise InputError("rays and time: both given; give one of them as the budget")
    if seconds is not None and not 0 < seconds < float("inf"):
        raise InputError(f"time: {seconds}; a positive number of seconds is needed")
    return Measurement(specimen, rays, seed, threads, target_error, seconds)


def run(
    measurement: Measurement,
    seconds: float | None,
    progress: Report | None,
    checkpoint: Checkpoint | None = None,
    dask: str | None = None,
) -> None:
    """Add batches until the plan, the time or the target is reached; arguments as `measure`."""
    if dask is None:
        _run(measurement, seconds, progress, checkpoint, None)
        return
    from gonio.trace.cluster import Cluster  # imports an optional package

    with Cluster(dask, measurement) as workers:
        _run(measurement, seconds, progress, checkpoint, workers)


def _run(
    measurement: Measurement,
    seconds: float | None,
    progress: Report | None,
    checkpoint: Checkpoint | None,
    workers: Workers | None,
) -> None:
    tally, schedule = measurement.tally, measurement.schedule
    while not (
        schedule.over or (seconds is not None and measurement.seconds >= seconds and tally.batches >= 2)
    ):
        if workers is None:
            measurement.add_batch()
        else:
            workers.add_batch(measurement)
        if checkpoint is not None:
            with uninterrupted():
                checkpoint.save_if_due()
        if progress is not None:
            rate = tally.ledger["paths"] / measurement.seconds / 1e6
            fraction = _fraction(measurement, seconds)
            progress(fraction, f"{rate:.1f} M paths/s, albedo to {tally.albedo_error():.1e}")


def _fraction(measurement: Measurement, seconds: float | None) -> float:
    """How much of the measurement is done, as far as is known."""
    tally, schedule = measurement.tally, measurement.schedule
    fractions = [0.0]
    if measurement.planned_batches is not None:
        fractions.append(tally.batches / measurement.planned_batches)
    if seconds is not None:
        fractions.append(measurement.seconds / seconds)
    if schedule.goal:
        fractions.append(tally.ledger["paths"] / schedule.goal)
    return 1.0 if schedule.over else min(1.0, max(fractions))
