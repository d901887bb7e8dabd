"""Bilinear look-up on a grid of angles, for readers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def interpolate(
    grid: Array, x_nodes: Array, y_nodes: Array, x: Array, y: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Bilinear interpolation, and whether a point is within the nodes' range.

    Parameters
    ----------
    grid : ndarray, shape (X, Y, ...)
    x_nodes, y_nodes : ndarray
        Increasing; a single node holds everywhere.
    x, y : ndarray, shape (N,)

    Returns
    -------
    values : ndarray, shape (N, ...)
        Outside the range that of the closest point within.
    inside : ndarray of bool, shape (N,)
    """
    i, j, s = _locate(x_nodes, x)
    k, m, t = _locate(y_nodes, y)
    s = s.reshape(-1, *(1,) * (grid.ndim - 2))
    t = t.reshape(-1, *(1,) * (grid.ndim - 2))
    values = (1 - s) * ((1 - t) * grid[i, k] + t * grid[i, m]) + s * ((1 - t) * grid[j, k] + t * grid[j, m])
    return values, _inside(x_nodes, x) & _inside(y_nodes, y)


def _locate(nodes: Array, x: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    if len(nodes) == 1:
        zero = np.zeros(len(x), np.int64)
        return zero, zero, np.zeros(len(x))
    high = np.clip(np.searchsorted(nodes, x), 1, len(nodes) - 1)
    fraction = (x - nodes[high - 1]) / (nodes[high] - nodes[high - 1])
    return high - 1, high, np.clip(fraction, 0, 1)


def _inside(nodes: Array, x: Array) -> NDArray[np.bool_]:
    if len(nodes) == 1:
        return np.ones(len(x), bool)
    return (x >= nodes[0] - 1e-9) & (x <= nodes[-1] + 1e-9)


def close_circle(azimuths: Array, values: Array) -> tuple[Array, Array]:
    """Azimuths and values, shape (A, ...), continued by one node on either side of the full circle.

    Azimuths that end at half a turn (one side of a plane of symmetry) are left as they are.
    """
    if len(azimuths) < 2 or azimuths[-1] - azimuths[0] < np.pi + 1e-6:
        return azimuths, values
    if azimuths[-1] - azimuths[0] > 2 * np.pi - 1e-6:
        azimuths, values = azimuths[:-1], values[:-1]
    around = 2 * np.pi
    nodes = np.concatenate([[azimuths[-1] - around], azimuths, [azimuths[0] + around]])
    return nodes, np.concatenate([values[-1:], values, values[:1]])
