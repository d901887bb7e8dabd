"""Tallies: batches in, mean and standard error out (Welford's update, so no cancellation)."""

from __future__ import annotations

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
        Rows of incidence, cells of one row, channels.
    chunks : int
        Units into which the tracer cuts a row, each with an accumulator of its own.
    """

    def __init__(self, rows: int, cells: int, channels: int, chunks: int) -> None:
        self.batches = 0
        self.paths_per_row = 0
        self.hits: NDArray[np.int64] = np.zeros((rows, cells), np.int64)
        self.ledger: dict[str, float] = dict.fromkeys(("paths", *LEDGER), 0.0)
        self.rays = 0
        self._mean = np.zeros((rows, cells, channels))
        self._square = np.zeros((rows, cells, channels))
        # energies of a row: the delta term in each channel, then all that is reflected
        self._row_mean = np.zeros((rows, 2 * channels))
        self._row_square = np.zeros((rows, 2 * channels))
        self._cells = np.zeros((rows, chunks, cells, channels + 1))
        self._specular = np.zeros((rows, chunks, channels))
        self._reflected = np.zeros((rows, chunks, channels))
        self._ledger = np.zeros((rows, chunks, LEDGER_COLUMNS))

    @property
    def accumulators(self) -> tuple[Array, Array, Array, Array]:
        """Where a batch is summed, a row and chunk for each unit: cells, specular, reflected, ledger."""
        return self._cells, self._specular, self._reflected, self._ledger

    def close_batch(self, paths_per_row: int, threads: int | None = None) -> None:
        """Take the sums in the accumulators as one batch of so many paths a row, and clear them."""
        self.batches += 1
        self.paths_per_row += paths_per_row

        def close(row: int) -> None:
            scale = 1.0 / paths_per_row
            _close(self._cells[row], scale, self.batches, self._mean[row], self._square[row], self.hits[row])

        for_each(close, len(self.hits), threads)
        rows = (
            np.concatenate([self._specular.sum(axis=1), self._reflected.sum(axis=1)], axis=1) / paths_per_row
        )
        delta = rows - self._row_mean
        self._row_mean += delta / self.batches
        self._row_square += delta * (rows - self._row_mean)
        ledger = self._ledger.sum(axis=(0, 1))
        self.ledger["paths"] += paths_per_row * len(rows)
        for name, energy in zip(LEDGER, ledger, strict=False):
            self.ledger[name] += float(energy)
        self.rays += int(ledger[RAYS])
        for sums in (self._specular, self._reflected, self._ledger):
            sums[:] = 0.0

    def cells(self, projected_solid_angles: Array) -> tuple[Array, Array]:
        """Mean BRDF of every cell and its standard error, 1/sr, shape (I, cells, C) each.

        The scatter of an empty cell is 0, which is not its error: such a cell gets the bound
        3/(N x projected solid angle), above which its value lies with a chance below exp(-3).

        Parameters
        ----------
        projected_solid_angles : ndarray, shape (cells,)
            In sr.
        """
        omega = projected_solid_angles[:, None]
        variance = self._square / (max(self.batches - 1, 1) * self.batches)
        std_error = np.sqrt(variance)
        # equal in all batches, by stratification or a lucky few: Poisson's error of the paths counted
        equal = (std_error == 0) & (self.hits[:, :, None] > 0)
        poisson = self._mean / np.sqrt(np.maximum(self.hits, 1))[:, :, None]
        std_error = np.where(equal, poisson, std_error)
        std_error[self.hits == 0] = 3.0 / self.paths_per_row
        return self._mean / omega, std_error / omega

    def rows(self) -> tuple[Array, Array, Array, Array]:
        """Albedo (all that is reflected), its error, the delta term, its error; shape (I, C) each."""
        std_error = np.sqrt(self._row_square / (max(self.batches - 1, 1) * self.batches))
        channels = self._mean.shape[2]
        return (
            self._row_mean[:, channels:],
            std_error[:, channels:],
            self._row_mean[:, :channels],
            std_error[:, :channels],
        )

    def albedo_error(self) -> float:
        """Largest relative standard error of any row's albedo; infinite before the second batch."""
        if self.batches < 2:
            return float("inf")
        albedo, error, _, _ = self.rows()
        return float(np.max(error / np.maximum(albedo, 1e-300), initial=0.0, where=albedo > 0))


@kernel(allocates=False)
def _close(cells, scale, batch, mean, square, hits):
    """Welford's update of every cell of a row with its sum over chunks, in chunk order; clears the sums."""
    chunks, count, columns = cells.shape
    for cell in range(count):
        paths = 0.0
        for chunk in range(chunks):
            paths += cells[chunk, cell, columns - 1]
            cells[chunk, cell, columns - 1] = 0.0
        hits[cell] += int(paths)
        for channel in range(columns - 1):
            total = 0.0
            for chunk in range(chunks):
                total += cells[chunk, cell, channel]
                cells[chunk, cell, channel] = 0.0
            delta = total * scale - mean[cell, channel]
            mean[cell, channel] += delta / batch
            square[cell, channel] += delta * (total * scale - mean[cell, channel])
