"""Anisotropic tables laid out for the kernels of `gonio.table.anisotropic_interpolation`.

As `gonio.table.pool`: several tables in one set of flat arrays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import direction
from gonio.core.jit import kernel
from gonio.core.parallel import for_each
from gonio.table.pool import cumulative, trapezoid_weights
from gonio.table.tilts import from_tilts, slope_widths, to_tilts

if TYPE_CHECKING:
    from gonio.table.anisotropic import AnisotropicTable

Array = NDArray[np.float64]

_LEAST = 1e-4  # cosine that stands in for 0
_LEAST_SHARE = 0.1  # of its neighbours' mean weight that lets a cell speak for itself

ROW = 4
"""Numbers in front of those of channels in a line of AnisotropicPool.rows."""

# Columns of AnisotropicPool.header
A_THETA, A_PHI, A_X, A_Y, A_CHANNELS, A_VALUES, A_MEAN, A_AXES, A_ROWS, A_MARGINAL, N_COLUMNS = range(11)


class AnisotropicPool(NamedTuple):
    """Tables as flat arrays; which part belongs to which table stands in `header`.

    Parameters
    ----------
    header : ndarray of int64, shape (tables, N_COLUMNS)
        Sizes (angles theta_i, angles phi_i, nodes in x, nodes in y, channels), first index into each array below.
    values : ndarray of float32
        q of `gonio.table.anisotropic_interpolation` at the nodes, (theta_i, phi_i, x, y, channel), each row and channel
        divided by its maximum.
    mean : ndarray of float32
        (theta_i, phi_i, x, y, 2): the channel mean's energy per dx dy, and its cumulative integral over y.
    axes : ndarray of float64
        Nodes: theta_i, x, y, radians.
    rows : ndarray of float64
        (theta_i, phi_i, ROW + 3 C): the integral of `mean`, the direction to the light, then per channel the factor
        on `values`, the albedo without delta term, and the delta term.
    marginal : ndarray of float64
        (theta_i, phi_i, x, 2): `mean` integrated over y, and the cumulative integral of that over x.
    widths : ndarray of float64, shape (tables, 2)
        Of slopes along x and y, `gonio.table.tilts.slope_widths`.
    """

    header: NDArray[np.int64]
    values: NDArray[np.float32]
    mean: NDArray[np.float32]
    axes: Array
    rows: Array
    marginal: Array
    widths: Array

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return sum(array.nbytes for array in self)


def pool_anisotropic(tables: Sequence[AnisotropicTable]) -> AnisotropicPool:
    """Lay out tables for the kernels; table t of the list is table t there.

    Parameters
    ----------
    tables : sequence of AnisotropicTable
        May be empty.

    Returns
    -------
    AnisotropicPool
        About 4 bytes x (channels + 2) per cell.
    """
    layouts = [_layout(table) for table in tables]
    header = np.zeros((len(layouts), N_COLUMNS), np.int64)
    for t, (sizes, _) in enumerate(layouts):
        header[t, :A_VALUES] = sizes
        if t > 0:
            header[t, A_VALUES:] = header[t - 1, A_VALUES:] + [a.size for a in layouts[t - 1][1]]
    widths = np.zeros((len(tables), 2))
    for t, table in enumerate(tables):
        widths[t] = slope_widths(table.tilt_x_edges, table.tilt_y_edges)
    dtypes = (np.float32, np.float32, np.float64, np.float64, np.float64)
    if len(layouts) == 1:  # tens of megabytes: not twice
        flat = [array.ravel() for array in layouts[0][1]]
    else:
        flat = [
            np.concatenate([arrays[n].ravel() for _, arrays in layouts] or [np.zeros(0, dtype)])
            for n, dtype in enumerate(dtypes)
        ]
    values, mean, axes, rows, marginal = flat
    return AnisotropicPool(header, values, mean, axes, rows, marginal, widths)


def _layout(table: AnisotropicTable) -> tuple[tuple[int, ...], list[NDArray]]:
    """Sizes and arrays of one table, in the order of the pool's fields."""
    x_edges, y_edges = table.tilt_x_edges, table.tilt_y_edges
    x, y = _nodes(x_edges), _nodes(y_edges)
    weight_y = trapezoid_weights(y)
    n_theta, n_phi, _, _, n_channels = table.energy.shape
    widths = slope_widths(x_edges, y_edges)
    areas = np.outer(np.diff(x_edges), np.diff(y_edges))
    values = np.zeros((n_theta, n_phi, len(x), len(y), n_channels), np.float32)
    mean = np.zeros((n_theta, n_phi, len(x), len(y), 2), np.float32)
    rows = np.zeros((n_theta, n_phi, ROW + 3 * n_channels))
    marginal = np.zeros((n_theta, n_phi, len(x), 2))

    def lay(row: int) -> None:
        a, b = divmod(row, n_phi)
        energy = np.maximum(table.energy[a, b], 0.0).astype(float)
        wi = tuple(direction(table.theta_i[a], table.phi_i[b]).tolist())
        weights = np.zeros((2 * areas.shape[0], 2 * areas.shape[1]))
        measure(wi, x_edges, y_edges, widths, weights)
        cells = weights.reshape(areas.shape[0], 2, areas.shape[1], 2).sum(axis=(1, 3))
        nodes = _levels(energy, cells[..., None])
        largest = np.maximum(nodes.max(axis=(0, 1)), np.finfo(float).tiny)
        values[a, b] = np.pad(nodes / largest, ((1, 1), (1, 1), (0, 0)), mode="edge")
        integral = np.zeros(n_channels)
        integrate(values[a, b], x, y, x_edges, y_edges, weights, integral)
        target = np.maximum(table.row_albedo[a, b] - table.specular[a, b], 0.0)
        factor = np.divide(target, integral, out=np.zeros(n_channels), where=integral > 0)
        density = mean[a, b, :, :, 0]
        density[1:-1, 1:-1] = energy.mean(axis=2) / areas
        fbar = density.astype(float)
        mean[a, b, :, :, 1] = cumulative(fbar, y)
        # from the rounded sums, so that marginal and conditional agree to the last bit
        marginal[a, b, :, 0] = fbar @ weight_y
        marginal[a, b, :, 1] = cumulative(marginal[a, b, :, 0], x)
        rows[a, b, 0] = marginal[a, b, -1, 1]
        rows[a, b, 1:] = np.concatenate([wi, factor, factor * integral, table.specular[a, b]])

    for_each(lay, n_theta * n_phi, None)
    sizes = (n_theta, n_phi, len(x), len(y), n_channels)
    return sizes, [values, mean, np.concatenate([table.theta_i, x, y]), rows, marginal]


