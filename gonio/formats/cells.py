"""From values a format gives at points to the cells of a table.

Two ways: `average_cells` for formats that can be evaluated anywhere (the cells are averages over points of
equal projected solid angle), and `cells_around` for formats sampled at angles from the normal (each sample
becomes the value of the cell around it, so nothing is interpolated).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import projected_solid_angles
from gonio.table.table import Table
from microgeometry.errors import InputError

Array = NDArray[np.float64]
Look = Callable[[int, Array, Array], tuple[Array, NDArray[np.bool_]]]

_SPACE = 4 << 20  # bytes any file may ask for,
_PER_BYTE = 54  # how many for each of its own,
_AT_MOST = 400 << 20  # and how many a grid chosen here takes
_REACH = np.radians(10.0)  # a sample speaks for no more than this around it,
_FAR = np.radians(22.5)  # or than this where all are far apart


def check_size(path: Path, n_values: float, what: str) -> None:
    """Refuse a table out of proportion to the file that asks for it.

    Raises
    ------
    InputError
        `n_values` numbers of 8 bytes are more than 4 MiB and more than 54 times the file.
    """
    if 8 * n_values > justified_bytes(path):
        raise InputError(
            f"{path}: {what} ask for {n_values:.3g} numbers, more than a file of {path.stat().st_size} bytes "
            "justifies; is it damaged?"
        )


def justified_bytes(path: Path) -> int:
    """What a file of this size may ask for."""
    return max(_SPACE, _PER_BYTE * path.stat().st_size)


def uniform_grid(path: Path, n_channels: int, finest: int = 90) -> int:
    """Cells per quarter turn, as many as `finest` and as the file's size justifies.

    Returns
    -------
    int
        n for a grid of n rows, n rings and 2 n sectors.
    """
    allowed = min(_AT_MOST, justified_bytes(path))
    for n in (90, 60, 45, 30, 18, 10):
        if n <= finest and 16 * n**3 * n_channels <= allowed:
            return n
    check_size(path, 2 * 6**3 * n_channels, f"{n_channels} channels")
    return 6


def average_cells(
    look: Look,
    n_rows: int,
    theta_r_edges: Array,
    delta_phi_edges: Array,
    n_channels: int,
    points: tuple[int, int] = (2, 1),
) -> tuple[Array, NDArray[np.bool_]]:
    """Averages over cells and both signs of delta phi of what `look` finds.

    Parameters
    ----------
    look : callable
        From a row and angles theta_r, delta phi, shape (N,) each, radians, delta phi in [-pi, pi], to values,
        shape (N, C), and whether they are known, shape (N,).
    n_rows : int
    theta_r_edges, delta_phi_edges : ndarray
        As in `Table`.
    n_channels : int
    points : tuple of int
        Points per cell in theta_r and in delta phi, at midpoints of equal projected solid angle.

    Returns
    -------
    values : ndarray, shape (n_rows, R, P, C)
        0 in cells without any known point.
    gaps : ndarray of bool, shape (n_rows, R, P)
    """
    rings, sectors = len(theta_r_edges) - 1, len(delta_phi_edges) - 1
    theta = np.arcsin(np.sqrt(midpoints(np.sin(theta_r_edges) ** 2, points[0])))
    phi = midpoints(delta_phi_edges, points[1])
    shape = (rings * points[0], 2, sectors * points[1])
    theta_flat = np.broadcast_to(theta.reshape(-1, 1, 1), shape).ravel()
    phi_flat = np.broadcast_to(np.stack([phi.ravel(), -phi.ravel()])[None], shape).ravel()
    values = np.zeros((n_rows, rings, sectors, n_channels))
    gaps = np.empty((n_rows, rings, sectors), bool)
    for row in range(n_rows):
        found, known = look(row, theta_flat, phi_flat)
        found = found.reshape(rings, points[0], 2, sectors, points[1], n_channels)
        known = known.reshape(rings, points[0], 2, sectors, points[1])
        count = known.sum(axis=(1, 2, 4))
        values[row] = np.where(known[..., None], found, 0.0).sum(axis=(1, 2, 4))
        values[row] /= np.maximum(count, 1)[..., None]
        gaps[row] = count == 0
    return values, gaps


def midpoints(edges: Array, points: int) -> Array:
    """Midpoints of equal parts of each interval, shape (intervals, points)."""
    inside = (np.arange(points) + 0.5) / points
    return edges[:-1, None] + inside * np.diff(edges)[:, None]


def cells_around(nodes: Array, last: float, reach: float | None = None) -> tuple[Array, NDArray[np.int64]]:
    """Cells that hold one node each, with edges midway between the nodes, from 0 to `last`.

    Where nodes are far apart a cell ends 10 degrees from its node, or at half of the closest spacing, up to
    22.5 degrees; beyond the outermost node, at the distance to the next if that is less. Cells without a node fill the
    space, beside a node's cell one of its size: what the interpolant, which falls to 0 between their middles, has
    on one side of the edge it lacks on the other. (Down a ramp over all of the space it would have more light than the
    cells, and be scaled down to their albedo: in the plane of incidence to a hundredth of the samples.)

    Parameters
    ----------
    nodes : ndarray, shape (N,)
        Radians, increasing within [0, last].
    last : float
        pi/2 or pi.
    reach : float, optional
        In place of the 10 to 22.5 degrees.

    Returns
    -------
    edges : ndarray, shape (M + 1,)
    source : ndarray of int, shape (M,)
        Which node stands for the cell, -1 for none.
    """
    if reach is None:
        reach = _REACH
        if len(nodes) > 1:
            reach = max(reach, min(_FAR, 0.5 * float(np.diff(nodes).min())))
    ends = np.concatenate([[0.0], 0.5 * (nodes[1:] + nodes[:-1]), [last]])
    below, above = np.full((2, len(nodes)), reach)
    if len(nodes) > 1:
        below[0], above[-1] = np.minimum(reach, np.diff(nodes)[[0, -1]])
    # a tenth more is rounding of the nodes, and no space of its own
    low = np.where(nodes - ends[:-1] > 1.1 * below, nodes - below, ends[:-1])
    high = np.where(ends[1:] - nodes > 1.1 * above, nodes + above, ends[1:])
    edges, source = [0.0], []
    for n in range(len(nodes)):
        if low[n] > edges[-1] + 1e-9:
            edges.append(low[n])
            source.append(-1)
        edges.append(high[n])
        source.append(n)
    if edges[-1] < last - 1e-9:
        edges.append(last)
        source.append(-1)
    edges[-1] = last
    # in the coordinates in which tables are interpolated and integrated
    flat = np.array(edges) if last > 3 else np.sin(edges) ** 2
    before, size, after = (np.pad(np.diff(flat), 1)[k : k + len(source)] for k in range(3))
    split = (np.array(source) < 0) & (before + after < size)
    low_cut, high_cut = ((flat[:-1] + before)[split & (before > 0)], (flat[1:] - after)[split & (after > 0)])
    cuts = np.concatenate([low_cut, high_cut])
    cuts = cuts if last > 3 else np.arcsin(np.sqrt(cuts))
    where = np.searchsorted(edges, cuts)
    order = np.argsort(cuts)
    return np.insert(edges, where[order], cuts[order]), np.insert(source, where[order] - 1, -1)


def table_of(
    values: Array,
    gaps: NDArray[np.bool_],
    theta_i: Array,
    theta_r_edges: Array,
    delta_phi_edges: Array,
    channels: tuple[str, ...],
    **fields: Any,
) -> Table:
    """A table whose albedo is the sum over its cells; other fields as in `Table`."""
    areas = projected_solid_angles(theta_r_edges, delta_phi_edges)
    return Table(
        values=values,
        theta_i=theta_i,
        theta_r_edges=theta_r_edges,
        delta_phi_edges=delta_phi_edges,
        channels=channels,
        row_albedo=np.einsum("irpc,rp->ic", values, areas),
        gaps=gaps if gaps.any() else None,
        **fields,
    )


def row_centres(edges: Array) -> Array:
    """The angle in each row of incidence that stands for it: the middle in sin^2 theta."""
    u = np.sin(edges) ** 2
    return np.arcsin(np.sqrt(0.5 * (u[1:] + u[:-1])))
