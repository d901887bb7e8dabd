"""The measurement: batches of a specimen until the budget is spent or the target met, then a table."""

from __future__ import annotations

import os
from typing import Any, Protocol

from gonio.interrupt import uninterrupted
from gonio.progress import Report
from gonio.trace.checkpoint import EVERY, Checkpoint
from gonio.trace.measurement import Measurement
from microgeometry.errors import InputError
from microgeometry.specimen import Specimen


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
    estimator: str | None = None,
) -> Any:
    """Trace a specimen to a table.

    Parameters
    ----------
    specimen : Specimen
        From `microgeometry.specimen.load_specimen`.
    rays : int, optional
        Paths to trace, over all rows; rounded up to whole batches, at least 32. Default 20 million, or
        2 million of next-event estimates.
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
    estimator : str, optional
        One of `gonio.trace.estimators.ESTIMATORS`; default: the best that applies.

    Returns
    -------
    Table or AnisotropicTable
        The latter where [grid] has anisotropic = true.

    Raises
    ------
    InputError
        Both or an impossible budget; an unfinished measurement that is another or not to be resumed; no
        scheduler at the address.
    TraceError
        Paths were lost.
    """
    measurement = start(specimen, rays, seconds, seed, threads, target_error, estimator)
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
    estimator: str | None = None,
) -> Measurement:
    """Prepare a measurement with the arguments of `measure`."""
    if rays is not None and seconds is not None:
        raise InputError("rays and time: both given; give one of them as the budget")
    if seconds is not None and not 0 < seconds < float("inf"):
        raise InputError(f"time: {seconds}; a positive number of seconds is needed")
    return Measurement(specimen, rays, seed, threads, target_error, seconds, estimator)


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
