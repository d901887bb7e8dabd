"""Mass-preserving maps between the unit square and a tabulated density, as RGL's files use them.

The density is bilinear between nodes at the corners of a grid. The map draws y from the marginal, then x
from the conditional, both piecewise linear (Dupuy & Jakob 2018, section 4; Mitsuba's
``MarginalContinuous2D``). Points are (x, y) in [0, 1]^2; arrays are indexed [y, x].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def bilinear(grid: Array, x: Array, y: Array) -> Array:
    """Interpolate nodes on the corners of the unit square's grid.

    Parameters
    ----------
    grid : ndarray, shape (H, W) or (C, H, W)
    x, y : ndarray, shape (N,)

    Returns
    -------
    ndarray, shape (N,) or (C, N)
    """
    row, fy = _cell(y, grid.shape[-2])
    column, fx = _cell(x, grid.shape[-1])
    low = (1 - fx) * grid[..., row, column] + fx * grid[..., row, column + 1]
    high = (1 - fx) * grid[..., row + 1, column] + fx * grid[..., row + 1, column + 1]
    return (1 - fy) * low + fy * high


class Warp:
    """The map of one density.

    Parameters
    ----------
    density : ndarray, shape (H, W)
        Not negative, not zero everywhere; need not be normalised.
    """

    def __init__(self, density: Array) -> None:
        height, width = density.shape
        self.conditional = _cumulative(density)
        self.marginal = self.conditional[:, -1]
        self.cumulative = _cumulative(self.marginal)
        scale = (height - 1) * (width - 1) / self.cumulative[-1]
        self.density = density * scale
        self.raw = density

    def invert(self, x: Array, y: Array) -> tuple[Array, Array]:
        """From points under the density to the uniform square."""
        row, fy = _cell(y, self.raw.shape[0])
        column, fx = _cell(x, self.raw.shape[1])
        m0, m1 = self.marginal[row], self.marginal[row + 1]
        v = (self.cumulative[row] + fy * (m0 + 0.5 * fy * (m1 - m0))) / self.cumulative[-1]
        c0 = (1 - fy) * self.raw[row, column] + fy * self.raw[row + 1, column]
        c1 = (1 - fy) * self.raw[row, column + 1] + fy * self.raw[row + 1, column + 1]
        before = (1 - fy) * self.conditional[row, column] + fy * self.conditional[row + 1, column]
        whole = (1 - fy) * m0 + fy * m1
        mass = before + fx * (c0 + 0.5 * fx * (c1 - c0))
        u = np.divide(mass, whole, out=np.zeros_like(mass), where=whole > 0)
        return np.clip(u, 0, 1), np.clip(v, 0, 1)

    def sample(self, u: Array, v: Array) -> tuple[Array, Array]:
        """From the uniform square to points under the density; the inverse of `invert`."""
        target = v * self.cumulative[-1]
        row = np.clip(np.searchsorted(self.cumulative, target, "right") - 1, 0, len(self.cumulative) - 2)
        m0, m1 = self.marginal[row], self.marginal[row + 1]
        fy = _solve(m0, m1, target - self.cumulative[row])
        conditional = (1 - fy)[:, None] * self.conditional[row] + fy[:, None] * self.conditional[row + 1]
        target = u * ((1 - fy) * m0 + fy * m1)
        column = np.clip(np.sum(conditional <= target[:, None], axis=1) - 1, 0, conditional.shape[1] - 2)
        n = np.arange(len(column))
        c0 = (1 - fy) * self.raw[row, column] + fy * self.raw[row + 1, column]
        c1 = (1 - fy) * self.raw[row, column + 1] + fy * self.raw[row + 1, column + 1]
        fx = _solve(c0, c1, target - conditional[n, column])
        return (column + fx) / (self.raw.shape[1] - 1), (row + fy) / (self.raw.shape[0] - 1)


def _cell(x: Array, n_nodes: int) -> tuple[NDArray[np.int64], Array]:
    """Node below, and the fraction of the way to the next."""
    position = np.clip(x, 0.0, 1.0) * (n_nodes - 1)
    low = np.minimum(position.astype(np.int64), n_nodes - 2)
    return low, position - low


def _cumulative(values: Array) -> Array:
    """Integral of the piecewise linear function of unit spacing up to each node, along the last axis."""
    steps = 0.5 * (values[..., 1:] + values[..., :-1])
    return np.concatenate([np.zeros((*values.shape[:-1], 1)), np.cumsum(steps, axis=-1)], axis=-1)


def _solve(p: Array, q: Array, mass: Array) -> Array:
    """Fraction of a unit segment of linear density from p to q below which `mass` lies, without cancellation."""
    root = p + np.sqrt(np.maximum(p * p + 2 * (q - p) * mass, 0))
    return np.clip(np.divide(2 * mass, root, out=np.zeros_like(root), where=root > 0), 0, 1)
