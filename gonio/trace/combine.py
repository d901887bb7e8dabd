"""Single bounces by their half vectors, and what bounces more by binning, in the cells of one table.

The orders are scaled, row by row, to the energies that the paths counted: these hold less noise than a
histogram of tilts, and all orders add up to the row's albedo. Single bounces are held to the paths in each block
of cells as well, where the paths are many enough.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gonio.core.parallel import for_each
from gonio.trace.half_vector import HalfVector
from gonio.trace.remainder import spread
from gonio.trace.sheets import Sheet, SheetTally
from gonio.trace.tally import Tally

if TYPE_CHECKING:
    from gonio.trace.batch import BatchTracer

Array = NDArray[np.float64]


class Combined:
    """A `gonio.trace.sheets.Sheet` whose cells were estimated otherwise than its energies.

    Parameters
    ----------
    values, std_error : ndarray, shape (rows, rings, sectors, channels)
        1/sr.
    counted : SheetTally
        The same light as counted, in any cells.
    peak : tuple of ndarray, shape (rows, S, Q, channels), optional
        Values and errors of the cells of a `gonio.table.peak.Peak`, which follow the others.
    """

    hits = None

    def __init__(
        self, values: Array, std_error: Array, counted: SheetTally, peak: tuple[Array, Array] | None = None
    ) -> None:
        self._cells, self._peak = (values, std_error), peak
        self._counted = counted

    def cells(self, projected_solid_angles: Array, first: int = 0) -> tuple[Array, Array]:
        """As `SheetTally.cells`, of the table's cells or, from the first of these on, the peak's."""
        return self._cells if first == 0 or self._peak is None else self._peak

    def row_cells(self, row: int, projected_solid_angles: Array, first: int = 0) -> tuple[Array, Array]:
        """As `SheetTally.row_cells`, of these cells."""
        values, std_error = self.cells(projected_solid_angles, first)
        return values[row], std_error[row]

    def energies(self) -> tuple[Array, Array, Array, Array]:
        """As `SheetTally.energies`."""
        return self._counted.energies()

    def variance_of_variance(self) -> Array:
        """As `SheetTally.variance_of_variance`."""
        return self._counted.variance_of_variance()


def combine(
    half_vector: HalfVector, tally: Tally, batches: BatchTracer, threads: int
) -> tuple[Sheet, list[Sheet]]:
    """All reflected light, and its orders where the specimen asks for them.

    Parameters
    ----------
    half_vector : HalfVector
        Of at least one batch.
    tally : Tally
        Of one hemisphere and two orders or more, in blocks.
    batches : BatchTracer
        Whose axes those are.
    threads : int
        The result does not depend on it.
    """
    shape = len(batches.theta_i), *batches.areas.shape, -1
    values, std_error = half_vector.cells(
        batches.theta_i, batches.theta_i_edges, batches.theta_edges, batches.phi_edges, threads
    )
    values, std_error = values.reshape(shape), std_error.reshape(shape)
    estimates = [(values, std_error)]
    counted = tally.orders[0]
    peaks: list[tuple[Array, Array] | None] = [None] * len(counted)
    total_peak = None
    if batches.peak is not None:
        grid = batches.peak
        single = half_vector.slopes(batches.theta_i, batches.theta_i_edges, grid, threads)
        _scale(*single, counted[0], batches.areas, values)
        found = [single, *(sheet.cells(grid.areas, batches.bin_areas.size) for sheet in counted[1:])]
        peaks = list(found)
        means, errors = zip(*found, strict=True)
        total_peak = np.sum(means, axis=0), np.sqrt(np.sum(np.square(errors), axis=0))
    _anchor(*estimates[0], counted[0], batches)
    estimates += [_spread(sheet, batches, threads) for sheet in counted[1:]]
    for (values, std_error), sheet in zip(estimates, counted, strict=True):
        _scale(values, std_error, sheet, batches.areas, values)
    orders = [
        Combined(*estimate, sheet, peak)
        for estimate, sheet, peak in zip(estimates, counted, peaks, strict=True)
    ]
    # a table of half a degree is large: nothing is copied that nobody asked for
    asked = batches.job.specimen.grid.orders > 1
    total, error = (a.copy() for a in estimates[0]) if asked else estimates[0]
    for values, std_error in estimates[1:]:
        total += values
        np.hypot(error, std_error, out=error)
    return Combined(total, error, tally.totals[0], total_peak), list(orders) if asked else []


def _anchor(values: Array, std_error: Array, counted: SheetTally, batches: BatchTracer) -> None:
    """Multiply both: half vectors give the cells of a block, and paths their sum as far as these know it better.

    Near the horizon, where few facets see out, many paths may. A block's factor is 1 + w (counted / estimated - 1),
    with the weight w from relative variances: the estimate's own, and 1 over the paths it expects. It does not ask
    how many there were, which would prefer blocks that few happened to reach.
    """
    areas = batches.areas
    shape = values.shape
    rings, sectors = batches.bin_areas.shape
    blocks = shape[0], rings, shape[1] // rings, sectors, shape[2] // sectors, shape[3]

    def total(a: Array) -> Array:
        return np.stack([(row * areas[..., None]).reshape(blocks[1:]).sum(axis=(1, 3)) for row in a])

    estimated = total(values)
    known = np.where(estimated > 0, estimated, 1.0)
    own = np.where(estimated > 0, total(std_error) / known, 0.0) ** 2  # as if cells of a block erred alike
    found, found_error = (a * batches.bin_areas[..., None] for a in counted.cells(batches.bin_areas))
    energy = counted.energies()[0]
    paths = counted.hits[:, : batches.bin_areas.size].sum(axis=1)[:, None] / np.where(
        energy > 0, energy, np.inf
    )  # for a unit of energy
    poisson = 1.0 / np.maximum(estimated * paths[:, None, None, :], 1e-300)
    weight = np.where((estimated > 0) & (own > 0), own / (own + poisson), 0.0)
    factor = 1.0 + weight * (found / known - 1.0)
    variance = (1.0 - weight) ** 2 * own + (weight * np.maximum(found_error / known, 0.0)) ** 2
    shrink = np.sqrt(np.where(own > 0, variance / np.where(own > 0, own, 1.0), 1.0))

    for a, by in ((values, factor), (std_error, shrink)):
        for row in range(len(a)):
            a[row] *= np.repeat(np.repeat(by[row], blocks[2], axis=0), blocks[4], axis=1)


def _scale(values: Array, std_error: Array, counted: SheetTally, areas: Array, cells: Array) -> None:
    """Multiply both by what makes the table's `cells` hold the energies counted."""
    energy = np.einsum("irpc,rp->ic", cells, areas)
    factor = np.where(energy > 0, counted.energies()[0] / np.where(energy > 0, energy, 1.0), 1.0)
    values *= factor[:, None, None, :]
    std_error *= factor[:, None, None, :]


