"""Tallies: batches in, mean and standard error out (Welford's update, so no cancellation).

Light is told apart into sheets, by the hemisphere it leaves into and the number of its bounces:
sheet = hemisphere * orders + order. Hemisphere 0 is reflected, 1 transmitted; order n has bounced n + 1
times, the last order that often or more. A specimen that lets nothing through has one hemisphere, and a
trace that asks for no orders has one order: its only sheet is then its total.

A batch gives each row of incidence a number of passes, each of as many paths; usually one, but a row whose
error is large may get more and another none. A row's mean is over its paths. Its variance is kept as if all
its batches had been of the size of the last: where the number of passes changes by a factor k, T batches
become T / k, and their sum of squares M that of T / k batches whose mean has the same variance,
M' / (T' (T' - 1)) = M / (T (T - 1)). By Chan's formula for joining two groups this is exact where the
variance of a batch is the rays' (1 / paths), and correct to 1 / T where it is that of the realisations
(one a batch, however many its paths): each batch then counts by the square of its weight in the mean.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.core.jit import kernel
from gonio.core.parallel import for_each
from gonio.trace.analog import LEDGER, LEDGER_COLUMNS, RAYS
from gonio.trace.error_bars import cell_errors

Array = NDArray[np.float64]


class Tally:
    """Running mean and variance of every cell over batches.

    A batch is one independent estimate: fresh random numbers, and for a random surface a fresh
    realisation. The scatter between batches therefore holds the noise of the rays and that of the
    realisations alike. Memory does not grow with the number of paths.

    Parameters
    ----------
    rows, cells, channels : int
        Rows of incidence, cells of one row and hemisphere, channels.
    chunks : int
        Units into which the tracer cuts a pass, each with an accumulator of its own.
    hemispheres : int
        1: reflected light only; 2: transmitted light as well.
    orders : int
        Numbers of bounces told apart: 1, 2, ..., orders - 1, and as many as `orders` or more.
    ledger_names : sequence of str
        Names of the ledger's columns from LEDGER_COLUMNS on, such as "absorbed: layer 1 surface". The
        columns before are those of `gonio.trace.analog`: LEDGER, then RAYS.

    Attributes
    ----------
    batches, rays : int
    rows : RowCounts
    totals : list of SheetTally
        All light of each hemisphere.
    orders : list of list of SheetTally
        For each hemisphere its orders, which add up to its total; empty where there is one only.
    ledger : dict of str to float
        Paths, LEDGER and `ledger_names`, in units of incident energy (mean over channels).
    """

    def __init__(
        self,
        rows: int,
        cells: int,
        channels: int,
        chunks: int,
        hemispheres: int = 1,
        orders: int = 1,
        ledger_names: Sequence[str] = (),
    ) -> None:
        self.batches = 0
        self.rays = 0
        self.rows = RowCounts(rows)
        self.ledger: dict[str, float] = dict.fromkeys(("paths", *LEDGER, *ledger_names), 0.0)
        # energies by the column of the ledger that holds them
        self._columns = dict(enumerate(LEDGER)) | dict(enumerate(ledger_names, LEDGER_COLUMNS))
        shape = rows, cells, channels
        self.totals = [SheetTally(self.rows, *shape, h * orders, orders) for h in range(hemispheres)]
        self.orders: list[list[SheetTally]] = [
            [SheetTally(self.rows, *shape, h * orders + n) for n in range(orders if orders > 1 else 0)]
            for h in range(hemispheres)
        ]
        sheets = hemispheres * orders
        self._cells, self._specular, self._energy, self._ledger = new_accumulators(
            rows, cells, channels, chunks, sheets, len(ledger_names)
        )

    @property
    def accumulators(self) -> tuple[Array, Array, Array, Array]:
        """Where a batch is summed, a slot and chunk for each unit of work.

        There are as many slots as rows, each for one pass of some row; the passes of row 0 take the first
        slots, then come those of row 1, and so on.

        Returns
        -------
        cells : ndarray, shape (slots, chunks, sheets, cells, channels + 1)
            Sums of weights, and in the last column the number of paths; without the delta term.
        specular : ndarray, shape (slots, chunks, sheets, channels)
            The delta term.
        energy : ndarray, shape (slots, chunks, sheets, channels)
            All energy of the sheet, the delta term included.
        ledger : ndarray, shape (slots, chunks, LEDGER_COLUMNS + len(ledger_names))
        """
        return self._cells, self._specular, self._energy, self._ledger

    def close_batch(self, passes: ArrayLike, paths_per_pass: int, threads: int | None = None) -> None:
        """Take the sums in the accumulators as one batch, and clear them.

        Parameters
        ----------
        passes : array_like of int, shape (rows,)
            Of each row; no more than there are rows in all.
        paths_per_pass : int
        threads : int, optional
        """
        passes = np.asarray(passes, np.int64)
        last = np.cumsum(passes)
        self.batches += 1
        rescale = self.rows.begin_batch(passes, paths_per_pass)
        # orders first: totals add up their sums
        sheets = [*self._order_sheets(), *self.totals]

        def close(row: int) -> None:
            if passes[row] == 0:
                return
            mine = slice(int(last[row] - passes[row]), int(last[row]))
            scale = 1.0 / (int(passes[row]) * paths_per_pass)
            for sheet in sheets:
                if rescale[row] != 1.0:
                    sheet.rescale(row, float(rescale[row]))
                sheet.add_energies(row, self._specular[mine], self._energy[mine], scale)
                sheet.add_cells(row, self._cells[mine], scale)
            self._cells[mine.start, 0] = 0.0

        for_each(close, len(passes), threads)
        ledger = self._ledger.sum(axis=(0, 1))
        self.ledger["paths"] += paths_per_pass * int(last[-1])
        for column, name in self._columns.items():
            self.ledger[name] += float(ledger[column])
        self.rays += int(ledger[RAYS])
        for sums in (self._specular, self._energy, self._ledger):
            sums[:] = 0.0

    def albedo_error(self) -> float:
        """Largest relative standard error of any row's albedo or transmittance; infinite before batch 2."""
        if self.batches < 2:
            return float("inf")
        worst = 0.0
        for sheet in self.totals:
            energy, error, _, _ = sheet.energies()
            relative = error / np.maximum(energy, 1e-300)
            worst = max(worst, float(np.max(relative, initial=0.0, where=energy > 0)))
        return worst

    def state(self) -> dict[str, NDArray]:
        """All that was learned so far, as arrays by name; not copies."""
        ledger = np.array([self.batches, self.rays, *self.ledger.values()], float)
        found: dict[str, NDArray] = {"ledger": ledger}
        for name, holder in self._holders():
            for field, array in vars(holder).items():
                if isinstance(array, np.ndarray):
                    found[f"{name}{field}"] = array
        return found

    def restore(self, state: dict[str, NDArray]) -> None:
        """Go on from a `state` of a tally with the same arguments.

        Raises
        ------
        ValueError
            An array is missing or of another shape.
        """
        own = self.state()
        for name, array in own.items():
            if name not in state or state[name].shape != array.shape or state[name].dtype != array.dtype:
                raise ValueError(f"{name}: {array.dtype} of shape {array.shape} is expected")
        for name, array in own.items():
            array[...] = state[name]
        batches, rays, *energies = state["ledger"].tolist()
        self.batches, self.rays = int(batches), int(rays)
        self.ledger = dict(zip(self.ledger, energies, strict=True))

    def _order_sheets(self) -> list[SheetTally]:
        return [sheet for hemisphere in self.orders for sheet in hemisphere]

    def _holders(self) -> Iterator[tuple[str, object]]:
        yield "rows.", self.rows
        for number, sheet in enumerate((*self._order_sheets(), *self.totals)):
            yield f"sheet{number}.", sheet


