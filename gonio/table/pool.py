"""Tables laid out for the interpolation kernels: several tables in one set of flat arrays.

A renderer with twenty tabulated materials then runs one compiled kernel on one argument, and the type of
that argument never depends on how many tables there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.table.highlight import Highlight, bends_between, shape_energy, split

if TYPE_CHECKING:
    from gonio.table.table import Table

N_BUCKETS = 512
"""Uniform buckets per axis: from a coordinate to the few nodes that can enclose it, in one load."""

# Columns of Pool.header
(
    N_ROWS, N_U, N_PHI, N_CHANNELS, PEAK, VALUES, MEAN, AXES, BUCKETS, ROWS, MARGINAL, BENDS, N_HEADER,
) = range(13)  # fmt: skip


class Pool(NamedTuple):
    """Tables as flat arrays; which part belongs to which table stands in `header`.

    A table's peak (`gonio.table.highlight`) is laid out as a table of its own behind all others, over
    u = (slope/extent)^2 and psi: `values` are of q, and `mean` of g times the square of the extent, which integrates
    over du dpsi to the energy as f does over du dphi.

    Parameters
    ----------
    header : ndarray of int64, shape (tables and peaks, N_HEADER)
        Sizes (rows, nodes in u, nodes in phi, channels), which line is the table's peak (-1: it has none), and
        the first index into each array below.
    values : ndarray of float32
        Node values, (row, u, phi, channel), each row and channel divided by its maximum.
    mean : ndarray of float32
        (row, u, phi, 2): the channel mean fbar, and its cumulative integral over phi.
    axes : ndarray of float64
        Nodes: sin^2 theta_i of the rows, u = sin^2 theta_r from 0 to 1, delta phi from 0 to pi.
    buckets : ndarray of int32
        Three times N_BUCKETS + 1: the last node at or below the start of each bucket of an axis.
    rows : ndarray of float64
        (row, 1 + 3 C): the integral of fbar, then per channel the factor on `values`, the albedo without
        delta term, and the delta term.
    marginal : ndarray of float64
        (row, u, 2): fbar integrated over phi, and the cumulative integral of that over u.
    bends : ndarray of float64
        Of a peak, (row, 2, C): between this row and the next its albedo is a straight line and
        x (1 - x) (p + q x); p and q, and what x is, as `gonio.table.highlight.bends_between`.
    extent : ndarray of float64, shape (tables and peaks,)
        Of a peak, its largest slope.
    alpha : ndarray of float64, shape (tables and peaks,)
        Of a peak, the roughness its grid was made for.
    """

    header: NDArray[np.int64]
    values: NDArray[np.float32]
    mean: NDArray[np.float32]
    axes: NDArray[np.float64]
    buckets: NDArray[np.int32]
    rows: NDArray[np.float64]
    marginal: NDArray[np.float64]
    bends: NDArray[np.float64]
    extent: NDArray[np.float64]
    alpha: NDArray[np.float64]


def pool_tables(tables: Sequence[Table]) -> Pool:
    """Lay out tables for the kernels of `gonio.table.interpolation`; table t of the list is table t there.

    Parameters
    ----------
    tables : sequence of Table
        May be empty.

    Returns
    -------
    Pool
        About 4 bytes x (channels + 2) per cell.
    """
    pairs = [_functions(table) for table in tables]
    peaks = [(t, table.peak) for t, table in enumerate(tables) if table.peak is not None]
    functions = [own for own, _ in pairs] + [above for _, above in pairs if above is not None]
    parts = [_layout(function) for function in functions]
    header = np.zeros((len(parts), N_HEADER), np.int64)
    header[:, PEAK] = -1
    for line, (t, _) in enumerate(peaks, len(tables)):
        header[t, PEAK] = line
    extent = np.array([1.0] * len(tables) + [peak.extent for _, peak in peaks])
    alpha = np.array([1.0] * len(tables) + [peak.alpha for _, peak in peaks])
    for t, (sizes, _) in enumerate(parts):
        header[t, :PEAK] = sizes
        if t > 0:
            header[t, VALUES:] = header[t - 1, VALUES:] + [a.size for a in parts[t - 1][1]]
    dtypes = (np.float32, np.float32, np.float64, np.int32, np.float64, np.float64, np.float64)
    flat = [
        np.concatenate([arrays[n].ravel() for _, arrays in parts] or [np.zeros(0, dtype)])
        for n, dtype in enumerate(dtypes)
    ]
    values, mean, axes, buckets, rows, marginal, bends = flat
    return Pool(header, values, mean, axes, buckets, rows, marginal, bends, extent, alpha)


class _Function(NamedTuple):
    """What is laid out: a table's light without its peak, or a peak."""

    table: Table
    """Whose rows it has."""
    values: NDArray[np.float64]
    """(I, R, P, C)"""
    u_edges: NDArray[np.float64]
    """From 0 to 1."""
    phi_edges: NDArray[np.float64]
    energy: NDArray[np.float64]
    """(I, C) what each row is to integrate to."""
    specular: NDArray[np.float64]
    """(I, C)"""
    highlight: Highlight | None = None
    """Whose g the values are."""


