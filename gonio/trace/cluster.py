"""Batches on other machines: the workers of a dask.distributed scheduler.

A task is one batch, and the same bits wherever it is traced (on processors of one kind: kernels are compiled for
the processor they run on). Results are added in the order of batches, so the table does not depend on how many
workers there are, nor on which of them die: the scheduler gives a lost batch to another.

A worker needs this version of gonio, and the tables that facets' materials name, under the same paths; height
maps and meshes travel with the specimen.
"""

from __future__ import annotations

import pickle
import socket
import time
from concurrent.futures import CancelledError
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.trace.batch import BatchTracer, Job
from gonio.trace.checkpoint import versions
from gonio.trace.errors import TraceError
from gonio.trace.tally import Tally
from microgeometry.errors import InputError

if TYPE_CHECKING:
    from gonio.trace.measurement import Measurement

_TIMEOUT = 10.0  # seconds to find the scheduler
_AHEAD = 2  # batches handed out for each thread of the workers


class Sums(NamedTuple):
    """What a batch leaves in `Tally.accumulators`, without the cells that nothing reached."""

    places: NDArray[np.int64]
    """Into the accumulator of cells, flat but for its last axis."""
    cells: NDArray[np.float64]
    specular: NDArray[np.float64]
    energy: NDArray[np.float64]
    ledger: NDArray[np.float64]
    facets: NDArray[np.float64] | None
    """What `gonio.trace.facets.measure_facets` found, where the estimator asks."""


class Cluster:
    """The workers of a scheduler, while they trace one measurement; a context manager.

    Parameters
    ----------
    address : str
        Of the scheduler, as tcp://host:8786.
    measurement : Measurement

    Raises
    ------
    InputError
        dask.distributed is not installed; nobody answers at the address; there are no workers; or they run another
        version.
    """

    def __init__(self, address: str, measurement: Measurement) -> None:
        try:
            import distributed
        except ImportError as error:
            raise InputError(
                "dask: the package distributed is not installed; install it with: pip install gonio[dask]"
            ) from error
        try:
            _knock(address)  # a client that finds nobody leaves threads behind
            self._client = distributed.Client(address, timeout=_TIMEOUT, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                f"dask: no scheduler answers at {address}; start one with `dask scheduler`, and give its address "
                "as tcp://host:8786"
            ) from error
        try:
            self._check_workers(address)
        except BaseException:
            self._client.close()
            raise
        for layer in measurement.specimen.layers:
            layer.surface.realise(0)  # which reads files once, and keeps what they hold
        job = pickle.dumps(measurement.job)
        # a task of its own, so that a worker that takes over where another died can have it
        self._job = self._client.submit(bytes, job, pure=False)
        self._waiting: dict[int, Any] = {}

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *_: object) -> None:
        for future in self._waiting.values():
            future.cancel(force=True)
        self._client.close()

    def add_batch(self, measurement: Measurement) -> None:
        """Wait for the next batch, add it to the measurement's tally, and hand out further ones.

        Raises
        ------
        TraceError
            The workers are gone, or one batch has killed several of them.
        """
        started = time.perf_counter()
        tally, schedule = measurement.tally, measurement.schedule
        last = min(schedule.until, tally.batches + max(1, _AHEAD * self._threads()))
        for batch in range(tally.batches, last):
            if batch not in self._waiting:
                self._waiting[batch] = self._client.submit(
                    trace_batch, self._job, batch, schedule.passes(batch), pure=False, priority=-batch
                )
        sums = self._result(tally.batches)
        with measurement.adding():
            _add(sums, tally)
            measurement.close_batch(sums.facets, started)

    def _result(self, batch: int) -> Sums:
        from distributed.scheduler import KilledWorker

        try:
            return self._waiting.pop(batch).result()
        except KilledWorker as error:
            raise TraceError(
                f"dask: batch {batch} was given to several workers and each of them died; is there enough memory?"
            ) from error
        except (CancelledError, OSError) as error:
            raise TraceError("dask: the scheduler is gone; go on with --resume once it is back") from error

    def _threads(self) -> int:
        return sum(self._client.nthreads().values())

    def _check_workers(self, address: str) -> None:
        try:
            found = self._client.run(versions)
        except Exception as error:  # whatever a worker without gonio says
            raise InputError(f"dask: a worker at {address} cannot load gonio: {error}") from error
        if not found:
            raise InputError(
                f"dask: the scheduler at {address} has no workers; start some with `dask worker`"
            )
        here = versions()
        for worker, there in found.items():
            for name, version in here.items():
                if there.get(name) != version:
                    raise InputError(
                        f"dask: worker {worker} has {name} {there.get(name)}, here it is {version}; install the same"
                    )


def _knock(address: str) -> None:
    """Raise OSError or ValueError where nobody listens at the address."""
    from distributed.comm.addressing import parse_address, parse_host_port

    _, location = parse_address(address)
    with socket.create_connection(parse_host_port(location), _TIMEOUT):
        pass


def trace_batch(job: bytes, batch: int, passes: NDArray[np.int64]) -> Sums:
    """Trace a batch on a worker.

    Parameters
    ----------
    job : bytes
        A pickled `Job`.
    batch : int
    passes : ndarray of int, shape (rows,)
    """
    tracer = _tracer(job)
    cells, specular, energy, ledger = accumulators = tracer.new_accumulators()
    facets = tracer.trace(batch, passes, accumulators, 1)
    flat = cells.reshape(-1, cells.shape[-1])
    places = np.flatnonzero(flat.any(axis=1))
    return Sums(places, flat[places], specular, energy, ledger, facets)


@lru_cache(maxsize=1)
def _tracer(job: bytes) -> BatchTracer:
    found = pickle.loads(job)
    assert isinstance(found, Job)
    return BatchTracer(found)


def _add(sums: Sums, tally: Tally) -> None:
    cells, specular, energy, ledger = tally.accumulators
    cells.reshape(-1, cells.shape[-1])[sums.places] = sums.cells
    specular[:], energy[:], ledger[:] = sums.specular, sums.energy, sums.ledger
