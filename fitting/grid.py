"""Quadrature nodes of a table's cells: the average of a model over a cell is what a table holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fitting.kernels import cell_terms
from gonio.table.table import Table

Array = NDArray[np.float64]

LEVELS = 5
"""Level l has 2**l nodes an axis; 16 at most."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells (row, ring, sector) and where in them a model is evaluated.

    Parameters
    ----------
    rows, rings, sectors : ndarray, shape (levels, n, nodes, 3)
        Sine, cosine and weight of each node of theta_i, theta_r and delta phi; weights of a cell sum to
        1 and follow the projected solid angle.
    exact_rows : bool
        Rows are single angles of incidence, not intervals.
    """

    rows: Array
    rings: Array
    sectors: Array
    exact_rows: bool

    @classmethod
    def of_table(cls, table: Table) -> Grid:
        """Nodes of a table's cells."""
        exact = table.theta_i_edges is None
        rows = (
            _exact(table.theta_i) if table.theta_i_edges is None else _nodes(table.theta_i_edges, polar=True)
        )
        rings = _nodes(table.theta_r_edges, polar=True)
        return cls(rows, rings, _nodes(table.delta_phi_edges, polar=False), exact)

    @classmethod
    def of_directions(cls, theta_i: ArrayLike, theta_r: ArrayLike, delta_phi: ArrayLike) -> Grid:
        """One point a cell, number n at (n, n, n): single measurements, radians, shape (N,) each."""
        return cls(_exact(theta_i)[:1], _exact(theta_r)[:1], _exact(delta_phi)[:1], True)

    def terms(
        self,
        kinds: NDArray[np.int64],
        shapes: Array,
        cells: NDArray[np.int32],
        levels: int | NDArray[np.int8],
    ) -> Array:
        """Averages of each lobe's two terms over cells, 1/sr, shape (N, 2 L); see `fitting.kernels`."""
        each = np.broadcast_to(np.asarray(levels, np.int8), len(cells)).copy()
        return cell_terms(kinds, shapes, (self.rows, self.rings, self.sectors), cells, each, self.exact_rows)

    def near_mirror(self, cells: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Cells within two cells of the mirror direction, where lobes are narrowest, shape (N,)."""
        i, r, s = cells.T
        ring = np.searchsorted(self.rings[0, :, 0, 0], self.rows[0, :, 0, 0]).astype(np.int32)
        return (np.abs(r - ring[i]) <= 2) & ((s >= self.sectors.shape[1] - 2) | (r <= 2))


def _nodes(edges: Array, polar: bool) -> Array:
    """Gauss-Legendre nodes of every interval at every level; one node stands at the centroid."""
    out = np.zeros((LEVELS, len(edges) - 1, 2 ** (LEVELS - 1), 3))
    lower, width = edges[:-1, None], np.diff(edges)[:, None]
    for level in range(LEVELS - 1, -1, -1):
        n = 2**level
        x, w = np.polynomial.legendre.leggauss(n)
        angles = lower + 0.5 * width * (x + 1.0)
        weights = np.tile(w, (len(edges) - 1, 1))
        if polar:
            weights = weights * np.sin(2.0 * angles)  # projected solid angle
        weights /= weights.sum(axis=1, keepdims=True)
        if level == LEVELS - 1:
            centroid = np.sum(weights * angles, axis=1, keepdims=True)
        if level == 0:
            angles = centroid
        out[level, :, :n] = np.stack([np.sin(angles), np.cos(angles), weights], axis=-1)
    return out


def _exact(angles: ArrayLike) -> Array:
    angles = np.asarray(angles, float)
    node = np.stack([np.sin(angles), np.cos(angles), np.ones_like(angles)], axis=-1)
    return np.tile(node[None, :, None, :], (LEVELS, 1, 1, 1))