def _functions(table: Table) -> tuple[_Function, _Function | None]:
    """A table's light on its own grid, and on that of its peak."""
    u_edges = np.sin(table.theta_r_edges) ** 2
    energy = table.row_albedo - table.specular
    peak = table.peak
    if peak is None:
        own = _Function(table, table.values, u_edges, table.delta_phi_edges, energy, table.specular)
        return own, None
    values, highlight = split(table, peak)
    taken = highlight.energy
    own = _Function(table, values, u_edges, table.delta_phi_edges, energy - taken, table.specular)
    u_edges = (peak.slope_edges / peak.extent) ** 2
    nothing = np.zeros_like(taken)
    return own, _Function(table, highlight.drawn, u_edges, peak.psi_edges, taken, nothing, highlight)


def _layout(function: _Function) -> tuple[tuple[int, int, int, int], list[NDArray]]:
    """Sizes and arrays of one function, in the order of the Pool's fields."""
    table, u_edges, phi_edges, highlight = (
        function.table, function.u_edges, function.phi_edges, function.highlight,
    )  # fmt: skip
    u = np.concatenate([[0.0], 0.5 * (u_edges[1:] + u_edges[:-1]), [1.0]])
    phi = np.concatenate([[0.0], 0.5 * (phi_edges[1:] + phi_edges[:-1]), [np.pi]])
    u_i, sources, average = _row_nodes(table)
    weight_u, weight_phi = trapezoid_weights(u), trapezoid_weights(phi)
    n_rows, n_channels = len(u_i), function.values.shape[3]
    values = np.empty((n_rows, len(u), len(phi), n_channels), np.float32)
    mean = np.empty((n_rows, len(u), len(phi), 2), np.float32)
    rows = np.empty((n_rows, 1 + 3 * n_channels))
    marginal = np.empty((n_rows, len(u), 2))
    bends = np.zeros((0 if highlight is None else n_rows, 2, n_channels))
    for row, source in enumerate(sources):
        drawn = nodes = _nodes(function, function.values[source], average[row], u, weight_phi)
        if highlight is not None:
            nodes = _nodes(function, highlight.shape[source], average[row], u, weight_phi)
        # float32 halves the memory traffic; what rounding takes from the integral, the factor gives back
        values[row] = nodes / np.maximum(nodes.max(axis=(0, 1)), np.finfo(float).tiny)
        rounded = values[row].astype(float)
        if highlight is None:
            integral = np.einsum("u,p,upc->c", weight_u, weight_phi, rounded)
        else:
            integral = shape_energy(rounded, u, phi, float(np.arcsin(np.sqrt(u_i[row]))), highlight.peak)
        target = np.maximum(function.energy[source], 0.0)
        factor = np.divide(target, integral, out=np.zeros(n_channels), where=integral > 0)
        if highlight is None:
            mean[row, :, :, 0] = values[row] @ (factor / n_channels)
        else:
            energy = np.einsum("u,p,upc->", weight_u, weight_phi, drawn)
            mean[row, :, :, 0] = drawn.sum(axis=2) * (target.mean() / energy if energy > 0 else 0.0)
        fbar = mean[row, :, :, 0].astype(float)
        mean[row, :, :, 1] = cumulative(fbar, phi)
        # from the rounded cumulative sums, so that marginal and conditional agree to the last bit
        marginal[row, :, 0] = fbar @ weight_phi
        marginal[row, :, 1] = cumulative(marginal[row, :, 0], u)
        rows[row, 0] = marginal[row, -1, 1]
        rows[row, 1:] = np.concatenate([factor, factor * integral, function.specular[source]])
    if highlight is not None:
        scaled = values.astype(float) * rows[:, None, None, 1 : 1 + n_channels]
        bends[:-1] = bends_between(scaled, u, phi, u_i, highlight.peak)
    buckets = np.concatenate([_buckets(u_i, 1.0), _buckets(u, 1.0), _buckets(phi, np.pi)])
    sizes = (n_rows, len(u), len(phi), n_channels)
    return sizes, [values, mean, np.concatenate([u_i, u, phi]), buckets, rows, marginal, bends]


