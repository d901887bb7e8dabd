"""Distributions, Smith shadowing and sampling of visible micro-normals, for models built of microfacets."""

from __future__ import annotations

import math

from gonio.core.directions import dot
from gonio.core.jit import kernel

_INV_PI = 1.0 / math.pi
_SQRT_PI = math.sqrt(math.pi)


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
def beckmann_hidden(alpha, w):
    """Smith's Lambda x cos of Beckmann facets, exact (Heitz 2014, table 1; not Walter's rational fit).

    Lambda cos is the projected area of the facets that face away from `w`, finite at the horizon; Lambda =
    (exp(-a^2)/(a sqrt(pi)) - erfc(a)) / 2 with a = 1/(alpha tan(theta)).
    """
    width = alpha * math.sqrt(w[0] * w[0] + w[1] * w[1])
    if w[2] > 6.0 * width:  # Lambda < 1e-18
        return 0.0
    a = w[2] / width
    return 0.5 * (width * math.exp(-a * a) / _SQRT_PI - w[2] * math.erfc(a))


@kernel(allocates=False)
def ggx_hidden(alpha, cos_theta):
    """Smith's Lambda x cos of GGX facets: (sqrt(cos^2 + alpha^2 sin^2) - cos)/2 (Heitz 2014, eq. 72)."""
    cos2 = cos_theta * cos_theta
    return 0.5 * (math.sqrt(cos2 + alpha * alpha * (1.0 - cos2)) - cos_theta)


@kernel(allocates=False)
def beckmann_slope(alpha, wm):
    """D log D/d alpha of `beckmann`."""
    tan2 = (wm[0] * wm[0] + wm[1] * wm[1]) / (wm[2] * wm[2])
    return 2.0 * (tan2 / (alpha * alpha) - 1.0) / alpha


@kernel(allocates=False)
def ggx_slope(alpha, wm):
    """D log D/d alpha of `ggx`."""
    cos2 = alpha * alpha * wm[2] * wm[2]
    sin2 = wm[0] * wm[0] + wm[1] * wm[1]
    return 2.0 * (sin2 - cos2) / ((sin2 + cos2) * alpha)


@kernel(allocates=False)
def beckmann_hidden_slope(alpha, w):
    """`beckmann_hidden` and its derivative by alpha: exp(-a^2) sin / (2 sqrt(pi)), as d erfc cancels."""
    sine = math.sqrt(w[0] * w[0] + w[1] * w[1])
    width = alpha * sine
    if w[2] > 6.0 * width:
        return 0.0, 0.0
    a = w[2] / width
    gauss = 0.5 * math.exp(-a * a) / _SQRT_PI
    return width * gauss - 0.5 * w[2] * math.erfc(a), sine * gauss


@kernel(allocates=False)
def ggx_hidden_slope(alpha, cos_theta):
    """`ggx_hidden` and its derivative by alpha."""
    sin2 = 1.0 - cos_theta * cos_theta
    stretched = math.sqrt(cos_theta * cos_theta + alpha * alpha * sin2)
    return 0.5 * (stretched - cos_theta), 0.5 * alpha * sin2 / stretched


@kernel(allocates=False)
def reflect(w, wm):
    """Mirror direction of `w` at a facet of normal `wm`."""
    d = 2.0 * dot(w, wm)
    return d * wm[0] - w[0], d * wm[1] - w[1], d * wm[2] - w[2]


@kernel(allocates=False)
def normal_of_tangent(x, y):
    """The normal of a facet whose slopes are -x and -y, along (x, y, 1)."""
    scale = 1.0 / math.sqrt(1.0 + x * x + y * y)
    return x * scale, y * scale, scale


@kernel(allocates=False)
def visible_ggx(alpha, wi, u0, u1):
    """A GGX normal as seen from `wi` (above the horizon) (Heitz 2018, JCGT 7(4), listing 1)."""
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
        return 0.0, 0.0, 1.0
    return mx / length, my / length, mz / length


@kernel(allocates=False)
def visible_ggx_pdf(alpha, wi, wm):
    """D G1(wi) / (4 cos_i), 1/sr: density of the reflection of `wi` off a `wm` drawn by `visible_ggx`.

    Times 4 wi.wm it is the density of the normal.
    """
    return ggx(alpha, wm) / (4.0 * (wi[2] + ggx_hidden(alpha, wi[2])))