def _nodes(edges: Array) -> Array:
    """Middles of the cells, and both ends: they are the horizon."""
    return np.concatenate([edges[:1], 0.5 * (edges[1:] + edges[:-1]), edges[-1:]])


def _levels(energy: Array, weights: Array) -> Array:
    """Energy over weight of each cell, shape (X, Y, C); a cell of next to no weight is as its neighbours are.

    Where the horizon leaves hardly anything of a cell, one path too many, or an error of quadrature, would make it the
    brightest of the row.
    """
    total, around = _blocks(energy), _blocks(weights)
    missing = np.maximum(_LEAST_SHARE / 9.0 * around - weights, 0.0)
    return (energy + missing * total / around) / (weights + missing)


def _blocks(cells: Array) -> Array:
    """Sum over each cell and its neighbours, shape (X, Y, C)."""
    padded = np.pad(cells, ((1, 1), (1, 1), (0, 0)))
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    return rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]


@kernel(allocates=False)
def _masked(w, widths):
    """Smith's Lambda of a surface of these widths of slopes, times cos(theta).

    Rational, where `gonio.core.masking` has an erf and an exp for each direction of each value: what is divided out
    need not be exact.

    Walter et al. 2007, Microfacet models for refraction, section 5.2: a rational approximation for Beckmann's.
    """
    z = max(w[2], _LEAST)
    across = math.sqrt((widths[0] * w[0]) ** 2 + (widths[1] * w[1]) ** 2)
    if z >= 1.6 * across:
        return 0.0
    a = z / across
    return across * (1.0 - 1.259 * a + 0.396 * a * a) / (3.535 + 2.181 * a)


@kernel(allocates=False)
def shadowing(wi, wo, widths):
    """G / (cos theta_i cos theta_o) of a surface of these widths of slopes, G height-correlated (Heitz 2014, 99)."""
    zi, zo = max(wi[2], _LEAST), max(wo[2], _LEAST)
    return 1.0 / (zi * zo + zo * _masked(wi, widths) + zi * _masked(wo, widths))


@kernel(allocates=False)
def measure(wi, x_edges, y_edges, widths, weights):
    """Of each quarter of a cell: the integral of `shadowing` over its projected solid angle.

    Parameters
    ----------
    weights : ndarray, shape (2 X, 2 Y)
        Receives it; by the middle of the quarter.
    """
    for j in range(weights.shape[0]):
        step_x = 0.5 * (x_edges[j // 2 + 1] - x_edges[j // 2])
        x = x_edges[j // 2] + (j % 2 + 0.5) * step_x
        for k in range(weights.shape[1]):
            step_y = 0.5 * (y_edges[k // 2 + 1] - y_edges[k // 2])
            wo = from_tilts(wi, x, y_edges[k // 2] + (k % 2 + 0.5) * step_y, widths)
            _, _, density = to_tilts(wi, wo, widths)
            weights[j, k] = step_x * step_y / density * wo[2] * shadowing(wi, wo, widths)


@kernel(allocates=False)
def integrate(values, x, y, x_edges, y_edges, weights, out):
    """Sum of weights (of `measure`) times the bilinear function with these node values, one a channel."""
    for j in range(weights.shape[0]):
        at = x_edges[j // 2] + (j % 2 + 0.5) * 0.5 * (x_edges[j // 2 + 1] - x_edges[j // 2])
        a = j // 2 + j % 2  # the node below
        s = (at - x[a]) / (x[a + 1] - x[a])
        for k in range(weights.shape[1]):
            at = y_edges[k // 2] + (k % 2 + 0.5) * 0.5 * (y_edges[k // 2 + 1] - y_edges[k // 2])
            b = k // 2 + k % 2
            t = (at - y[b]) / (y[b + 1] - y[b])
            for c in range(out.shape[0]):
                low = (1.0 - t) * values[a, b, c] + t * values[a, b + 1, c]
                high = (1.0 - t) * values[a + 1, b, c] + t * values[a + 1, b + 1, c]
                out[c] += weights[j, k] * ((1.0 - s) * low + s * high)
