"""The measure of error that compression is held to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import projected_solid_angles
from gonio.table.table import Table

Array = NDArray[np.float64]


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
        return np.zeros(table.row_albedo.shape)
    weights = cosine_weights(table.theta_r_edges, table.delta_phi_edges)
    norms = row_norms(table.values, weights)
    noise = row_norms(np.where(table.values > 0, table.std_error, 0.0), weights)
    return np.divide(noise, norms, out=np.zeros_like(norms), where=norms > 0)
