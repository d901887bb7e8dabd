"""Batches of a specimen: the same sums for the same specimen, seed, size, batch and passes, wherever traced."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import projected_solid_angles
from gonio.core.lookup import axis
from gonio.core.parallel import for_each
from gonio.table.tilts import slope_widths
from gonio.trace.analog import Beam, Part
from gonio.trace.anisotropic import AnisotropicLayout
from gonio.trace.binning import RAYS, Bins, Sums
from gonio.trace.estimators import ANALOG, FEW_FACETS, HALF_VECTOR, NEXT_EVENT, roughness
from gonio.trace.facets import measure_facets
from gonio.trace.half_vector import HalfVector
from gonio.trace.next_event import LambertLooks
from gonio.trace.peak_grid import peak_grid
from gonio.trace.remainder import block_size
from gonio.trace.stack_looks import LOOKS
from gonio.trace.tally import Tally, new_accumulators
from gonio.trace.tracer import Surface, Tracer
from microgeometry.specimen import Specimen
from microgeometry.tile import HeightField

Array = NDArray[np.float64]

MAX_PASSES = 255
"""Of one row in a batch."""

_BATCHES = (
    1 << 24
)  # a pass is a batch of its own to the random numbers: pass p of batch b is b + p * _BATCHES
_UNITS = 16  # units of work in a batch, at least: enough for any desktop's threads to share evenly


@dataclass(frozen=True)
class Job:
    """What fixes every bit of a batch, but for its number and passes.

    Attributes
    ----------
    specimen : Specimen
    seed : int
    exponent : int
        A pass is 16 * 2**exponent paths.
    estimator : str
        One of `gonio.trace.estimators`.
    """

    specimen: Specimen
    seed: int
    exponent: int
    estimator: str = ANALOG


class BatchTracer:
    """Traces batches of a job.

    Parameters
    ----------
    job : Job

    Attributes
    ----------
    theta_i, theta_i_edges, theta_edges, phi_edges : ndarray
        As in `gonio.table.table.Table`; theta_i_edges may be None.
    areas : ndarray, shape (rings, sectors)
        Projected solid angles of the table's cells, sr.
    bin_theta_edges, bin_phi_edges, bin_areas : ndarray
        The same of the cells that paths are binned in: larger ones, where they carry smooth light only.
    peak : PeakGrid or None
        Where the highlight has a grid of its own, whose cells follow the others in each row.
    alpha : float or None
        Roughness, where facets are measured for the half-vector estimator.
    looks : LambertLooks or None
        What fills the cells of a Lambertian surface, where the estimator is next-event.
    paths_per_pass : int
    tracer : Tracer
        How the specimen is traced.
    seconds : float
        Spent in the kernel.
    """

    def __init__(self, job: Job) -> None:
        self.job = job
        grid = job.specimen.grid
        self.theta_edges = np.radians(np.linspace(0, 90, round(90 / grid.theta_step_deg) + 1))
        self.phi_edges = np.radians(np.linspace(0, 180, round(180 / grid.phi_step_deg) + 1))
        self.areas = projected_solid_angles(self.theta_edges, self.phi_edges)
        sin2_edges = np.sin(self.theta_edges) ** 2
        if grid.theta_i_deg is None:
            self.theta_i_edges: Array | None = self.theta_edges
            self.theta_i = 0.5 * (self.theta_edges[1:] + self.theta_edges[:-1])
            self._sin2 = sin2_edges[:-1], sin2_edges[1:]
        else:
            self.theta_i_edges = None
            self.theta_i = np.radians(grid.theta_i_deg)
            self._sin2 = np.sin(self.theta_i) ** 2, np.sin(self.theta_i) ** 2
        self.seconds = 0.0
        self.anisotropic: AnisotropicLayout | None = None
        self._strata = 2 ** (job.exponent // 2), 2 ** (job.exponent - job.exponent // 2)
        self.paths_per_pass = 16 * 2**job.exponent
        looks = LOOKS if job.estimator == NEXT_EVENT else None
        on_net = job.estimator == FEW_FACETS
        self.tracer = Tracer(job.specimen, job.seed, self.paths_per_pass, len(self.theta_i), looks, on_net)
        self.alpha = roughness(self.tracer) if job.estimator == HALF_VECTOR else None
        self._orders = grid.orders if self.alpha is None else max(2, grid.orders)
        merged = (1, 1) if self.alpha is None else block_size(self.alpha, *self.areas.shape)
        self.bin_theta_edges, self.bin_phi_edges = (
            self.theta_edges[:: merged[0]],
            self.phi_edges[:: merged[1]],
        )
        self.bin_areas = projected_solid_angles(self.bin_theta_edges, self.bin_phi_edges)
        self._azimuths = np.full(len(self.theta_i), np.nan)
        edges = np.sin(self.bin_theta_edges) ** 2, -np.cos(self.bin_phi_edges)
        self.peak = None
        if grid.anisotropic:
            self.anisotropic = AnisotropicLayout(job.specimen, self.tracer)
            self.theta_i, self._azimuths = self.anisotropic.theta_i, self.anisotropic.phi_i
            self._sin2 = np.sin(self.theta_i) ** 2, np.sin(self.theta_i) ** 2
            edges = self.anisotropic.x_edges, self.anisotropic.y_edges
            # cells are no boxes in angle: energies are counted, in units of 1 sr
            self.areas = self.bin_areas = np.ones((self.anisotropic.cells, self.anisotropic.cells))
        elif job.estimator != NEXT_EVENT:
            self.peak = peak_grid(job.specimen, self.tracer)
        slope_edges, psi_edges = self.peak or (np.array([0.0, 1.0]), np.array([0.0, np.pi]))
        self._bins = Bins(
            axis(edges[0]),
            axis(edges[1]),
            axis(slope_edges),
            axis(-np.cos(psi_edges)),
            self.bin_areas.size if self.peak else -1,
            self._orders,
            self.tracer.stack.share,
            (0.0, 0.0) if self.anisotropic is None else slope_widths(*edges),
        )
        self.looks: LambertLooks | None = None
        if looks is not None and self.tracer.optics is not None:
            assert self.tracer.optics.albedo is not None  # `gonio.trace.estimators.choose`
            self.looks = LambertLooks(
                self.tracer.optics.albedo, self.tracer.to_channels, self._orders, self.theta_i,
                self.theta_i_edges, self.theta_edges, self.areas.shape[1], job.seed,
            )  # fmt: skip
            # paths are counted, but in no cell
            self._bins = self._bins._replace(theta=axis([0.0, 1.0]), phi=axis([-1.0, 1.0]))

    def new_tally(self) -> Tally:
        """An empty tally of this job's table."""
        return Tally(
            *self._shape(),
            self.tracer.hemispheres,
            self._orders,
            self.tracer.ledger_names,
            joint=self.job.estimator == NEXT_EVENT,
        )

    def new_half_vector(self) -> HalfVector | None:
        """Empty sums of single bounces, where the estimator has them."""
        if self.alpha is None:
            return None
        assert self.tracer.optics is not None  # `gonio.trace.estimators.choose`
        samples = self.job.specimen.grid.n_samples
        return HalfVector(self.tracer.optics, self.tracer.to_channels, samples, self.alpha)

    def new_accumulators(self) -> tuple[Array, ...]:
        """Empty accumulators for `trace`, as those of `new_tally`."""
        sheets = self.tracer.hemispheres * self._orders
        return new_accumulators(*self._shape(), sheets, len(self.tracer.ledger_names))

    def _shape(self) -> tuple[int, int, int, int]:
        """Rows, cells, channels and chunks."""
        rows = len(self.theta_i)
        channels = len(self.job.specimen.grid.channels)
        cells = self.bin_areas.size + (self.peak.areas.size if self.peak else 0)
        return rows, cells, channels, max(1, -(-_UNITS // rows))

    def trace(
        self, batch: int, passes: NDArray[np.int64], accumulators: tuple[Array, ...], threads: int
    ) -> Array | None:
        """Trace a batch; on a random surface, a realisation of its own.

        Returns what `gonio.trace.facets.measure_facets` finds on it where `alpha` is given, else None.

        Parameters
        ----------
        batch : int
        passes : ndarray of int, shape (rows,)
            Of each row, at most MAX_PASSES, and in all as many as there are rows.
        accumulators : tuple of ndarray
            `Tally.accumulators`, all 0; added to.
        threads : int
            The sums do not depend on it.
        """
        realisation = self.tracer.realise(batch)
        cells, specular, energy, ledger = accumulators
        slots = [(row, number) for row, count in enumerate(passes.tolist()) for number in range(count)]
        chunks = cells.shape[1]
        packets = self._strata[0] * self._strata[1]

        def trace(unit: int) -> None:
            # neighbouring rows cost alike: deal them out, chunk by chunk
            chunk, slot = divmod(unit, len(slots))
            place = slot, chunk
            row, number = slots[slot]
            beam = Beam(row, float(self._sin2[0][row]), float(self._sin2[1][row]), float(self._azimuths[row]))
            part = Part(*self._strata, chunk * packets // chunks, (chunk + 1) * packets // chunks)
            own = cells[place] if self.looks is None else np.zeros((cells.shape[2], 1, cells.shape[4]))
            sums = Sums(own, specular[place], energy[place], ledger[place])
            realisation.trace(self._bins, beam, part, batch + number * _BATCHES, sums)

        started = time.perf_counter()
        for_each(trace, len(slots) * chunks, threads)
        facets = None
        if self.alpha is not None:
            assert isinstance(realisation, Surface)
            assert isinstance(realisation.tile, HeightField)
            facets = measure_facets(
                realisation.tile,
                realisation.scene,
                self.alpha,
                len(slots) * self.paths_per_pass,
                self.job.seed,
                batch,
                threads,
            )
        if self.looks is not None:
            assert isinstance(realisation, Surface)
            ledger[0, 0, RAYS] += self.looks.measure(
                realisation.tile, realisation.scene, batch, passes, self.paths_per_pass, cells, threads
            )
        self.seconds += time.perf_counter() - started
        return facets
