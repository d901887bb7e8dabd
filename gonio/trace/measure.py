"""The measurement: batches of a specimen until the budget is spent, then a table."""

from __future__ import annotations

import importlib.metadata
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import projected_solid_angles
from gonio.core.lookup import axis
from gonio.core.parallel import check_threads, for_each
from gonio.progress import Report
from gonio.table.checks import relative_noise
from gonio.table.parts import TRANSMISSION, order_names
from gonio.table.table import Table
from gonio.trace.analog import Beam, Bins, Part, Sums
from gonio.trace.errors import TraceError
from gonio.trace.tally import SheetTally, Tally
from gonio.trace.tracer import Tracer
from microgeometry.errors import InputError
from microgeometry.specimen import Specimen

MIN_BATCHES = 32
LOST_LIMIT = 1e-6
_UNITS = 32  # units of work in a batch, at least: enough for any desktop's threads to share evenly
_MAX_PACKETS = 1 << 16  # of 16 paths, per row and batch
_DEFAULT_RAYS = 20_000_000
_TRIAL_RATE = 2e6  # paths/s assumed when a time is given, to choose the size of a batch


class Measurement:
    """A specimen under the instrument.

    Call `add_batch` as often as wanted, then `table`; or let `measure` do both.

    Parameters
    ----------
    specimen : Specimen
    rays : int
        Paths planned in all; fixes the size of a batch so that at least 32 make up the plan.
    seed : int
        Everything drawn depends on it, on the batch and on the path, and on nothing else.
    threads : int, optional
        Default: one a processor. The result does not depend on it.

    Attributes
    ----------
    tracer : Tracer
        How the specimen is traced.
    tally : Tally
    seconds, trace_seconds : float
        Spent in all, and of these in the kernel.

    Raises
    ------
    InputError
        A negative or too large seed, or no rays.
    """

    def __init__(
        self, specimen: Specimen, rays: int = _DEFAULT_RAYS, seed: int = 0, threads: int | None = None
    ) -> None:
        if rays < 1:
            raise InputError(f"rays: {rays}; at least 1 is needed")
        if not 0 <= seed < 2**32:
            raise InputError(f"seed: {seed}; an integer from 0 to 4294967295 is needed")
        self.specimen = specimen
        self.seed = seed
        self._threads = check_threads(threads)
        grid = specimen.grid
        self._theta_edges = np.radians(np.linspace(0, 90, round(90 / grid.theta_step_deg) + 1))
        self._phi_edges = np.radians(np.linspace(0, 180, round(180 / grid.phi_step_deg) + 1))
        sin2_edges = np.sin(self._theta_edges) ** 2
        if grid.theta_i_deg is None:
            self._theta_i_edges: NDArray[np.float64] | None = self._theta_edges
            self._theta_i = 0.5 * (self._theta_edges[1:] + self._theta_edges[:-1])
            self._sin2 = sin2_edges[:-1], sin2_edges[1:]
        else:
            self._theta_i_edges = None
            self._theta_i = np.radians(grid.theta_i_deg)
            self._sin2 = np.sin(self._theta_i) ** 2, np.sin(self._theta_i) ** 2
        rows = len(self._theta_i)
        exponent = 0
        while 16 * rows * 2 ** (exponent + 1) * MIN_BATCHES <= rays and 2 ** (exponent + 1) <= _MAX_PACKETS:
            exponent += 1
        self._strata = 2 ** (exponent // 2), 2 ** (exponent - exponent // 2)
        self.paths_per_batch = 16 * rows * 2**exponent
        self.planned_batches = max(MIN_BATCHES, -(-rays // self.paths_per_batch))
        self.tracer = Tracer(specimen, seed, self.paths_per_batch // rows)
        self._bins = Bins(
            axis(sin2_edges), axis(-np.cos(self._phi_edges)), grid.orders, self.tracer.stack.share
        )
        self.tally = Tally(
            rows,
            (len(self._theta_edges) - 1) * (len(self._phi_edges) - 1),
            len(grid.channels),
            max(1, -(-_UNITS // rows)),
            self.tracer.hemispheres,
            grid.orders,
            self.tracer.ledger_names,
        )
        self.seconds = 0.0
        self.trace_seconds = 0.0  # of which in the kernel

    def add_batch(self) -> None:
        """Trace one more batch; on a random surface, a new realisation of it.

        Raises
        ------
        TraceError
            So many paths are lost that going on is pointless.
        """
        started = time.perf_counter()
        batch = self.tally.batches
        realisation = self.tracer.realise(batch)
        cells, specular, energy, ledger = self.tally.accumulators
        rows, chunks = cells.shape[:2]
        packets = self._strata[0] * self._strata[1]

        def trace(unit: int) -> None:
            # neighbouring rows cost alike: deal them out, chunk by chunk
            chunk, row = divmod(unit, rows)
            place = row, chunk
            beam = Beam(row, float(self._sin2[0][row]), float(self._sin2[1][row]))
            part = Part(*self._strata, chunk * packets // chunks, (chunk + 1) * packets // chunks)
            sums = Sums(cells[place], specular[place], energy[place], ledger[place])
            realisation.trace(self._bins, beam, part, batch, sums)

        tracing = time.perf_counter()
        for_each(trace, rows * chunks, self._threads)
        self.trace_seconds += time.perf_counter() - tracing
        self.tally.close_batch(self.paths_per_batch // rows, self._threads)
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
        grid = self.specimen.grid
        ledger = {n: energy for n, energy in self.tally.ledger.items() if n not in self.tracer.empty_columns}
        provenance = self._provenance()
        hemispheres = []
        for total, orders in zip(self.tally.totals, self.tally.orders, strict=True):
            parts = {
                name: self._sheet(sheet, {}, {}, {})
                for name, sheet in zip(order_names(grid.orders), orders, strict=True)
            }
            hemispheres.append((total, parts))
        transmission = {TRANSMISSION: self._sheet(*hemispheres[1], {}, {})} if len(hemispheres) > 1 else {}
        total, parts = hemispheres[0]
        table = self._sheet(total, {**transmission, **parts}, ledger, provenance)
        variance = float(np.median(relative_noise(table))) ** 2
        merit = 1.0 / (variance * self.seconds) if variance > 0 else None
        return table.replace(provenance={**table.provenance, "figure_of_merit": merit})

    def _sheet(
        self, sheet: SheetTally, parts: dict[str, Table], ledger: dict[str, float], provenance: dict[str, Any]
    ) -> Table:
        """The table of one sheet, or of a hemisphere's sum of them."""
        grid = self.specimen.grid
        omega = projected_solid_angles(self._theta_edges, self._phi_edges)
        values, std_error = sheet.cells(omega.ravel())
        shape = (len(self._theta_i), *omega.shape)
        albedo, albedo_error, specular, specular_error = sheet.rows()
        return Table(
            values=values.reshape(*shape, -1),
            std_error=std_error.reshape(*shape, -1),
            hits=sheet.hits.reshape(shape),
            theta_i=self._theta_i,
            theta_i_edges=self._theta_i_edges,
            theta_r_edges=self._theta_edges,
            delta_phi_edges=self._phi_edges,
            channels=grid.channels,
            wavelengths_nm=grid.wavelengths_nm,
            row_albedo=albedo,
            albedo_std_error=albedo_error,
            specular=specular,
            specular_std_error=specular_error,
            ledger=ledger,
            provenance=provenance,
            parts=parts,
        )

    def _check_lost(self, limit: float) -> None:
        lost, paths = self.tally.ledger["lost"], self.tally.ledger["paths"]
        if lost > max(1.0, limit * paths):
            raise TraceError(
                f"{self.specimen.name}: {lost:.0f} of {paths:.0f} paths were lost ({lost / paths:.2g}; at most "
                f"{limit:g} may be): they fell through the surface. {self._advice()}"
            )

    def _colour(self) -> dict[str, Any]:
        """What the channels are where they are sums over wavelengths."""
        grid = self.specimen.grid
        if grid.to_channels is None:
            return {}
        colour = {
            "channels": "linear sRGB, CIE 1931 2-degree observer",
            "samples_nm": grid.samples_nm,
            "to_channels": grid.to_channels,
            "luminance": grid.luminance,
        }
        return {"colour": colour}

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

    def _provenance(self) -> dict[str, Any]:
        paths = self.tally.ledger["paths"]
        surfaces = self.tracer.statistics()
        return {
            "name": self.specimen.name,
            "specimen": self.specimen.text,
            "seed": self.seed,
            "estimator": "analog",
            "batches": self.tally.batches,
            "planned_batches": self.planned_batches,
            "realisations": self.tally.batches if self.specimen.is_random else 1,
            "paths": int(paths),
            "rays": self.tally.rays,
            "seconds": self.seconds,
            "paths_per_second": paths / self.seconds,
            **self._colour(),
            "surface": surfaces[0],
            "surfaces": surfaces,
            "versions": {
                name: importlib.metadata.version(name) for name in ("gonio", "embreex", "numba", "numpy")
            },
        }


def measure(
    specimen: Specimen,
    rays: int | None = None,
    seconds: float | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: Report | None = None,
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

    Returns
    -------
    Table

    Raises
    ------
    InputError
        Both or an impossible budget.
    TraceError
        Paths were lost.
    """
    measurement = start(specimen, rays, seconds, seed, threads)
    run(measurement, seconds, progress)
    return measurement.table()


def start(
    specimen: Specimen, rays: int | None, seconds: float | None, seed: int, threads: int | None
) -> Measurement:
    """Prepare a measurement with the arguments of `measure`."""
    if rays is not None and seconds is not None:
        raise InputError("rays and time: both given; give one of them as the budget")
    if seconds is not None and not 0 < seconds < float("inf"):
        raise InputError(f"time: {seconds}; a positive number of seconds is needed")
    if seconds is not None:
        rays = max(1, int(seconds * _TRIAL_RATE))
    return Measurement(specimen, _DEFAULT_RAYS if rays is None else rays, seed, threads)


def run(measurement: Measurement, seconds: float | None, progress: Report | None) -> None:
    """Add batches until the plan, or the time, is over."""
    while True:
        measurement.add_batch()
        tally = measurement.tally
        if seconds is None:
            fraction = tally.batches / measurement.planned_batches
        else:
            fraction = measurement.seconds / seconds if tally.batches >= 2 else 0.0
        if progress is not None:
            rate = tally.ledger["paths"] / measurement.seconds / 1e6
            progress(min(1.0, fraction), f"{rate:.1f} M paths/s, albedo to {tally.albedo_error():.1e}")
        if fraction >= 1.0:
            return