def new_accumulators(
    rows: int, cells: int, channels: int, chunks: int, sheets: int, names: int
) -> tuple[Array, Array, Array, Array]:
    """Empty `Tally.accumulators`; arguments as `Tally`, and the numbers of sheets and of ledger names."""
    return (
        np.zeros((rows, chunks, sheets, cells, channels + 1)),
        np.zeros((rows, chunks, sheets, channels)),
        np.zeros((rows, chunks, sheets, channels)),
        np.zeros((rows, chunks, LEDGER_COLUMNS + names)),
    )


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

    Attributes
    ----------
    hits : ndarray of int64, shape (rows, cells)
        Paths that ended in each cell.
    """

    def __init__(
        self, counts: RowCounts, rows: int, cells: int, channels: int, first: int, count: int = 1
    ) -> None:
        self.hits: NDArray[np.int64] = np.zeros((rows, cells), np.int64)
        self._counts = counts
        self._first, self._count = first, count
        self._mean = np.zeros((rows, cells, channels))
        self._square = np.zeros((rows, cells, channels))
        # energies of a row: the delta term in each channel, then all there is
        self._row_mean = np.zeros((rows, 2 * channels))
        self._row_square = np.zeros((rows, 2 * channels))
        # what each batch adds to the sum of squares: squared and summed, of the row's energies, and of all
        # its cells together; and for the cells also just summed
        self._row_fourth = np.zeros((rows, 2 * channels))
        self._cells_square = np.zeros((rows, channels))
        self._cells_fourth = np.zeros((rows, channels))

    def rescale(self, row: int, factor: float) -> None:
        """Multiply a row's sums of squares, for batches of another size to follow."""
        self._square[row] *= factor
        self._row_square[row] *= factor
        self._cells_square[row] *= factor
        self._row_fourth[row] *= factor * factor
        self._cells_fourth[row] *= factor * factor

    def add_energies(self, row: int, specular: Array, energy: Array, scale: float) -> None:
        """Add a row's energies to the batch begun, its slots of `Tally.accumulators`; scale = 1 / paths."""
        mine = slice(self._first, self._first + self._count)
        sums = [a[:, :, mine].sum(axis=(0, 1, 2)) for a in (specular, energy)]
        value = np.concatenate(sums) * scale
        delta = value - self._row_mean[row]
        self._row_mean[row] += delta / self._counts.weight[row]
        increase = delta * (value - self._row_mean[row])
        self._row_square[row] += increase
        self._row_fourth[row] += increase**2

    def add_cells(self, row: int, cells: Array, scale: float) -> None:
        """Add a row's cells to the batch begun, its slots of `Tally.accumulators`; scale = 1 / paths.

        Sums are gathered in chunk 0 of the first slot and sheet; the accumulators they come from are cleared.
        """
        slots, chunks, sheets = cells.shape[:3]
        slabs = cells.reshape(-1, *cells.shape[3:])
        if self._count == 1:
            last, step = slots * chunks * sheets, sheets  # the sheet in all chunks, in their order
        else:
            last, step = self._first + self._count, 1  # the sheets' own sums, in chunk 0
        increase = np.zeros(self._mean.shape[2])
        _add_cells(
            slabs, self._first, last, step, scale, self._counts.weight[row],
            self._mean[row], self._square[row], self.hits[row], increase,
        )  # fmt: skip
        self._cells_square[row] += increase
        self._cells_fourth[row] += increase**2

    def cells(self, projected_solid_angles: Array) -> tuple[Array, Array]:
        """Mean BRDF of every cell and its standard error, 1/sr, shape (rows, rings, sectors, channels) each.

        Parameters
        ----------
        projected_solid_angles : ndarray, shape (rings, sectors)
            In sr.
        """
        shape = (len(self._mean), *projected_solid_angles.shape, self._mean.shape[2])
        values, std_error = np.empty(shape), np.empty(shape)
        for row in range(shape[0]):
            values[row], std_error[row] = self.row_cells(row, projected_solid_angles)
        return values, std_error

    def row_cells(self, row: int, projected_solid_angles: Array) -> tuple[Array, Array]:
        """One row of `cells`; how errors are found is said in `gonio.trace.error_bars`."""
        omega = projected_solid_angles[:, :, None]
        shape = (*projected_solid_angles.shape, -1)
        weight = self._counts.weight[row]
        mean = self._mean[row].reshape(shape)
        variance = self._square[row].reshape(shape) / (max(weight - 1.0, 1.0) * max(weight, 1.0))
        std_error = cell_errors(
            mean, variance, self.hits[row].reshape(shape[:2]), projected_solid_angles, self._counts.paths[row]
        )
        return mean / omega, std_error / omega

    def energies(self) -> tuple[Array, Array, Array, Array]:
        """All energy of each row, its error, the delta term, its error; shape (rows, channels) each."""
        std_error = np.sqrt(self._counts.variance_of_mean(self._row_square))
        channels = self._mean.shape[2]
        return (
            self._row_mean[:, channels:],
            std_error[:, channels:],
            self._row_mean[:, :channels],
            std_error[:, :channels],
        )

    def variance_of_variance(self) -> Array:
        """Relative variance of the variance of each row, shape (2, rows): of its energy, and of all its cells.

        The worst of the channels. MCNP's VOV (X-5 Monte Carlo Team 2003, LA-UR-03-1987,
        eq. 2.20): 2 / batches where these are normal; large where a few of them make up the variance.
        """
        channels = self._mean.shape[2]
        squares = np.stack([self._row_square[:, channels:], self._cells_square])
        fourths = np.stack([self._row_fourth[:, channels:], self._cells_fourth])
        known = squares > 0
        ratio = np.where(known, fourths, 0.0) / np.where(known, squares, 1.0) ** 2
        fewest = 1.0 / np.maximum(self._counts.batches - 1, 1)[:, None]
        return np.max(np.where(known, ratio - fewest, 0.0), axis=2)


@kernel(allocates=False)
def _add_cells(slabs, first, last, step, scale, weight, mean, square, hits, increase):
    """Welford's update of every cell with the sum over slabs first, first + step, ... before last.

    The sum is left in slab `first`, the other slabs are cleared. `increase`, shape (channels,), gets what
    all cells together add to their sums of squares.
    """
    _, count, columns = slabs.shape
    for cell in range(count):
        for slab in range(first + step, last, step):
            for column in range(columns):
                slabs[first, cell, column] += slabs[slab, cell, column]
                slabs[slab, cell, column] = 0.0
        hits[cell] += int(slabs[first, cell, columns - 1])
        if hits[cell] == 0:
            continue
        for channel in range(columns - 1):
            value = slabs[first, cell, channel] * scale
            delta = value - mean[cell, channel]
            mean[cell, channel] += delta / weight
            added = delta * (value - mean[cell, channel])
            square[cell, channel] += added
            increase[channel] += added
