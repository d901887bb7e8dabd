"""Tallies: batches in, mean and standard error out (Welford's update, so no cancellation).

Light is told apart into sheets, by the hemisphere it leaves into and the number of its bounces:
sheet = hemisphere * orders + order. Hemisphere 0 is reflected, 1 transmitted; order n has bounced n + 1
times, the last order that often or more. A specimen that lets nothing through has one hemisphere, and a
trace that asks for no orders has one order: its only sheet is then its total.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gonio.core.jit import kernel
from gonio.core.parallel import for_each
from gonio.trace.analog import LEDGER, LEDGER_COLUMNS, RAYS

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
        Units into which the tracer cuts a row, each with an accumulator of its own.
    hemispheres : int
        1: reflected light only; 2: transmitted light as well.
    orders : int
        Numbers of bounces told apart: 1, 2, ..., orders - 1, and as many as `orders` or more.
    ledger_names : sequence of str
        Names of the ledger's columns from LEDGER_COLUMNS on, such as "absorbed: layer 1 surface". The
        columns before are those of `gonio.trace.analog`: LEDGER, then RAYS.

    Attributes
    ----------
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
        self.ledger: dict[str, float] = dict.fromkeys(("paths", *LEDGER, *ledger_names), 0.0)
        # energies by the column of the ledger that holds them
        self._columns = dict(enumerate(LEDGER)) | dict(enumerate(ledger_names, LEDGER_COLUMNS))
        self.totals = [SheetTally(rows, cells, channels, h * orders, orders) for h in range(hemispheres)]
        self.orders: list[list[SheetTally]] = [
            [SheetTally(rows, cells, channels, h * orders + n) for n in range(orders if orders > 1 else 0)]
            for h in range(hemispheres)
        ]
        sheets = hemispheres * orders
        self._cells = np.zeros((rows, chunks, sheets, cells, channels + 1))
        self._specular = np.zeros((rows, chunks, sheets, channels))
        self._energy = np.zeros((rows, chunks, sheets, channels))
        self._ledger = np.zeros((rows, chunks, LEDGER_COLUMNS + len(ledger_names)))

    @property
    def accumulators(self) -> tuple[Array, Array, Array, Array]:
        """Where a batch is summed, a row and chunk for each unit of work.

        Returns
        -------
        cells : ndarray, shape (rows, chunks, sheets, cells, channels + 1)
            Sums of weights, and in the last column the number of paths; without the delta term.
        specular : ndarray, shape (rows, chunks, sheets, channels)
            The delta term.
        energy : ndarray, shape (rows, chunks, sheets, channels)
            All energy of the sheet, the delta term included.
        ledger : ndarray, shape (rows, chunks, LEDGER_COLUMNS + len(ledger_names))
        """
        return self._cells, self._specular, self._energy, self._ledger

    def close_batch(self, paths_per_row: int, threads: int | None = None) -> None:
        """Take the sums in the accumulators as one batch of so many paths a row, and clear them."""
        self.batches += 1
        # orders first: totals add up their sums
        sheets = [*(sheet for hemisphere in self.orders for sheet in hemisphere), *self.totals]
        for sheet in sheets:
            sheet.add_rows(self._specular, self._energy, paths_per_row)

        def close(row: int) -> None:
            for sheet in sheets:
                sheet.add_cells(row, self._cells[row], paths_per_row)
            self._cells[row, 0] = 0.0

        for_each(close, len(self._cells), threads)
        ledger = self._ledger.sum(axis=(0, 1))
        self.ledger["paths"] += paths_per_row * len(self._cells)
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
            energy, error, _, _ = sheet.rows()
            relative = error / np.maximum(energy, 1e-300)
            worst = max(worst, float(np.max(relative, initial=0.0, where=energy > 0)))
        return worst


class SheetTally:
    """Running mean and variance of one sheet, or of the sum of several.

    The orders of bounces are correlated, so the error of their sum does not follow from theirs: the sum has
    a tally of its own.

    Parameters
    ----------
    rows, cells, channels : int
        As in `Tally`.
    first, count : int
        Which of the tally's sheets to add up; where there are several, after each was closed on its own.

    Attributes
    ----------
    hits : ndarray of int64, shape (rows, cells)
        Paths that ended in each cell.
    """

    def __init__(self, rows: int, cells: int, channels: int, first: int, count: int = 1) -> None:
        self.hits: NDArray[np.int64] = np.zeros((rows, cells), np.int64)
        self._first, self._count = first, count
        self._batches = 0
        self._paths_per_row = 0
        self._mean = np.zeros((rows, cells, channels))
        self._square = np.zeros((rows, cells, channels))
        # energies of a row: the delta term in each channel, then all there is
        self._row_mean = np.zeros((rows, 2 * channels))
        self._row_square = np.zeros((rows, 2 * channels))

    def add_rows(self, specular: Array, energy: Array, paths_per_row: int) -> None:
        """Begin a batch of so many paths a row with its energies; arguments as `Tally.accumulators`."""
        self._batches += 1
        self._paths_per_row += paths_per_row
        mine = slice(self._first, self._first + self._count)
        sums = [a[:, :, mine].sum(axis=(1, 2)) for a in (specular, energy)]
        rows = np.concatenate(sums, axis=1) / paths_per_row
        delta = rows - self._row_mean
        self._row_mean += delta / self._batches
        self._row_square += delta * (rows - self._row_mean)

    def add_cells(self, row: int, cells: Array, paths_per_row: int) -> None:
        """Add the cells of one row to the batch begun, shape (chunks, sheets, cells, channels + 1).

        Sums are gathered in chunk 0 of the first sheet; the other accumulators they come from are cleared.
        """
        chunks, sheets = cells.shape[:2]
        slabs = cells.reshape(-1, *cells.shape[2:])
        if self._count == 1:
            last, step = chunks * sheets, sheets  # the sheet in all chunks, in their order
        else:
            last, step = self._first + self._count, 1  # the sheets' own sums, in chunk 0
        _add_cells(
            slabs, self._first, last, step, 1.0 / paths_per_row, self._batches,
            self._mean[row], self._square[row], self.hits[row],
        )  # fmt: skip

    def cells(self, projected_solid_angles: Array) -> tuple[Array, Array]:
        """Mean BRDF of every cell and its standard error, 1/sr, shape (rows, cells, channels) each.

        The scatter of an empty cell is 0, which is not its error: such a cell gets the bound
        3/(N x projected solid angle), above which its value lies with a chance below exp(-3).

        Parameters
        ----------
        projected_solid_angles : ndarray, shape (cells,)
            In sr.
        """
        omega = projected_solid_angles[:, None]
        variance = self._square / (max(self._batches - 1, 1) * self._batches)
        std_error = np.sqrt(variance)
        # equal in all batches, by stratification or a lucky few: Poisson's error of the paths counted
        equal = (std_error == 0) & (self.hits[:, :, None] > 0)
        poisson = self._mean / np.sqrt(np.maximum(self.hits, 1))[:, :, None]
        std_error = np.where(equal, poisson, std_error)
        std_error[self.hits == 0] = 3.0 / self._paths_per_row
        return self._mean / omega, std_error / omega

    def rows(self) -> tuple[Array, Array, Array, Array]:
        """All energy of each row, its error, the delta term, its error; shape (rows, channels) each."""
        std_error = np.sqrt(self._row_square / (max(self._batches - 1, 1) * self._batches))
        channels = self._mean.shape[2]
        return (
            self._row_mean[:, channels:],
            std_error[:, channels:],
            self._row_mean[:, :channels],
            std_error[:, :channels],
        )


@kernel(allocates=False)
def _add_cells(slabs, first, last, step, scale, batch, mean, square, hits):
    """Welford's update of every cell with the sum over slabs first, first + step, ... before last.

    The sum is left in slab `first`, the other slabs are cleared.
    """
    _, count, columns = slabs.shape
    for cell in range(count):
        for slab in range(first + step, last, step):
            for column in range(columns):
                slabs[first, cell, column] += slabs[slab, cell, column]
                slabs[slab, cell, column] = 0.0
        hits[cell] += int(slabs[first, cell, columns - 1])
        for channel in range(columns - 1):
            value = slabs[first, cell, channel] * scale
            delta = value - mean[cell, channel]
            mean[cell, channel] += delta / batch
            square[cell, channel] += delta * (value - mean[cell, channel])
