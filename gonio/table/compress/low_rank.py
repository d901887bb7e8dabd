"""Compression by factors in half and difference angles (Rusinkiewicz 1998).

The values at the cells' centres are a function of (theta_h, theta_d, phi_d), linear between the nodes of a grid
that is uniform in sqrt(theta_h), as MERL's is: the highlight of a microfacet surface, which in (theta_i,
theta_r, delta phi) moves and widens from row to row, is a column there. The nodes' values are the least-squares
fit to the table, in its error measure, by conjugate gradients.

Then the grid is factorised: as a matrix of theta_h against everything else, each row weighted by what it means
for the error, it is U diag(sigma) V' (as Lawrence et al. 2004 and Bagher et al. 2016 factorise, who demand
positive factors). U is orthonormal, so is the cosine transform of V over theta_d, phi_d and channel: one
step of quantisation serves all, and components below it vanish, which is the truncation to low rank.

A table that is no smooth function of these angles, from peaks narrower than its cells say, cannot be held to
a small error this way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage, sparse

from gonio.core.directions import half_difference
from gonio.table.compress.frame import Frame, shape_of
from gonio.table.compress.metric import excess
from gonio.table.compress.packing import pack, step_of, unpack
from gonio.table.compress.search import hold
from gonio.table.table import Table
from microgeometry.errors import InputError

Array = NDArray[np.float64]
Sizes = tuple[int, int, int]

_NODES: Sizes = (90, 46, 46)
_ITERATIONS = 20


def encode(table: Table, bounds: Array, quick: bool = False) -> dict[str, Any]:
    """As `gonio.table.compress.dct.encode`."""
    fields = {name: getattr(table, name) for name in _FIELDS}
    shape = table.values.shape
    sizes = grid_sizes(shape)
    interpolation = _interpolation(fields, sizes)
    frame = Frame.of_table(table, bounds)
    importance = _importance(frame, shape)
    grid, weights = _fit(table, interpolation, importance, sizes)
    # a grid coarser than the table may not hold the bounds at any step: looking for one takes long
    unrounded = frame.correct((interpolation @ grid.reshape(-1, shape[3])).reshape(shape))
    if excess(table, unrounded, bounds).max() > 1:
        raise InputError("max_error: no step of quantisation holds it; the grid of the factors is too coarse")
    # components of what the error sees
    basis, _, _ = np.linalg.svd(
        (grid * weights[:, None, None, None]).reshape(sizes[0], -1), full_matrices=False
    )
    basis = basis.astype(np.float32).astype(float)
    coefficients = _forward(grid, weights, basis)

    def prepare(frame: Frame) -> Callable[[float], Array]:
        rounded = partial(_values, weights=weights, basis=basis, interpolation=interpolation, shape=shape)
        return lambda step: rounded(np.rint(coefficients / step) * step)

    step = hold(frame, partial(excess, table, bounds=bounds), prepare, quick)
    quantised = np.rint(coefficients / step).astype(np.int64)
    used = np.flatnonzero(np.any(quantised, axis=(1, 2, 3)))
    rank = int(used[-1]) + 1 if len(used) else 1
    return {
        **frame.content(step, prepare(frame)(step)),
        "weights": weights.astype(np.float32),
        "basis": basis[:, :rank].astype(np.float32),
        "coefficients": pack(quantised[:rank]),
    }


def decode(content: Mapping[str, Any], fields: Mapping[str, Any]) -> Array:
    """As `gonio.table.compress.dct.decode`."""
    shape = shape_of(fields)
    sizes = grid_sizes(shape)
    frame, step = Frame.read_table(content, fields), step_of(content)
    weights, basis = np.asarray(content["weights"], float), np.asarray(content["basis"], float)
    if weights.shape != sizes[:1] or basis.ndim != 2 or not basis.shape[0] == sizes[0] >= basis.shape[1] >= 1:
        raise ValueError(f"weights and basis of shape {weights.shape}, {basis.shape} for a grid of {sizes}")
    if not (np.all(weights > 0) and np.all(np.isfinite(weights)) and np.all(np.abs(basis) <= 1.01)):
        raise ValueError("weights that are not positive, or a basis that is not orthonormal")
    cut = (basis.shape[1], *sizes[1:], shape[3])
    coefficients = unpack(content["coefficients"], cut).astype(float) * step
    return frame.correct(_values(coefficients, weights, basis, _interpolation(fields, sizes), shape))


_FIELDS = ("theta_i", "theta_i_edges", "theta_r_edges", "delta_phi_edges")


def grid_sizes(shape: tuple[int, ...]) -> Sizes:
    """Nodes in theta_h, theta_d and phi_d for a table's shape: no more than its cells can determine."""
    polar, azimuth = min(shape[:2]), shape[2]
    wanted = (polar, polar, azimuth // 2)
    h, d, p = (max(2, min(most, n + 1)) for most, n in zip(_NODES, wanted, strict=True))
    return h, d, p


def _interpolation(fields: Mapping[str, Any], sizes: Sizes) -> sparse.csr_matrix:
    """Matrix from the grid's nodes to the cells' centres, (I R P, nodes), eight weights a row."""
    edges_i = fields.get("theta_i_edges")
    theta_i = np.asarray(fields["theta_i"], float) if edges_i is None else _middle(edges_i)
    theta_r, edges_phi = _middle(fields["theta_r_edges"]), np.asarray(fields["delta_phi_edges"])
    phi = 0.5 * (edges_phi[1:] + edges_phi[:-1])
    n = len(theta_i) * len(theta_r) * len(phi)
    h, d, p = half_difference(theta_i[:, None, None], theta_r[:, None], phi)
    coordinates = (np.sqrt(h / (0.5 * np.pi)), d / (0.5 * np.pi), np.abs(p) / np.pi)
    columns, weights = np.zeros((n, 1), np.int32), np.ones((n, 1), np.float32)
    if not all(np.all(np.isfinite(x)) for x in coordinates):  # the sparse product trusts its columns
        raise ValueError("axes that are not angles")
    for x, size in zip(coordinates, sizes, strict=True):
        x = np.clip(x.reshape(-1, 1), 0.0, 1.0) * (size - 1)
        low = np.minimum(x.astype(np.int32), size - 2)
        t = (x - low).astype(np.float32)
        columns = np.concatenate([columns * size + low, columns * size + low + 1], axis=1)
        weights = np.concatenate([weights * (1 - t), weights * t], axis=1)
    starts = np.arange(0, 8 * n + 1, 8)
    return sparse.csr_matrix((weights.ravel(), columns.ravel(), starts), (n, int(np.prod(sizes))))


def _middle(edges: Array) -> Array:
    u = np.sin(np.asarray(edges, float)) ** 2
    return np.arcsin(np.sqrt(0.5 * (u[1:] + u[:-1])))


def _importance(frame: Frame, shape: tuple[int, ...]) -> Array:
    """What an error in a cell counts, (I R P, C); nothing in gaps and in dark rows."""
    scale = frame.scale.values
    inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)
    importance = np.broadcast_to(frame.weights[None, :, :, None] * inverse[:, None, None], shape).copy()
    if frame.gaps is not None:
        importance[frame.gaps] = 0.0
    return importance.reshape(-1, shape[3]).astype(np.float32)


