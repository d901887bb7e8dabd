"""The measure of error that compression is held to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import projected_solid_angles
from gonio.table.table import Table

Array = NDArray[np.float64]

_SIGMAS = 3.0
_ROUNDING = 1e-12
_DARK = 0.1


def cosine_weights(theta_r_edges: Array, delta_phi_edges: Array) -> Array:
    """Root of each cell's projected solid angle: the plain L2 norm of f times it is the metric's.

    In this measure the noise of counted paths is alike in all cells of equal brightness: their variance is
    f / (N x projected solid angle).

    Returns
    -------
    ndarray, shape (R, P)
    """
    return np.sqrt(projected_solid_angles(theta_r_edges, delta_phi_edges))


def row_norms(values: Array, weights: Array) -> Array:
    """Norm of f over projected solid angle, per row and channel, shape (I, C)."""
    return np.sqrt(np.einsum("irpc,rp->ic", values**2, weights**2))


def reference_norms(values: Array, weights: Array) -> Array:
    """What errors are relative to, shape (I, C): a channel's norm, or a tenth of the row's brightest channel's.

    Red of a deep blue, on the edge of the gamut or beyond, is the small difference of large numbers.
    """
    norms = row_norms(values, weights)
    return np.maximum(norms, _DARK * norms.max(axis=1, keepdims=True))


def row_errors(table: Table, values: Array) -> Array:
    """Relative, cosine-weighted RMS difference of `values` from the table's, per row and channel.

    0 where a row is dark in both, infinite where it is dark in the table only.
    """
    weights = cosine_weights(table.theta_r_edges, table.delta_phi_edges)
    norms, errors = reference_norms(table.values, weights), row_norms(values - table.values, weights)
    unbounded = np.where(errors > 0, np.inf, 0.0)
    return np.divide(errors, norms, out=unbounded, where=norms > 0)


def row_noise(table: Table) -> Array:
    """The table's own noise in the same measure, per row and channel; 0 without error bars.

    Cells without hits carry an upper bound for an error, not an error; they are left out.
    """
    return _noise(table)[0]


def row_bounds(table: Table, max_error: float) -> Array:
    """Error allowed in each row and channel, shape (I, C): `max_error`, or what the row's noise explains.

    The truth itself differs from a row by its noise, give or take: the sum over cells of squared errors of
    n cells scatters by sqrt(2/n), and by as much again for error bars from few batches. So _SIGMAS of that
    are allowed on top; without, the noisiest row of many would be followed into its noise.
    """
    noise, scatter = _noise(table)
    return np.maximum(max_error, noise * np.sqrt(1.0 + _SIGMAS * scatter))


def albedo_errors(table: Table, values: Array) -> Array:
    """Relative difference of the rows' reflectance, by sums over the cells, per row and channel."""
    areas = table.projected_solid_angles
    total = np.einsum("irpc,rp->ic", table.values, areas)
    difference = np.abs(np.einsum("irpc,rp->ic", values - table.values, areas))
    # a channel on the edge of the gamut may cancel: as of the norms, a tenth of what is there counts
    size = np.einsum("irpc,rp->ic", np.abs(table.values), areas)
    reference = np.maximum(np.abs(total), _DARK * size.max(axis=1, keepdims=True))
    difference[difference <= _ROUNDING * reference] = 0.0
    unbounded = np.where(difference > 0, np.inf, 0.0)
    return np.divide(difference, reference, out=unbounded, where=reference > 0)


def excess(table: Table, values: Array, bounds: Array) -> Array:
    """Error of brdf or of albedo over what is allowed, the larger, per row and channel, shape (I, C)."""
    return np.maximum(row_errors(table, values), albedo_errors(table, values)) / bounds


def _noise(table: Table) -> tuple[Array, Array]:
    """Relative noise of rows, and the relative scatter of its square, shape (I, C) each."""
    if table.std_error is None:
        return np.zeros(table.row_albedo.shape), np.zeros(table.row_albedo.shape)
    weights = cosine_weights(table.theta_r_edges, table.delta_phi_edges)
    norms = reference_norms(table.values, weights)
    variance = (np.where(table.values > 0, table.std_error, 0.0) * weights[:, :, None]) ** 2
    total = variance.sum(axis=(1, 2))
    noise = np.divide(np.sqrt(total), norms, out=np.zeros_like(norms), where=norms > 0)
    scatter = np.sqrt(4.0 * np.sum(variance**2, axis=(1, 2)))
    return noise, np.divide(scatter, total, out=np.zeros_like(norms), where=total > 0)
