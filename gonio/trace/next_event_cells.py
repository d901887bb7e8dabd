"""Cells of next-event estimates: their errors, and held to the energies that paths counted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gonio.trace.error_bars import sum_around
from gonio.trace.sheets import SheetTally

Array = NDArray[np.float64]

_PRIOR = 10.0  # batches that the scatter in the cells around counts as
_ROUNDING = 1e-6  # of single precision, relative
_BOUND = 3.0


class JoinedSheet:
    """A `gonio.trace.sheets.Sheet` whose cells hold next-event estimates and whose energies are those of paths.

    The cells of a row are scaled to its energy, so that they add up to the albedo; its error is added to theirs.

    Parameters
    ----------
    sheet : SheetTally
    even : bool
        Whether all cells of a row were looked at equally often, and often in every batch; else as paths went.
    orders : sequence of JoinedSheet
        Whose sum it is, if of any.
    """

    hits = None

    def __init__(self, sheet: SheetTally, even: bool, orders: Sequence[JoinedSheet] = ()) -> None:
        self._sheet = sheet
        self._even = even
        self._orders = orders

    def cells(self, projected_solid_angles: Array, first: int = 0) -> tuple[Array, Array]:
        """As `SheetTally.cells`, of the table's cells only."""
        rows = [self.row_cells(row, projected_solid_angles) for row in range(len(self._sheet.hits))]
        values, std_error = zip(*rows, strict=True)
        return np.stack(values), np.stack(std_error)

    def row_cells(self, row: int, projected_solid_angles: Array, first: int = 0) -> tuple[Array, Array]:
        """As `SheetTally.row_cells`, of the table's cells only."""
        omega = projected_solid_angles[:, :, None]
        if self._even:
            mean, _ = self._sheet.row_moments(row, projected_solid_angles.shape)
            variance = self._sheet.row_relative_variance(row, projected_solid_angles.shape)
            hits = self._sheet.hits[row].reshape(projected_solid_angles.shape)
            batches = self._sheet.row_batches(row)
            values, std_error = mean / omega, scatter_errors(mean / omega, variance / omega**2, hits, batches)
        else:
            values, std_error = self._sheet.row_cells(row, projected_solid_angles, scaled=True)
        energy, energy_error = (a[row] for a in self._sheet.spread_energies())
        joined = np.sum(values * omega, axis=(0, 1))
        known = (joined > 0) & (energy > 0)
        factor = np.where(known, energy, 1.0) / np.where(known, joined, 1.0)
        relative = np.where(known, energy_error, 0.0) / np.where(known, energy, 1.0)
        values = values * factor
        if self._orders:
            values = np.sum(
                [order.row_cells(row, projected_solid_angles)[0] for order in self._orders], axis=0
            )
        return values, np.hypot(std_error * factor, values * relative)

    def energies(self) -> tuple[Array, Array, Array, Array]:
        """As `SheetTally.energies`."""
        return self._sheet.energies()

    def variance_of_variance(self) -> Array:
        """As `SheetTally.variance_of_variance`."""
        return self._sheet.variance_of_variance()


def scatter_errors(mean: Array, variance: Array, looks: NDArray[np.int64], batches: float) -> Array:
    """Standard errors from the scatter of batches, which is taken from the cells around as well where these are few.

    Parameters
    ----------
    mean, variance : ndarray, shape (rings, sectors, channels)
        Of each cell, and the variance of that mean.
    looks : ndarray of int, shape (rings, sectors)
        Points whose light was looked for in each cell.
    batches : float

    Returns
    -------
    ndarray, shape (rings, sectors, channels)
        Above 0 wherever there was a look at a row with light: of a cell without, the bound 3 / looks of the
        brightest.
    """
    square = mean**2
    level = sum_around(square) + square
    relative = np.where(level > 0, sum_around(variance) + variance, 0.0) / np.where(level > 0, level, 1.0)
    own = max(batches - 1.0, 0.0)
    pooled = (own * variance + _PRIOR * relative * square) / (own + _PRIOR)
    found = np.sqrt(pooled + _ROUNDING**2 * square)
    bound = _BOUND * np.abs(mean).max(axis=(0, 1)) / np.maximum(looks, 1)[:, :, None]
    return np.where(square > 0, found, bound)