def _fit(
    table: Table, interpolation: sparse.csr_matrix, importance: Array, sizes: Sizes
) -> tuple[Array, Array]:
    """Values of the nodes, (h, d, p, C), and the weight of each theta_h, (h,)."""
    values = table.values.reshape(importance.shape).astype(np.float32)
    transposed = interpolation.T.tocsr()
    seen = transposed @ importance**2  # how firmly each node is held
    known = np.all(seen.reshape(*sizes, -1) > 0, axis=-1)
    start = np.divide(transposed @ (importance**2 * values), seen, out=np.zeros_like(seen), where=seen > 0)
    start = start.reshape(*sizes, -1)
    if known.any():  # nodes that no cell sees continue their neighbours
        nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
        start = start[tuple(nearest)]
    start = start.reshape(seen.shape)
    scale = np.divide(1.0, np.sqrt(seen), out=np.zeros_like(seen), where=seen > 0)

    def normal(x: Array) -> Array:
        return scale * (transposed @ (importance**2 * (interpolation @ (scale * x))))

    residual = scale * (transposed @ (importance**2 * (values - interpolation @ start)))
    change, direction = np.zeros_like(start), residual
    power = np.sum(residual**2, axis=0)
    for _ in range(_ITERATIONS):  # one system a channel, side by side
        image = normal(direction)
        length = power / np.maximum(np.sum(direction * image, axis=0), 1e-30)
        change += length * direction
        residual = residual - length * image
        power, before = np.sum(residual**2, axis=0), power
        direction = residual + power / np.maximum(before, 1e-30) * direction
    grid = (start + scale * change).reshape(*sizes, -1).astype(float)
    weights = np.sqrt(seen.reshape(sizes[0], -1).mean(axis=1)).astype(float)
    floor = 1e-3 * weights.max() if weights.max() > 0 else 1.0
    return grid, np.maximum(weights, floor).astype(np.float32).astype(float)


def _forward(grid: Array, weights: Array, basis: Array) -> Array:
    components = np.einsum("hk,hdpc->kdpc", basis, grid * weights[:, None, None, None], optimize=True)
    return fft.dctn(components, axes=(1, 2, 3), norm="ortho")


def _values(
    coefficients: Array,
    weights: Array,
    basis: Array,
    interpolation: sparse.csr_matrix,
    shape: tuple[int, ...],
) -> Array:
    """Values of the cells from the coefficients of the first components."""
    components = fft.idctn(coefficients, axes=(1, 2, 3), norm="ortho")
    grid = np.einsum("hk,kdpc->hdpc", basis[:, : len(components)], components, optimize=True)
    grid /= weights[:, None, None, None]
    return (interpolation @ grid.reshape(-1, shape[3]).astype(np.float32)).reshape(shape).astype(float)
