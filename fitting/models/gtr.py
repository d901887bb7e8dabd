"""Generalised Trowbridge-Reitz facets (Burley 2012): GGX with tails of any weight, and their own Smith shadowing.

D = c / (alpha^2 cos^2 + sin^2)^gamma. gamma = 2 is GGX, 1 Berry's distribution, large gamma has short tails.
The slopes are not those of one stretched surface, so Smith's Lambda has no closed form: what it needs,
the projected area of the facets a direction cannot see, is integrated for each shape and put in `p` as a
Chebyshev series (its error is below 3e-4 of the visible area everywhere, mostly below 3e-5). There are, from
p[DERIVED]: the constant c, 2/asinh(1/alpha), the series.
"""

from __future__ import annotations

import math

import numpy as np

from fitting.models.contract import DERIVED, SHAPE, SIZE, Parameter
from gonio.core.jit import kernel

ALPHA = Parameter(
    "alpha", 1e-3, 1.0, "log", "width, GGX's where gamma = 2; 0.1 is rough, 1 a uniform density"
)
GAMMA = Parameter("gamma", 1.0, 10.0, "log", "exponent: 1 heavy tails, 2 GGX, more makes them shorter")

_SERIES = DERIVED + 2
_TERMS = SIZE - _SERIES
_NODES = np.cos(np.pi * (np.arange(_TERMS) + 0.5) / _TERMS)
_TRANSFORM = np.cos(np.outer(np.arange(_TERMS), np.arccos(_NODES))) * (2.0 / _TERMS)
_TRANSFORM[0] *= 0.5
_GAUSS, _WEIGHTS = (0.5 * a for a in np.polynomial.legendre.leggauss(100))
_GAUSS = _GAUSS + 0.5


@kernel(allocates=False)
def gtr(p, wm):
    """The distribution, 1/sr (Burley 2012, appendix B.2)."""
    if wm[2] <= 0.0:
        return 0.0
    base = p[SHAPE] * p[SHAPE] * wm[2] * wm[2] + wm[0] * wm[0] + wm[1] * wm[1]
    return p[DERIVED] * math.exp(-p[SHAPE + 1] * math.log(base))


@kernel(allocates=False)
def sin2_normal(p, u):
    """sin^2 of a normal drawn from D cos: the inverse of its cumulative distribution."""
    log = 2.0 * math.log(p[SHAPE])
    if abs(log) < 1e-9:
        return u
    exponent = (1.0 - p[SHAPE + 1]) * log
    # log of base = alpha^2 cos^2 + sin^2, whose power 1 - gamma is uniform
    if exponent < 1e-9:
        log_base = (1.0 - u) * log
    else:
        log_base = math.log1p((1.0 - u) * math.expm1(exponent)) / (1.0 - p[SHAPE + 1])
    return min(1.0, max(0.0, math.expm1(log_base - log) * math.exp(log) / -math.expm1(log)))


@kernel(allocates=False)
def hidden(p, cos_theta):
    """Smith's Lambda x cos(theta), from the series."""
    if cos_theta >= 1.0:
        return 0.0
    x = math.asinh(cos_theta / p[SHAPE]) * p[DERIVED + 1] - 1.0
    b1, b2 = 0.0, 0.0
    for n in range(SIZE - 1, _SERIES, -1):  # Clenshaw
        b1, b2 = p[n] + 2.0 * x * b1 - b2, b1
    return math.exp(p[_SERIES] + x * b1 - b2) * (1.0 - cos_theta * cos_theta)


@kernel(allocates=False)
def log_slopes(p, tangents, wm, j):
    """D log D by parameter j (alpha, gamma)."""
    base = p[SHAPE] * p[SHAPE] * wm[2] * wm[2] + wm[0] * wm[0] + wm[1] * wm[1]
    norm = tangents[j, DERIVED] / p[DERIVED]
    if j == 0:
        return norm - 2.0 * p[SHAPE + 1] * p[SHAPE] * wm[2] * wm[2] / base
    return norm - math.log(base)


