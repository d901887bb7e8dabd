"""Distributions, Smith shadowing and sampling of visible micro-normals, for models built of microfacets."""

from __future__ import annotations

import math

from gonio.core.directions import half_vector
from gonio.core.jit import kernel

_INV_PI = 1.0 / math.pi
_SQRT_PI = math.sqrt(math.pi)


@kernel(allocates=False)
def dot(a, b):
    """Scalar product of two directions."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel(allocates=False)
def schlick_weight(cos_i):
    """(1 - cos)^5, the share of F90 in Schlick's Fresnel term (Schlick 1994, eq. 15)."""
    x = min(1.0, max(0.0, 1.0 - cos_i))
    x2 = x * x
    return x2 * x2 * x


@kernel(allocates=False)
def beckmann(alpha, wm):
    """Beckmann distribution, 1/sr: exp(-tan^2/alpha^2) / (pi alpha^2 cos^4) (Walter 2007, eq. 25)."""
    if wm[2] <= 0.0:
        return 0.0
    a2 = alpha * alpha
    cos2 = wm[2] * wm[2]
    # sin^2 from x and y: 1 - cos^2 would lose all digits at small alpha
    exponent = (wm[0] * wm[0] + wm[1] * wm[1]) / (cos2 * a2)
    if exponent > 700.0:
        return 0.0
    return math.exp(-exponent) * _INV_PI / (a2 * cos2 * cos2)


@kernel(allocates=False)
def ggx(alpha, wm):
    """GGX (Trowbridge-Reitz) distribution, 1/sr (Walter 2007, eq. 33)."""
    if wm[2] <= 0.0:
        return 0.0
    a2 = alpha * alpha
    k = wm[0] * wm[0] + wm[1] * wm[1] + a2 * wm[2] * wm[2]
    return a2 * _INV_PI / (k * k)


@kernel(allocates=False)
def beckmann_lambda(alpha, w):
    """Smith's Lambda of Beckmann facets, exact (Heitz 2014, table 1; not Walter's rational fit).

    (exp(-a^2)/(a sqrt(pi)) - erfc(a)) / 2 with a = 1/(alpha tan(theta)).
    """
    sin2 = w[0] * w[0] + w[1] * w[1]
    if sin2 == 0.0:
        return 0.0
    a = abs(w[2]) / (alpha * math.sqrt(sin2))
    if a > 6.0:  # Lambda < 1e-18
        return 0.0
    if a == 0.0:
        return math.inf
    return 0.5 * (math.exp(-a * a) / (a * _SQRT_PI) - math.erfc(a))


@kernel(allocates=False)
def ggx_root(alpha, cos_theta):
    """sqrt(cos^2 + alpha^2 sin^2), in which GGX's Lambda is (root/cos - 1)/2 (Heitz 2014, eq. 72)."""
    cos2 = cos_theta * cos_theta
    return math.sqrt(cos2 + alpha * alpha * (1.0 - cos2))


@kernel(allocates=False)
def sample_visible_ggx(alpha, wi, u0, u1):
    """Reflection of `wi` (above the horizon) off a visible GGX normal (Heitz 2018, JCGT 7(4), listing 1).

    May point below the horizon.
    """
    # stretch to the hemisphere of alpha = 1
    x, y, z = alpha * wi[0], alpha * wi[1], wi[2]
    length = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    # an orthonormal frame about it, its first axis horizontal
    horizontal = math.sqrt(x * x + y * y)
    if horizontal > 0.0:
        t1x, t1y = -y / horizontal, x / horizontal
    else:
        t1x, t1y = 1.0, 0.0
    t2x, t2y, t2z = -z * t1y, z * t1x, x * t1y - y * t1x
    # a point of the projected hemisphere
    r = math.sqrt(u0)
    phi = 2.0 * math.pi * u1
    a = r * math.cos(phi)
    s = 0.5 * (1.0 + z)
    b = (1.0 - s) * math.sqrt(max(0.0, 1.0 - a * a)) + s * r * math.sin(phi)
    c = math.sqrt(max(0.0, 1.0 - a * a - b * b))
    # back onto the ellipsoid
    mx = alpha * (a * t1x + b * t2x + c * x)
    my = alpha * (a * t1y + b * t2y + c * y)
    mz = max(0.0, b * t2z + c * z)
    length = math.sqrt(mx * mx + my * my + mz * mz)
    if length == 0.0:
        return -wi[0], -wi[1], wi[2]
    wm = (mx / length, my / length, mz / length)
    d = 2.0 * dot(wi, wm)
    return d * wm[0] - wi[0], d * wm[1] - wi[1], d * wm[2] - wi[2]


@kernel(allocates=False)
def visible_ggx_pdf(alpha, wi, wo):
    """Density of `sample_visible_ggx`, 1/sr: D G1(wi) / (4 cos_i), written without a division by cos_i."""
    if wi[2] <= 0.0:
        return 0.0
    return ggx(alpha, half_vector(wi, wo)) / (2.0 * (wi[2] + ggx_root(alpha, wi[2])))
