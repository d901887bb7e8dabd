"""Synthetic tables for the tests of table and formats."""

from __future__ import annotations

from collections.abc import Callable

import h5py
import numpy as np

from gonio.core.directions import direction
from gonio.formats.packed import pack_record, unpack_record
from gonio.table.table import Table

CHANNELS = ("R", "G", "B")


def grid(n_i=30, n_r=30, n_phi=36):
    """Edges of a uniform grid."""
    return (
        np.linspace(0, np.pi / 2, n_i + 1),
        np.linspace(0, np.pi / 2, n_r + 1),
        np.linspace(0, np.pi, n_phi + 1),
    )


def make(
    brdf: Callable, edges=None, theta_i=None, specular=0.0, tint=(1.0, 0.8, 0.5), cell_points=1, **fields
) -> Table:
    """A table of `brdf(wi, wo)`, sampled at points of the cells in theta_r and phi, and tinted by channel.

    The albedo is the sum over cells plus the delta term, as a tracer's is.
    """
    edges_i, edges_r, edges_phi = edges or grid()
    rows = theta_i if theta_i is not None else 0.5 * (edges_i[1:] + edges_i[:-1])
    inside = (np.arange(cell_points) + 0.5) / cell_points
    theta_r = (edges_r[:-1, None] + inside * np.diff(edges_r)[:, None]).ravel()
    phi = (edges_phi[:-1, None] + inside * np.diff(edges_phi)[:, None]).ravel()
    wi = direction(np.asarray(rows))[:, None, None]
    values = brdf(wi, direction(theta_r[:, None], phi)[None])
    shape = (len(rows), len(edges_r) - 1, cell_points, len(edges_phi) - 1, cell_points)
    values = values.reshape(shape).mean(axis=(2, 4))[..., None] * np.array(tint)
    table = Table(
        values=values,
        theta_i=rows,
        theta_i_edges=None if theta_i is not None else edges_i,
        theta_r_edges=edges_r,
        delta_phi_edges=edges_phi,
        channels=CHANNELS[: len(tint)],
        row_albedo=np.zeros((len(rows), len(tint))),
        specular=specular,
        **fields,
    )
    albedo = np.einsum("irpc,rp->ic", values, table.projected_solid_angles) + table.specular
    return table.replace(row_albedo=albedo)


def share(table: Table, fraction: float) -> Table:
    """A fraction of the table's light as a part of it would hold it."""
    scaled = {
        field: fraction * getattr(table, field)
        for field in ("values", "std_error", "row_albedo", "albedo_std_error", "specular")
        if getattr(table, field) is not None
    }
    return table.replace(**scaled, ledger={}, provenance={}, parts={})


def with_parts(table: Table, transmittance: float = 0.25) -> Table:
    """The table with a dimmer copy as its transmission, both split into orders of bounces."""
    bounces = {"L1": 0.5, "L2": 0.125, "L3+": 0.375}
    below = share(table, transmittance)
    below = below.replace(parts={name: share(below, fraction) for name, fraction in bounces.items()})
    orders = {name: share(table, fraction) for name, fraction in bounces.items()}
    return table.replace(parts={"transmission": below, **orders})


def lambert(wi, wo):
    """Reflectance one half."""
    return np.full(np.broadcast_shapes(wi.shape, wo.shape)[:-1], 0.5 / np.pi)


def asymmetric(wi, wo):
    """Not reciprocal, depends on theta_i, and favours the side of the light more the steeper it falls."""
    sideways = np.sum(wi[..., :2] * wo[..., :2], axis=-1)
    return (0.1 + 0.2 * wi[..., 2] ** 2 + 0.05 * wo[..., 2]) * np.exp(1.5 * sideways) / np.pi


def peak(alpha=0.1):
    """A narrow GGX lobe without Fresnel and shadowing, reciprocal."""

    def brdf(wi, wo):
        wh = wi + wo
        wh = wh / np.maximum(np.linalg.norm(wh, axis=-1, keepdims=True), 1e-12)
        d = alpha**2 / np.pi / (1 + (alpha**2 - 1) * wh[..., 2] ** 2) ** 2
        return d / (4 * np.maximum(0.05, wi[..., 2] + wo[..., 2]))

    return brdf


def ggx(alpha, albedo=1.0):
    """GGX mirror facets with height-correlated Smith shadowing."""

    def brdf(wi, wo):
        wh = wi + wo
        wh = wh / np.maximum(np.linalg.norm(wh, axis=-1, keepdims=True), 1e-12)
        d = alpha**2 / np.pi / (1 + (alpha**2 - 1) * wh[..., 2] ** 2) ** 2

        def lam(w):
            return 0.5 * (np.sqrt(1 + alpha**2 * (1 / np.maximum(w[..., 2], 1e-9) ** 2 - 1)) - 1)

        return albedo * d / (1 + lam(wi) + lam(wo)) / (4 * wi[..., 2] * wo[..., 2])

    return brdf


def edit_record(path, action):
    """Do something to the record of a compressed table."""
    with h5py.File(path, "r+") as file:
        record = unpack_record(file["compressed"][()])
        action(record)
        del file["compressed"]
        file["compressed"] = pack_record(record)