def _nodes(
    function: _Function, cells: NDArray, average: bool, u: NDArray, weight_phi: NDArray
) -> NDArray[np.float64]:
    """Node values of one row from its cells, as `extend_row`; averaged over the azimuth where that has no meaning."""
    nodes = extend_row(cells, weight_phi)
    if function.highlight is not None:
        # a straight line on to the pole: half a cell more of a Gaussian's slope
        line = (1.0 + u[1] / (u[2] - u[1])) * nodes[1] - u[1] / (u[2] - u[1]) * nodes[2]
        nodes[0] = np.maximum(weight_phi @ line, 0.0) / np.pi
    if average:
        nodes[:] = (np.einsum("p,upc->uc", weight_phi, nodes) / np.pi)[:, None]
    return nodes


def _row_nodes(table: Table) -> tuple[NDArray, list[int], list[bool]]:
    """Nodes in sin^2 theta_i; for each the table's row it comes from and whether to average over phi.

    A row that is a cell of incidence stands at the middle of its interval of sin^2 theta_i: the average of
    anything linear in that variable is its value there. At normal incidence an isotropic surface knows no
    delta phi, so the node at 0 is the average over phi of the row that touches it. A peak's energy depends on theta_i
    also where its q does not: with a peak, the last row stands again at halves of its cosine, down to where facets are
    hidden, and at grazing incidence.
    """
    sources = list(range(len(table.theta_i)))
    average = [False] * len(sources)
    if table.theta_i_edges is None:
        u_i = np.sin(table.theta_i) ** 2
        average[0] = bool(u_i[0] < 1e-12)
    else:
        edges = np.sin(table.theta_i_edges) ** 2
        u_i = 0.5 * (edges[1:] + edges[:-1])
        if edges[0] < 1e-12:
            u_i, sources, average = np.concatenate([[0.0], u_i]), [0, *sources], [True, *average]
    if table.peak is not None and u_i[-1] < 1.0 - 1e-12:
        cosine = np.sqrt(1.0 - u_i[-1])
        halvings = np.arange(1, max(0, int(np.ceil(np.log2(cosine / (2.0 * table.peak.alpha))))) + 1)
        cosines = np.append(cosine * 0.5**halvings, 0.0)
        u_i = np.append(u_i, 1.0 - cosines**2)
        sources, average = sources + len(cosines) * sources[-1:], average + len(cosines) * [False]
    return u_i, sources, average


def extend_row(cells: NDArray, weight_phi: NDArray) -> NDArray[np.float64]:
    """Node values of one row, shape (R + 2, P + 2, C), from its cells, shape (R, P, C).

    Constant from the outermost centres to the horizon and to delta phi 0 and pi. At the pole, u = 0, the
    azimuth has no meaning: the node there is the innermost ring's average over phi. Negative values, noise
    of estimators and measurements, count as 0.
    """
    nodes = np.pad(np.maximum(cells, 0.0), ((1, 1), (1, 1), (0, 0)), mode="edge")
    nodes[0] = weight_phi @ nodes[1] / np.pi
    return nodes


def trapezoid_weights(nodes: NDArray) -> NDArray[np.float64]:
    """Weights whose dot product with node values is the integral of the piecewise linear function."""
    steps = np.diff(nodes)
    weights = np.zeros(len(nodes))
    weights[:-1] += 0.5 * steps
    weights[1:] += 0.5 * steps
    return weights


def cumulative(values: NDArray, nodes: NDArray) -> NDArray:
    """Integral of the piecewise linear function up to each node, along the last axis."""
    masses = 0.5 * (values[..., 1:] + values[..., :-1]) * np.diff(nodes)
    return np.concatenate([np.zeros((*values.shape[:-1], 1)), np.cumsum(masses, axis=-1)], axis=-1)


def _buckets(nodes: NDArray, extent: float) -> NDArray[np.int32]:
    """For each bucket edge over [0, extent] the last node at or below it, at most the last but one."""
    starts = np.linspace(0.0, extent, N_BUCKETS + 1)
    below = np.searchsorted(nodes, starts, side="right") - 1
    return np.clip(below, 0, max(0, len(nodes) - 2)).astype(np.int32)