def _spread(sheet: SheetTally, batches: BatchTracer, threads: int) -> tuple[Array, Array]:
    """From blocks to cells."""
    rows = for_each(lambda row: sheet.row_terms(row, batches.bin_areas), len(batches.theta_i), threads)
    values, std_error = (np.stack(part) for part in zip(*rows, strict=True))
    variance = std_error**2
    theta_r, delta_phi = (0.5 * (e[1:] + e[:-1]) for e in (batches.theta_edges, batches.phi_edges))
    theta_i = None
    merge, rest = divmod(len(theta_r), len(batches.bin_theta_edges) - 1)
    if batches.theta_i_edges is not None and rest == 0:
        # rows to blocks, weighted by their projected solid angles
        theta_i = batches.theta_i
        weight = np.diff(np.sin(batches.theta_i_edges) ** 2).reshape(-1, merge)
        weight = (weight / weight.sum(axis=1, keepdims=True))[..., None, None, None]
        blocks = len(weight), merge, *values.shape[1:]
        values = (values.reshape(blocks) * weight).sum(axis=1)
        variance = (variance.reshape(blocks) * weight**2).sum(axis=1)
    return spread(
        values, variance, batches.bin_theta_edges, batches.bin_phi_edges, theta_r, delta_phi, theta_i
    )
