"""The standard error of every cell, also of those that few paths ended in.

The scatter between batches is the error of a cell that many paths ended in. Of a cell with few it is not:
scatter and value come from the same few paths, so a cell that got too little light states too small an error
as well, and the interval value +- 1.96 errors misses the truth in 10 to 16 % of cells that expect 3 to 10
paths (Wald's interval; Brown, Cai, DasGupta 2001, "Interval estimation for a binomial proportion"). Their
errors are therefore taken from the cells around them, which know as much about how many paths to expect and
nothing of this cell's luck:

- D, the variance per path, is the sum of variances over the sum of paths, over the cells of a window.
- The number of paths to expect is that of the window, in proportion to projected solid angle; how far the
  cell's own number counts as well follows from how much the cells of the window differ beyond chance (the
  posterior mean of a gamma prior whose shape is found by the method of moments: empirical Bayes). In a
  smooth lobe it counts little, on a sharp peak it is all that counts.
- The product is the variance to expect, as sure as that of PRIOR paths; the scatter is as sure as the paths.

Paths may come in clumps: neighbouring ones meet the same facet. F, the variance in units of that of
independent paths (Fano's factor), is known from the same sums, and numbers of paths count as so many over F.

An empty cell gets the bound 3 / (paths x projected solid angle), above which its value lies with a chance
below exp(-3); 3 F where paths come in clumps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PRIOR = 16.0
"""Paths (of F = 1) in a cell that its scatter must come from to be trusted as much as the cells around it."""

_RINGS, _SECTORS = 1, 3  # the window reaches so many cells to either side
_ROW_PATHS = 5.0  # so many paths of the row's mean kind are added to every window
_FEWEST = 0.26  # paths expected in a cell that has one: its interval then reaches down to none
_BOUND = 3.0
_PAIRS_OF_BATCHES = 15.0  # the variance of a variance is that of so many squares, at least


def cell_errors(
    mean: Array, variance: Array, hits: NDArray[np.int64], projected_solid_angles: Array, paths: int
) -> Array:
    """Standard error of the energy in each cell of a row.

    Parameters
    ----------
    mean, variance : ndarray, shape (rings, sectors, channels)
        Energy in each cell in units of the incident, and the variance of that mean from the scatter of batches.
    hits : ndarray of int, shape (rings, sectors)
        Paths that ended in each cell.
    projected_solid_angles : ndarray, shape (rings, sectors)
    paths : int
        Of the row, in all.

    Returns
    -------
    ndarray, shape (rings, sectors, channels)
        Above 0 everywhere.
    """
    if paths == 0 or not hits.any():
        return np.full(mean.shape, _BOUND / max(paths, 1))
    found = np.where((hits == 0)[:, :, None], 0.0, term_errors(mean, variance, hits, projected_solid_angles))
    own = hits.astype(float)
    # of the row: around an empty cell there may be nothing; and 1 unless it is larger beyond chance
    row_clump = float(_clump(*_row_kind(mean, variance, own)))
    chance = np.sqrt(np.sum(own**2 / _PAIRS_OF_BATCHES + own)) / own.sum()
    bound = _BOUND / paths * (row_clump if row_clump > 1.0 + 3.0 * chance else 1.0)
    return np.where(found > 0, found, bound)


def term_errors(
    mean: Array, variance: Array, hits: NDArray[np.int64], projected_solid_angles: Array
) -> Array:
    """Standard error of each cell where it is one term of a sum over many; as `cell_errors`, but no bounds.

    An empty cell scatters by what is expected in it. Its bound would be right for the cell alone, and far too much for
    the sum of a hundred such cells. 0 where nothing is near.
    """
    own = hits.astype(float)
    if not hits.any():
        return np.zeros_like(mean)
    per_path, clump = _kinds(mean, variance, own, *_row_kind(mean, variance, own))
    expected = _expected(own / clump, projected_solid_angles) * clump
    pooled = per_path * expected[:, :, None]
    trust = (expected / clump)[:, :, None]
    found = np.sqrt((trust * variance + PRIOR * pooled) / (trust + PRIOR))
    # no scatter in any cell around, by stratification or a lucky few: Poisson's error of the paths counted
    poisson = np.abs(mean) / np.sqrt(np.maximum(own, 1.0))[:, :, None]
    return np.where(found > 0, found, poisson)


def _row_kind(mean: Array, variance: Array, own: Array) -> tuple[Array, Array]:
    """Variance and energy of a path in the whole row, shape (channels,)."""
    return variance.sum(axis=(0, 1)) / own.sum(), mean.sum(axis=(0, 1)) / own.sum()


def _kinds(
    mean: Array, variance: Array, own: Array, row_variance: Array, row_weight: Array
) -> tuple[Array, Array]:
    """Variance per path around each cell, shape (rings, sectors, channels), and F, shape (rings, sectors).

    `row_variance` and `row_weight`, shape (channels,), are variance and energy of a path in the whole row.
    """
    around = (sum_around(own) + _ROW_PATHS)[:, :, None]
    per_path = (sum_around(variance) + _ROW_PATHS * row_variance) / around
    weight = (sum_around(mean) + _ROW_PATHS * row_weight) / around
    return per_path, _clump(per_path, weight)


def _clump(per_path: Array, weight: Array) -> Array:
    """F from the variance and the energy of a path, shape (..., channels): how many paths come together."""
    # a channel may be a difference of light, whose paths have weights of either sign: the clearest decides
    known = weight != 0
    ratio = np.where(known, per_path, np.inf) / np.where(known, weight, 1.0) ** 2
    clump = np.min(ratio, axis=-1)
    return np.where(np.isfinite(clump) & (clump > 0), clump, 1.0)


def _expected(own: Array, areas: Array) -> Array:
    """Independent paths to expect in each cell, from those around it and, where these differ, its own."""
    rate = sum_around(own) / sum_around(areas)
    around = rate * areas
    cells = sum_around(np.ones_like(own)) + 1.0
    window_areas, squared_areas = sum_around(areas) + areas, sum_around(areas**2) + areas**2
    squares = sum_around(own**2) + own**2
    products = sum_around(own * areas) + own * areas
    # sum of squared deviations from the common rate; under chance alone, its mean and its standard deviation
    deviation = squares - 2.0 * rate * products + rate**2 * squared_areas
    chance = rate * window_areas
    spread = np.sqrt(2.0 * chance**2 / cells + chance)
    excess = np.maximum(deviation - chance - spread, 0.0)
    # relative variance of the rate between cells: the inverse of the gamma prior's shape
    differ = excess / np.maximum(rate**2 * squared_areas, 1e-300)
    # (own + shape) / (1 + shape / around), multiplied through so that shape may be infinite
    posterior = around * (own * differ + 1.0) / (around * differ + 1.0)
    posterior = np.where(around > 0, posterior, own)
    return np.where(own > 0, np.maximum(posterior, _FEWEST), posterior)


def sum_around(a: Array) -> Array:
    """Sum over the window about each cell without the cell itself; shape (rings, sectors, ...) as given.

    Sectors go on mirrored beyond 0 and pi, as delta phi is folded there; rings end.
    """
    rings, sectors = a.shape[:2]
    rest = [(0, 0)] * (a.ndim - 2)
    reach = min(_SECTORS, sectors)
    wide = np.pad(a, [(_RINGS, _RINGS), (0, 0), *rest])
    columns = sum(wide[shift : shift + rings] for shift in range(2 * _RINGS + 1))
    columns = np.pad(columns, [(0, 0), (reach, reach), *rest], mode="symmetric")
    window = sum(columns[:, shift : shift + sectors] for shift in range(2 * reach + 1))
    return np.asarray(window - a)
