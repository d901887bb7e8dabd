"""Tables from loose samples: lists of directions with a value each, as CSV, ASTM E1392 and OpenMATERIAL hold.

Samples that stand on a grid of angles (most of its places taken) keep it: a cell around each. Where one light was
measured at other theta_r than another, the places that are missing between its own samples are interpolated. Others
are averaged in uniform cells. Where the light or the detector stands on the normal an azimuth means nothing:
such a sample holds for all.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.formats.cells import cells_around, check_size, table_of
from gonio.formats.samples import Samples
from gonio.table.table import Table
from microgeometry.errors import InputError

Array = NDArray[np.float64]

_SAME = np.radians(0.02)  # angles closer than this are one
_SPARSE = 4.0  # places of a grid per sample
_REACH = np.radians(10.0)  # to samples on either side of a place without one


def table_from_points(
    path: Path,
    samples: Samples,
    channels: tuple[str, ...],
    std_error: Array | None = None,
    azimuth_reach: float | None = None,
    **fields: Any,
) -> Table:
    """A table of samples; places without one, and not between two, are gaps. Samples of one place are averaged.

    Parameters
    ----------
    path : Path
        Their file.
    samples : Samples
        Of theta_i and theta_r in [0, pi/2].
    channels : tuple of str
    std_error : ndarray, shape (N, C), optional
    azimuth_reach : float, optional
        Radians of delta phi on either side that a sample speaks for, where others are farther.
    **fields
        As in `Table`.

    Raises
    ------
    InputError
        No samples, or angles out of range.
    """
    theta_i, theta_r, values = samples.theta_i, samples.theta_r, samples.values
    if len(theta_i) == 0:
        raise InputError(f"{path}: holds no samples")
    for name, angle in (("theta_i", theta_i), ("theta_r", theta_r)):
        if angle.min() < -1e-6 or angle.max() > np.pi / 2 + 1e-5:
            raise InputError(
                f"{path}: {name} from {np.degrees(angle.min()):.4g} to {np.degrees(angle.max()):.4g} degrees; "
                "0 to 90 is allowed"
            )
    delta_phi = samples.folded
    rows, row = _nodes(np.clip(theta_i, 0, np.pi / 2))
    rings, ring = _nodes(np.clip(theta_r, 0, np.pi / 2))
    sectors, sector = _nodes(delta_phi)
    if len(rows) * len(rings) * len(sectors) <= _SPARSE * len(theta_i):
        edges, ring_source = cells_around(rings, np.pi / 2)
        phi_edges, sector_source = cells_around(sectors, np.pi, azimuth_reach)
        on_normal = (rows < _SAME)[:, None] | np.append(rings < _SAME, False)[ring_source]
        ring, sector = _cell_of(ring_source)[ring], _cell_of(sector_source)[sector]
        reach = _REACH
    else:
        if len(rows) > 90:
            rows, row = _bins(theta_i, np.pi / 2, 90)
        n = int(np.clip(np.sqrt(len(theta_i) / len(rows)), 6, 90))
        edges, phi_edges = np.linspace(0, np.pi / 2, n + 1), np.linspace(0, np.pi, n + 1)
        ring = np.minimum((theta_r / (np.pi / 2) * n).astype(int), n - 1)
        sector = np.minimum((delta_phi / np.pi * n).astype(int), n - 1)
        on_normal = np.zeros((len(rows), n), bool)
        reach = 0.0
    shape = (len(rows), len(edges) - 1, len(phi_edges) - 1)
    n_channels = values.shape[1]
    check_size(path, float(np.prod(shape)) * n_channels, "angles")
    place = np.ravel_multi_index((row, ring, sector), shape)

    def total(numbers: Array) -> Array:
        """Sums over the samples of each cell, shape (I, R, P)."""
        sums = np.bincount(place, numbers, int(np.prod(shape))).astype(float).reshape(shape)
        sums[on_normal] = sums[on_normal].sum(axis=1, keepdims=True)
        return sums

    count = total(np.ones(len(place)))[..., None]
    below, above, part = _between(count[..., 0] > 0, edges, reach)
    gaps = (count[..., 0] == 0) & (below == above)

    def between(numbers: Array) -> Array:
        """Cells of shape (I, R, P, C), with those interpolated that are between others."""
        low, high = (np.take_along_axis(numbers, n[..., None], 1) for n in (below, above))
        return low + part[..., None] * (high - low)

    def mean(numbers: Array) -> Array:
        return np.stack([total(column) for column in numbers.T], axis=-1) / np.maximum(count, 1)

    if std_error is not None:
        # of means of as many samples as fell into the cell, taken as independent; unknown where there is none
        error = between(np.sqrt(mean(std_error**2) / np.maximum(count, 1)))
        error[gaps] = np.inf
        fields["std_error"] = error
    cells = between(mean(values))
    if on_normal.any() and gaps[on_normal.any(axis=1), 1].any():
        # The normal's cell, known at every azimuth, beside cells that are not: as in `cells_around`
        edges, twice = _second_ring_split(edges)
        cells, gaps = cells[:, twice], gaps[:, twice]
        if std_error is not None:
            fields["std_error"] = fields["std_error"][:, twice]
    return table_of(cells, gaps, rows, edges, phi_edges, channels, **fields)


def _between(
    known: NDArray[np.bool_], edges: Array, reach: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Rings below and above each cell that are known, and how far the cell is from one to the other in sin^2 theta_r.

    Shape (I, R, P), like `known`. Where the cell is known, or either is farther than `reach`, both are the cell itself.
    """
    rings = np.broadcast_to(np.arange(known.shape[1])[:, None], known.shape)
    below = np.maximum.accumulate(np.where(known, rings, -1), axis=1)
    above = np.minimum.accumulate(np.where(known, rings, known.shape[1])[:, ::-1], axis=1)[:, ::-1]
    inside = ~known & (below >= 0) & (above < known.shape[1])
    below, above = np.where(inside, below, rings), np.where(inside, above, rings)
    middle = 0.5 * (edges[1:] + edges[:-1])
    near = np.maximum(middle[rings] - middle[below], middle[above] - middle[rings]) <= reach
    below, above = np.where(near, below, rings), np.where(near, above, rings)
    u = np.sin(middle) ** 2
    return below, above, (u[rings] - u[below]) / np.where(above > below, u[above] - u[below], 1.0)