@kernel(allocates=False)
def hidden_slopes(p, tangents, cos_theta):
    """`hidden` and its derivatives by alpha and gamma: of the coefficients, and of where the series is read."""
    if cos_theta >= 1.0:
        return 0.0, 0.0, 0.0
    ratio = cos_theta / p[SHAPE]
    place = math.asinh(ratio)
    x = place * p[DERIVED + 1] - 1.0
    moved_0 = place * tangents[0, DERIVED + 1]
    moved_0 -= ratio / p[SHAPE] / math.sqrt(1.0 + ratio * ratio) * p[DERIVED + 1]
    # T_n and U_n-1 by their recurrences; dT_n/dx = n U_n-1
    t0, t1, u0, u1 = 1.0, x, 0.0, 1.0
    series, by_x = p[_SERIES], 0.0
    change_0, change_1 = tangents[0, _SERIES], tangents[1, _SERIES]
    for n in range(1, SIZE - _SERIES):
        series += p[_SERIES + n] * t1
        by_x += p[_SERIES + n] * n * u1
        change_0 += tangents[0, _SERIES + n] * t1
        change_1 += tangents[1, _SERIES + n] * t1
        t0, t1 = t1, 2.0 * x * t1 - t0
        u0, u1 = u1, 2.0 * x * u1 - u0
    value = math.exp(series) * (1.0 - cos_theta * cos_theta)
    moved_1 = place * tangents[1, DERIVED + 1]
    return value, value * (change_0 + by_x * moved_0), value * (change_1 + by_x * moved_1)


def derive(alpha: float, gamma: float, *_fresnel: float) -> np.ndarray:
    """What the kernels need of a shape: see the top of this module."""
    return np.concatenate([[_norm(alpha, gamma), 2.0 / math.asinh(1.0 / alpha)], _series(alpha, gamma)])


def _norm(alpha: float, gamma: float) -> float:
    """The constant c, by which the integral of D cos is 1; finite at alpha = 1 and at gamma = 1.

    (gamma - 1)(alpha^2 - 1) / (pi (1 - alpha^(2 (1 - gamma)))), Burley 2012, appendix B.2.
    """
    log = 2.0 * math.log(alpha)
    exponent = (1.0 - gamma) * log
    first = math.expm1(log) / log if log != 0.0 else 1.0
    second = exponent / math.expm1(exponent) if exponent != 0.0 else 1.0
    return first * second / math.pi


def _series(alpha: float, gamma: float) -> np.ndarray:
    """Chebyshev coefficients of log(Lambda cos / sin^2) over asinh(cos/alpha), for `hidden`.

    Lambda cos = integral of max(0, -w.m) D(m) over normals m (Heitz 2014, eq. 14 and 15). The integral over
    the azimuth of m is closed; that over its polar angle runs over log tan, from where facets begin to
    face away.
    """
    scale = math.asinh(1.0 / alpha)
    cos = alpha * np.sinh(0.5 * (_NODES + 1.0) * scale)[:, None]
    sin = np.sqrt(1.0 - cos * cos)
    start = np.log(cos / sin)
    span = np.maximum(0.0, math.log(alpha) - start) + 18.0
    tan_m = np.exp(start + span * _GAUSS**2)  # squared: the integrand starts as a power 3/2
    cos_m = 1.0 / np.sqrt(1.0 + tan_m * tan_m)
    sin_m = tan_m * cos_m
    facing = np.minimum(1.0, cos * cos_m / (sin * sin_m))
    azimuth = 2.0 * (sin * sin_m * np.sqrt(1.0 - facing * facing) - cos * cos_m * np.arccos(facing))
    density = _norm(alpha, gamma) * np.exp(-gamma * np.log((alpha * cos_m) ** 2 + sin_m**2))
    measure = sin_m * sin_m * cos_m * (2.0 * span * _GAUSS * _WEIGHTS)
    integral = np.sum(density * azimuth * measure, axis=1) / sin[:, 0] ** 2
    return _TRANSFORM @ np.log(np.maximum(integral, 1e-300))
