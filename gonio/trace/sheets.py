"""Running mean and variance of one sheet of a tally, row by row (Welford's update, so no cancellation).

A batch gives each row of incidence a number of passes, each of as many paths; usually one, but a row whose
error is large may get more and another none. A row's mean is over its paths. Its variance is kept as if all
its batches had been of the size of the last: where the number of passes changes by a factor k, T batches
become T / k, and their sum of squares M that of T / k batches whose mean has the same variance,
M' / (T' (T' - 1)) = M / (T (T - 1)). The variance of the mean so found is right on average both where the variance
of a batch is the rays' (1 / paths) and where it is that of the realisations (one a batch, however many its
paths): with one more batch, V becomes (T^2 V + variance of the batch) / (T + 1)^2 whatever that is.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from gonio.core.jit import kernel
from gonio.trace.error_bars import cell_errors, term_errors

Array = NDArray[np.float64]


class RowCounts:
    """How much each row of incidence was traced.

    Attributes
    ----------
    batches : ndarray of int64, shape (rows,)
        In which the row took part.
    paths : ndarray of int64, shape (rows,)
    passes : ndarray of int64, shape (rows,)
        In the last of these batches.
    weight : ndarray, shape (rows,)
        All paths of the row, in batches of the size of the last.
    """

    def __init__(self, rows: int) -> None:
        self.batches: NDArray[np.int64] = np.zeros(rows, np.int64)
        self.paths: NDArray[np.int64] = np.zeros(rows, np.int64)
        self.passes: NDArray[np.int64] = np.zeros(rows, np.int64)
        self.weight = np.zeros(rows)

    def begin_batch(self, passes: NDArray[np.int64], paths_per_pass: int) -> Array:
        """Count one more batch; returns the factor (shape (rows,)) that sums of squares change by."""
        factor = np.ones(len(passes))
        changed = (passes > 0) & (self.passes > 0) & (passes != self.passes)
        old = self.weight[changed]
        new = old * self.passes[changed] / passes[changed]
        if np.any(new <= 1.0) or np.any(old <= 1.0):
            raise ValueError("passes: of a row may not outgrow all its batches before")
        factor[changed] = (new * (new - 1.0)) / (old * (old - 1.0))
        self.weight[changed] = new
        taking_part = passes > 0
        self.passes[taking_part] = passes[taking_part]
        self.weight[taking_part] += 1.0
        self.batches[taking_part] += 1
        self.paths += passes * paths_per_pass
        return factor

    def variance_of_mean(self, squares: Array) -> Array:
        """From sums of squared deviations, shape (rows, ...), to the variance of the mean."""
        scale = 1.0 / (np.maximum(self.weight - 1.0, 1.0) * np.maximum(self.weight, 1.0))
        return squares * scale.reshape(-1, *[1] * (squares.ndim - 1))


class Slots(NamedTuple):
    """Where `Tally.accumulators` hold rows that took part in a batch; all of shape (n,).

    `first` is a row's first slot and `last` the one after its last; `scale` is 1 / its paths.
    """

    rows: NDArray[np.int64]
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    scale: Array

    def part(self, begin: int, end: int) -> Slots:
        """Of these, the rows from `begin` to before `end`."""
        some = slice(begin, end)
        return Slots(self.rows[some], self.first[some], self.last[some], self.scale[some])


class Sheet(Protocol):
    """What is known of some of the light."""

    @property
    def hits(self) -> NDArray[np.int64] | None:
        """Paths that ended in each cell, shape (rows, cells); None where cells do not rest on paths."""
        ...

    def cells(self, projected_solid_angles: Array, first: int = 0) -> tuple[Array, Array]:
        """As `SheetTally.cells`."""
        ...

    def row_cells(self, row: int, projected_solid_angles: Array, first: int = 0) -> tuple[Array, Array]:
        """As `SheetTally.row_cells`."""
        ...

    def energies(self) -> tuple[Array, Array, Array, Array]:
        """As `SheetTally.energies`."""
        ...

    def variance_of_variance(self) -> Array:
        """As `SheetTally.variance_of_variance`."""
        ...


class SheetTally:
    """Running mean and variance of one sheet, or of the sum of several.

    The orders of bounces are correlated, so the error of their sum does not follow from theirs: the sum has
    a tally of its own.

    Parameters
    ----------
    counts : RowCounts
        Of the tally it belongs to.
    rows, cells, channels : int
        As in `Tally`.
    first, count : int
        Which of the tally's sheets to add up; where there are several, after each was closed on its own.
    joint : bool
        Whether to keep how each cell varies with the sum over its row.

    Attributes
    ----------
    hits : ndarray of int64, shape (rows, cells)
        Paths that ended in each cell.
    """

    def __init__(
        self,
        counts: RowCounts,
        rows: int,
        cells: int,
        channels: int,
        first: int,
        count: int = 1,
        joint: bool = False,
    ) -> None:
        self.hits: NDArray[np.int64] = np.zeros((rows, cells), np.int64)
        self._counts = counts
        self._first, self._count = first, count
        self._mean = np.zeros((rows, cells, channels))
        self._square = np.zeros((rows, cells, channels))
        # energies of a row: the delta term in each channel, then all there is, then all but the delta term
        self._row_mean = np.zeros((rows, 3 * channels))
        self._row_square = np.zeros((rows, 3 * channels))
        # what each batch adds to the sum of squares: squared and summed, of the row's energies, and of all
        # its cells together; and for the cells also just summed
        self._row_fourth = np.zeros((rows, 3 * channels))
        self._cells_square = np.zeros((rows, channels))
        self._cells_fourth = np.zeros((rows, channels))
        self._joint = np.zeros((rows, cells if joint else 0, channels))
        self._sum_mean, self._sum_square = np.zeros((2, rows, channels))

    def rescale(self, row: int, factor: float) -> None:
        """Multiply a row's sums of squares, for batches of another size to follow."""
        self._square[row] *= factor
        self._joint[row] *= factor
        self._sum_square[row] *= factor
        self._row_square[row] *= factor
        self._cells_square[row] *= factor
        self._row_fourth[row] *= factor * factor
        self._cells_fourth[row] *= factor * factor

    def add_energies(self, slots: Slots, specular: Array, energy: Array) -> None:
        """Add rows' energies to the batch begun, from `Tally.accumulators`."""
        mine = slice(self._first, self._first + self._count)
        rows, weight = slots.rows, self._counts.weight[slots.rows, None]
        delta_term, total = (
            np.add.reduceat(a[:, :, mine].sum(axis=(1, 2)), slots.first) for a in (specular, energy)
        )
        value = np.concatenate([delta_term, total, total - delta_term], axis=1) * slots.scale[:, None]
        delta = value - self._row_mean[rows]
        self._row_mean[rows] += delta / weight
        increase = delta * (value - self._row_mean[rows])
        self._row_square[rows] += increase
        self._row_fourth[rows] += increase**2

    def add_cells(self, slots: Slots, cells: Array) -> None:
        """Add rows' cells to the batch begun, from `Tally.accumulators`.

        Sums are gathered in chunk 0 of a row's first slot and sheet; the accumulators they come from are cleared.
        """
        rows, (_, chunks, sheets) = slots.rows, cells.shape[:3]
        slabs = cells.reshape(-1, *cells.shape[3:])
        begin = slots.first * chunks * sheets + self._first
        if self._count == 1:
            end, step = slots.last * chunks * sheets, sheets  # the sheet in all chunks, in their order
        else:
            end, step = begin + self._count, 1  # the sheets' own sums, in chunk 0
        increase = np.zeros((len(rows), self._mean.shape[2]))
        weight = self._counts.weight[rows]
        _add_cells(
            slabs, rows, begin, end, step, slots.scale, weight, self._mean, self._square, self.hits, increase
        )
        self._cells_square[rows] += increase
        self._cells_fourth[rows] += increase**2
        if self._joint.shape[1]:
            for row, slab, scale in zip(rows, begin, slots.scale, strict=True):
                values = slabs[slab, :, :-1] * scale
                total = values.sum(axis=0)
                delta = total - self._sum_mean[row]
                self._sum_mean[row] += delta / self._counts.weight[row]
                self._sum_square[row] += delta * (total - self._sum_mean[row])
                self._joint[row] += delta * (values - self._mean[row])

    def cells(self, projected_solid_angles: Array, first: int = 0) -> tuple[Array, Array]:
        """Mean BRDF of every cell and its standard error, 1/sr, shape (rows, rings, sectors, channels) each.

        Parameters
        ----------
        projected_solid_angles : ndarray, shape (rings, sectors)
            In sr; or whatever else the energy is to be per.
        first : int
            The cell of a row that these begin with.
        """
        shape = (len(self._mean), *projected_solid_angles.shape, self._mean.shape[2])
        values, std_error = np.empty(shape), np.empty(shape)
        for row in range(shape[0]):
            values[row], std_error[row] = self.row_cells(row, projected_solid_angles, first)
        return values, std_error

    def row_cells(
        self, row: int, projected_solid_angles: Array, first: int = 0, scaled: bool = False
    ) -> tuple[Array, Array]:
        """One row of `cells`; how errors are found is said in `gonio.trace.error_bars`.

        `scaled`: errors as if the row were scaled to a known sum, by `row_relative_variance`.
        """
        omega = projected_solid_angles[:, :, None]
        shape = projected_solid_angles.shape
        mean, variance, hits = self._row(row, shape, first)
        if scaled:
            variance = self.row_relative_variance(row, shape)
        std_error = cell_errors(mean, variance, hits, projected_solid_angles, self._counts.paths[row])
        return mean / omega, std_error / omega

    def row_terms(self, row: int, projected_solid_angles: Array) -> tuple[Array, Array]:
        """As `row_cells`, with the errors of cells that are added up (`gonio.trace.error_bars.term_errors`)."""
        omega = projected_solid_angles[:, :, None]
        mean, variance, hits = self._row(row, projected_solid_angles.shape)
        return mean / omega, term_errors(mean, variance, hits, projected_solid_angles) / omega

    def _row(
        self, row: int, shape: tuple[int, ...], first: int = 0
    ) -> tuple[Array, Array, NDArray[np.int64]]:
        """`row_moments`, and the paths in each cell."""
        hits = self.hits[row, first : first + math.prod(shape)].reshape(shape)
        return *self.row_moments(row, shape, first), hits

    def row_moments(self, row: int, shape: tuple[int, ...], first: int = 0) -> tuple[Array, Array]:
        """Mean energy in the cells of a row from `first` on, and the variance of that mean; of `shape` and channels."""
        weight = self._counts.weight[row]
        mine = slice(first, first + math.prod(shape))
        mean = self._mean[row, mine].reshape(*shape, -1)
        variance = self._square[row, mine].reshape(mean.shape) / (max(weight - 1.0, 1.0) * max(weight, 1.0))
        return mean, variance

    def row_relative_variance(self, row: int, shape: tuple[int, ...]) -> Array:
        """Variance of the mean energies in the cells of a row, as if each batch were scaled by the sum over all cells.

        Cochran 1977, "Sampling techniques", eq. 6.13; of `shape` and the channels, for a tally that is `joint`.
        """
        mean, variance = self.row_moments(row, shape)
        weight = self._counts.weight[row]
        scale = 1.0 / (max(weight - 1.0, 1.0) * max(weight, 1.0))
        total = self._sum_mean[row]
        ratio = np.where(total != 0, mean, 0.0) / np.where(total != 0, total, 1.0)
        joint = self._joint[row].reshape(mean.shape)
        return np.maximum(variance - scale * ratio * (2.0 * joint - ratio * self._sum_square[row]), 0.0)

    def row_batches(self, row: int) -> float:
        """Batches in which the row took part, as of the size of the last."""
        return float(self._counts.weight[row])

    def energies(self) -> tuple[Array, Array, Array, Array]:
        """All energy of each row, its error, the delta term, its error; shape (rows, channels) each."""
        std_error = np.sqrt(self._counts.variance_of_mean(self._row_square))
        channels = self._mean.shape[2]
        return (
            self._row_mean[:, channels : 2 * channels],
            std_error[:, channels : 2 * channels],
            self._row_mean[:, :channels],
            std_error[:, :channels],
        )

    def spread_energies(self) -> tuple[Array, Array]:
        """Energy of each row without the delta term, and its error; shape (rows, channels) each.

        Light that splits between the two makes this error larger than that of all energy.
        """
        channels = self._mean.shape[2]
        std_error = np.sqrt(self._counts.variance_of_mean(self._row_square))
        return self._row_mean[:, 2 * channels :], std_error[:, 2 * channels :]

    def variance_of_variance(self) -> Array:
        """Relative variance of the variance of each row, shape (2, rows): of its energy, and of all its cells.

        The worst of the channels. MCNP's VOV (X-5 Monte Carlo Team 2003, LA-UR-03-1987,
        eq. 2.20): 2 / batches where these are normal; large where a few of them make up the variance.
        """
        channels = self._mean.shape[2]
        squares = np.stack([self._row_square[:, channels : 2 * channels], self._cells_square])
        fourths = np.stack([self._row_fourth[:, channels : 2 * channels], self._cells_fourth])
        known = squares > 0
        ratio = np.where(known, fourths, 0.0) / np.where(known, squares, 1.0) ** 2
        fewest = 1.0 / np.maximum(self._counts.batches - 1, 1)[:, None]
        return np.max(np.where(known, ratio - fewest, 0.0), axis=2)


@kernel(allocates=False)
def _add_cells(slabs, rows, begin, end, step, scale, weight, mean, square, hits, increase):
    """Welford's update of rows' cells with the sums over their slabs begin, begin + step, ... before end.

    A row's sum is left in its first slab, the others are cleared. `increase`, shape (rows, channels), gets what
    all cells together add to their sums of squares.
    """
    _, count, columns = slabs.shape
    for n in range(len(rows)):
        row, first = rows[n], begin[n]
        for cell in range(count):
            for slab in range(first + step, end[n], step):
                for column in range(columns):
                    slabs[first, cell, column] += slabs[slab, cell, column]
                    slabs[slab, cell, column] = 0.0
            hits[row, cell] += int(slabs[first, cell, columns - 1])
            if hits[row, cell] == 0:
                continue
            for channel in range(columns - 1):
                value = slabs[first, cell, channel] * scale[n]
                delta = value - mean[row, cell, channel]
                mean[row, cell, channel] += delta / weight[n]
                added = delta * (value - mean[row, cell, channel])
                square[row, cell, channel] += added
                increase[n, channel] += added
