"""The measure of error that compression is held to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.table.table import Table

Array = NDArray[np.float64]


def cosine_weights(theta_r_edges: Array, delta_phi_edges: Array) -> Array:
    """Root of cos^2(theta_r) x solid angle of each cell: the plain L2 norm of f times it is the metric's.

    cos^2 is its exact mean over the cell: int cos^2 sin = (cos^3 theta_1 - cos^3 theta_2)/3.

    Returns
    -------
    ndarray, shape (R, P)
    """
    cubes = -np.diff(np.cos(theta_r_edges) ** 3) / 3.0
    return np.sqrt(np.outer(np.maximum(cubes, 0.0), np.diff(delta_phi_edges)))


def row_norms(values: Array, weights: Array) -> Array:
    """Norm of f cos(theta_r) per row and channel, shape (I, C)."""
    return np.sqrt(np.einsum("irpc,rp->ic", values**2, weights**2))


def row_errors(table: Table, values: Array) -> Array:
    """Relative, cosine-weighted RMS difference of `values` from the table's, per row and channel.

    0 where a row is dark in both, infinite where it is dark in the table only.
    """
    weights = cosine_weights(table.theta_r_edges, table.delta_phi_edges)
    norms, errors = row_norms(table.values, weights), row_norms(values - table.values, weights)
    unbounded = np.where(errors > 0, np.inf, 0.0)
    return np.divide(errors, norms, out=unbounded, where=norms > 0)


def row_noise(table: Table) -> Array:
    """The table's own noise in the same measure, per row and channel; 0 without error bars.

    Cells without hits carry an upper bound for an error, not an error; they are left out.
    """
    if table.std_error is None:
        return np.zeros(table.albedo.shape)
    weights = cosine_weights(table.theta_r_edges, table.delta_phi_edges)
    norms = row_norms(table.values, weights)
    noise = row_norms(np.where(table.values > 0, table.std_error, 0.0), weights)
    return np.divide(noise, norms, out=np.zeros_like(norms), where=norms > 0)
