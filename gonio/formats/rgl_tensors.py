"""The fields of an RGL tensor file from a table; what they mean stands in `gonio.formats.rgl`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import direction
from gonio.formats.warp import Warp, bilinear
from gonio.table.table import Table

Array = NDArray[np.float64]

N_THETA_I = 19
_VNDF = 128
_NODES = 64  # of the spectra; 32 as in RGL's own files leave twice the error
_EVEN, _EVEN_NARROW = 0.7, 0.3
"""Share of the normals spread evenly over sqrt(theta), and that for a highlight on a grid of its own."""
_GRAZING = np.radians(89.5)
_POLE = np.radians(2.0)  # down to about this theta


def to_unit(theta: Array, phi: Array) -> tuple[Array, Array]:
    """RGL's coordinates of a direction on the unit square: theta warped, azimuth about the light's."""
    return np.sqrt(theta * (2 / np.pi)), (phi + np.pi) / (2 * np.pi) % 1.0


def tensors_of(table: Table) -> dict[str, NDArray]:
    """All fields of a file."""
    u = np.linspace(0, 1, _VNDF)
    theta = 0.5 * np.pi * u**2
    ndf = _normals(table, theta)
    theta_i = np.linspace(0, np.pi / 2, N_THETA_I)
    sigma = _projected_area(theta, ndf)
    phi = np.linspace(-np.pi, np.pi, _VNDF)
    m = direction(theta[None, :], phi[:, None])
    jacobian = 2 * np.pi**2 * u * np.sin(theta)
    n_channels = len(table.channels)
    vndf = np.empty((N_THETA_I, _VNDF, _VNDF), np.float32)
    spectra = np.empty((N_THETA_I, n_channels, _NODES, _NODES), np.float32)
    s = np.linspace(0, 1, _NODES)
    sy, sx = (a.ravel() for a in np.meshgrid(s, s, indexing="ij"))
    two_rows = np.stack([ndf, ndf]).astype(np.float32)
    areas = np.stack([sigma, sigma]).astype(np.float32)
    for n, angle in enumerate(theta_i):
        # no row stands at the horizon, and a highlight continued to there would hold more light than falls in
        wi = direction(angle if table.peak is None else min(angle, _GRAZING))
        density = ndf * np.maximum(m @ wi, 0) * jacobian
        vndf[n] = density / density.max()
        x, y = Warp(vndf[n].astype(float)).sample(sx, sy)
        normal = direction(0.5 * np.pi * x**2, 2 * np.pi * y - np.pi)
        wo = 2 * (normal @ wi)[:, None] * normal - wi
        cosine = np.maximum(wo[:, 2], 0.0)
        # the renderer divides by what it interpolates, so do we
        x_i, y_i = to_unit(np.array([angle]), np.zeros(1))
        factor = 4 * bilinear(areas.astype(float), x_i, y_i) / bilinear(two_rows.astype(float), x, y)
        f = table.eval(wi, wo)
        spectra[n] = (f * (cosine * factor)[:, None]).T.reshape(n_channels, _NODES, _NODES)
    luminance = spectra.mean(axis=1)
    luminance += 1e-3 * luminance.max(axis=(1, 2), keepdims=True) + np.finfo(np.float32).tiny
    fields: dict[str, NDArray] = {
        "description": np.frombuffer(b"BRDF table converted by gonio", np.uint8),
        "phi_i": np.zeros(1, np.float32),
        "theta_i": theta_i.astype(np.float32),
        "ndf": two_rows,
        "sigma": areas,
        "vndf": vndf[None],
        "luminance": luminance[None],
        "jacobian": np.ones(1, np.uint8),
    }
    if table.wavelengths_nm is not None:
        fields["wavelengths"] = np.array(table.wavelengths_nm, np.float32)
        fields["spectra"] = spectra[None]
    else:
        fields["rgb"] = np.ascontiguousarray(np.broadcast_to(spectra, (N_THETA_I, 3, _NODES, _NODES)))[None]
    return fields


def _normals(table: Table, theta: Array) -> Array:
    """A distribution of normals at angles theta, positive, from the table.

    The mean of 4 cos(theta_i) cos(theta_r) f over the cells whose half vector is theta away from the normal:
    the distribution itself for facets without shadowing and Fresnel's dimming. A share of its mass is
    spread evenly over the coordinate sqrt(theta), so that nodes are dense at the normal and nowhere lacking.
    """
    mean = np.maximum(table.values.mean(axis=-1), 0.0)
    wi = direction(table.theta_i)[:, None, None]
    wo = direction(table.theta_r[:, None], table.delta_phi)[None]
    half = wi + wo
    theta_h = np.arctan2(np.hypot(half[..., 0], half[..., 1]), half[..., 2])
    weight = wi[..., 2] * table.projected_solid_angles * np.sin(table.theta_i)[:, None, None]
    known = 1.0 if table.gaps is None else ~table.gaps
    weight = weight * known + np.zeros_like(mean)
    edges = 0.5 * np.pi * np.linspace(0, 1, 65) ** 2
    index = np.clip(np.searchsorted(edges, theta_h.ravel(), "right") - 1, 0, 63)
    total = np.bincount(index, (weight * mean * 4 * wi[..., 2] * wo[..., 2]).ravel(), 64)
    count = np.bincount(index, weight.ravel(), 64)
    seen = count > 0
    centres = 0.5 * (edges[1:] + edges[:-1])
    estimate = np.interp(theta, centres[seen], total[seen] / count[seen])
    share = _EVEN
    if table.peak is not None:
        share = _EVEN_NARROW
        estimate = np.where(
            np.tan(theta) < table.peak.extent, _narrow_normals(table, np.tan(theta)), estimate
        )
    even = (theta**2 + _POLE**2) ** -0.75
    area = np.sin(2 * theta) * np.pi
    narrow, wide = (part / np.trapezoid(part * area, theta) for part in (estimate, even))
    return (1 - share) * narrow + share * wide


def _narrow_normals(table: Table, slope: Array) -> Array:
    """The same of a highlight on a grid of its own, at slopes tan(theta): 4 cos cos f is g; slopes are small."""
    assert table.peak is not None
    rows = np.sin(2 * table.theta_i)
    known = np.maximum(table.peak.values.mean(axis=-1), 0.0)
    g = np.einsum("isq,i,q->s", known, rows / rows.sum(), np.diff(table.peak.psi_edges) / np.pi)
    edges = table.peak.slope_edges
    return np.interp(slope, np.sqrt(0.5 * (edges[1:] ** 2 + edges[:-1] ** 2)), g)


def _projected_area(theta: Array, ndf: Array) -> Array:
    """sigma(theta): integral of ndf max(0, wi.m) over the hemisphere of normals."""
    phi = (np.arange(256) + 0.5) * (2 * np.pi / 256)
    weights = np.zeros_like(theta)
    weights[:-1] += 0.5 * np.diff(theta)
    weights[1:] += 0.5 * np.diff(theta)
    m = direction(theta[:, None], phi)
    visible = np.maximum(np.einsum("tpk,ik->itp", m, direction(theta)), 0).mean(axis=2) * 2 * np.pi
    return visible @ (ndf * np.sin(theta) * weights)