def _second_ring_split(edges: Array) -> tuple[Array, NDArray[np.int64]]:
    """Rings of which the second has the first's size, and which ring each was; as they are where there is no room."""
    cut = 2 * np.sin(edges[1]) ** 2
    if len(edges) < 3 or cut >= np.sin(edges[2]) ** 2:
        return edges, np.arange(len(edges) - 1)
    return np.insert(edges, 2, np.arcsin(np.sqrt(cut))), np.sort([*range(len(edges) - 1), 1])


def _nodes(angles: Array) -> tuple[Array, NDArray[np.int64]]:
    """Distinct angles, those closer than `_SAME` to the one before taken as one, and which each sample has."""
    order = np.argsort(angles, kind="stable")
    new = np.concatenate([[True], np.diff(angles[order]) > _SAME])
    index = np.empty(len(angles), np.int64)
    index[order] = np.cumsum(new) - 1
    return np.bincount(index, angles) / np.bincount(index), index


def _bins(angles: Array, last: float, n: int) -> tuple[Array, NDArray[np.int64]]:
    """Middles of the uniform bins that hold an angle, and which each sample is in."""
    taken, index = np.unique(np.minimum((angles / last * n).astype(int), n - 1), return_inverse=True)
    return (taken + 0.5) * last / n, index


def _cell_of(source: NDArray[np.int64]) -> NDArray[np.int64]:
    """The cell of each node, from the node of each cell."""
    cells = np.flatnonzero(source >= 0)
    return cells[np.argsort(source[cells])]
