"""Directions in the local frame: z is the macroscopic normal, every direction is a tuple (x, y, z) of unit length.

`wi` points to the light and `wo` to the detector, both away from the surface.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.core.jit import kernel


@kernel(allocates=False)
def frame(n):
    """Two tangents that complete the unit vector `n` to a right-handed orthonormal frame.

    Duff et al. 2017, "Building an orthonormal basis, revisited", listing 3.

    Returns
    -------
    tuple of two directions
        s, t with s x t = n.
    """
    sign = math.copysign(1.0, n[2])
    a = -1.0 / (sign + n[2])
    b = n[0] * n[1] * a
    return (1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]), (b, sign + n[1] * n[1] * a, -n[1])


@kernel(allocates=False)
def cosine_hemisphere(u0, u1):
    """Direction of density cos(theta)/pi about +z from two uniform numbers (Malley's method)."""
    r = math.sqrt(u0)
    phi = 2.0 * math.pi * u1
    return r * math.cos(phi), r * math.sin(phi), math.sqrt(max(0.0, 1.0 - u0))


@kernel(allocates=False)
def dot(a, b):
    """Scalar product of two directions."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel(allocates=False)
def combine(a, x, b, y, c, z):
    """The vector a x + b y + c z."""
    return (
        a * x[0] + b * y[0] + c * z[0],
        a * x[1] + b * y[1] + c * z[1],
        a * x[2] + b * y[2] + c * z[2],
    )


@kernel(allocates=False)
def unit(v):
    """The direction of a vector; its length must not be 0."""
    scale = 1.0 / math.sqrt(dot(v, v))
    return scale * v[0], scale * v[1], scale * v[2]


@kernel(allocates=False)
def half_vector(wi, wo):
    """Unit vector along wi + wo; (0, 0, 1) where they cancel."""
    x, y, z = wi[0] + wo[0], wi[1] + wo[1], wi[2] + wo[2]
    length = math.sqrt(x * x + y * y + z * z)
    if length == 0.0:
        return 0.0, 0.0, 1.0
    return x / length, y / length, z / length


@kernel(allocates=False)
def cos_delta_phi(wi, wo):
    """Cosine of the azimuth between two outward directions: 1 is retro-reflection, -1 the mirror side.

    1 where either stands on the normal and the azimuth is undefined.
    """
    length = math.sqrt((wi[0] * wi[0] + wi[1] * wi[1]) * (wo[0] * wo[0] + wo[1] * wo[1]))
    if length == 0.0:
        return 1.0
    return min(1.0, max(-1.0, (wi[0] * wo[0] + wi[1] * wo[1]) / length))


def direction(theta: ArrayLike, phi: ArrayLike = 0.0) -> NDArray[np.float64]:
    """Unit vectors from polar and azimuth angles.

    Parameters
    ----------
    theta, phi : array_like
        Radians, broadcast against each other.

    Returns
    -------
    ndarray, shape (..., 3)
    """
    theta, phi = np.broadcast_arrays(np.asarray(theta, float), np.asarray(phi, float))
    s = np.sin(theta)
    return np.stack([s * np.cos(phi), s * np.sin(phi), np.cos(theta)], axis=-1)


def projected_solid_angles(theta_edges: ArrayLike, delta_phi_edges: ArrayLike) -> NDArray[np.float64]:
    """Exact projected solid angle of every cell of a folded (theta, delta phi) grid, in sr.

    A folded cell holds both signs of the azimuth, so each counts twice:
    2 x (sin^2 theta_2 - sin^2 theta_1)/2 x (delta phi_2 - delta phi_1). A full grid sums to pi.

    Parameters
    ----------
    theta_edges : array_like, shape (R + 1,)
        Radians, increasing within [0, pi/2].
    delta_phi_edges : array_like, shape (P + 1,)
        Radians, increasing within [0, pi].

    Returns
    -------
    ndarray, shape (R, P)
    """
    theta_edges = np.asarray(theta_edges, float)
    # sin^2 b - sin^2 a = sin(b + a) sin(b - a), without cancellation at the horizon
    rings = np.sin(theta_edges[1:] + theta_edges[:-1]) * np.sin(np.diff(theta_edges))
    return np.outer(rings, np.diff(np.asarray(delta_phi_edges, float)))


def half_difference(
    theta_i: ArrayLike, theta_r: ArrayLike, delta_phi: ArrayLike
) -> tuple[NDArray, NDArray, NDArray]:
    """Half and difference angles (Rusinkiewicz 1998), for light at azimuth 0 and detector at `delta_phi`.

    Returns
    -------
    theta_h, theta_d, phi_d : ndarray
        Radians, of the arguments' broadcast shape; phi_d in [-pi, 0] for delta_phi in [0, pi], and of the
        opposite sign for -delta_phi.
    """
    sin_i, cos_i = np.sin(theta_i), np.cos(theta_i)
    sin_r = np.sin(theta_r)
    x = sin_i + sin_r * np.cos(delta_phi)
    y = sin_r * np.sin(delta_phi)
    z = cos_i + np.cos(theta_r)
    across = np.hypot(x, y)
    length = np.hypot(across, z)
    theta_h = np.arctan2(across, z)
    theta_d = np.arccos(np.clip(0.5 * length, 0.0, 1.0))
    # diff = R_y(-theta_h) R_z(-phi_h) wi; on the normal phi_h is that of +x
    on_axis = across == 0
    cos_phi_h = np.where(on_axis, 1.0, x) / np.where(on_axis, 1.0, across)
    sin_phi_h = np.where(on_axis, 0.0, y) / np.where(on_axis, 1.0, across)
    phi_d = np.arctan2(-sin_i * sin_phi_h, (sin_i * cos_phi_h * z - cos_i * across) / length)
    return theta_h, theta_d, phi_d
