"""Phase functions of scattering in a volume: density per sr of the direction after against that before.

`cos` is the cosine between the two directions of propagation: 1 is forward. Every function p fulfils
2 pi integral p(cos) dcos = 1 over [-1, 1], and every sampler inverts the cumulative integral from -1:
u = 0 is backward.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.core.jit import kernel

ISOTROPIC = 0
HG = 1
RAYLEIGH = 2
TABULATED = 3


@kernel(allocates=False)
def phase_value(kind, g, cosines, values, cos):
    """Density per sr of scattering by an angle.

    Parameters
    ----------
    kind : int
        ISOTROPIC, HG, RAYLEIGH or TABULATED.
    g : float
        Mean cosine of HG, in (-1, 1).
    cosines, values : ndarray, shape (N,)
        Of TABULATED: increasing from -1 to 1, and the normalised density there, linear in between.
    cos : float
    """
    if kind == HG:
        return hg(g, cos)
    if kind == RAYLEIGH:
        return rayleigh(cos)
    if kind == TABULATED:
        i = _interval(cosines, cos)
        slope = (values[i + 1] - values[i]) / (cosines[i + 1] - cosines[i])
        return values[i] + slope * (cos - cosines[i])
    return 0.25 / math.pi


@kernel(allocates=False)
def phase_sample(kind, g, cosines, values, cdf, u):
    """Cosine of the scattering angle, by inversion.

    Parameters
    ----------
    kind, g, cosines, values
        As in `phase_value`.
    cdf : ndarray, shape (N,)
        `tabulated_cdf` of the two.
    u : float
        Uniform in [0, 1).
    """
    if kind == HG:
        return sample_hg(g, u)
    if kind == RAYLEIGH:
        return sample_rayleigh(u)
    if kind == TABULATED:
        i = _interval(cdf, u)
        width = cosines[i + 1] - cosines[i]
        slope = (values[i + 1] - values[i]) / width
        area = (u - cdf[i]) / (2.0 * math.pi)
        # values x + slope x^2 / 2 = area, by the root that does not cancel
        end = math.sqrt(max(0.0, values[i] * values[i] + 2.0 * slope * area))
        if values[i] + end == 0.0:
            return cosines[i]
        return cosines[i] + min(width, 2.0 * area / (values[i] + end))
    return 2.0 * u - 1.0


@kernel(allocates=False)
def hg(g, cos):
    """Henyey & Greenstein 1941: (1 - g^2) / (4 pi (1 + g^2 - 2 g cos)^1.5)."""
    # 1 + g^2 - 2 g cos without cancellation at the peak
    size = abs(g)
    towards = cos if g >= 0.0 else -cos
    distance2 = (1.0 - size) * (1.0 - size) + 2.0 * size * (1.0 - towards)
    return (1.0 - size) * (1.0 + size) / (4.0 * math.pi * distance2 * math.sqrt(distance2))


@kernel(allocates=False)
def sample_hg(g, u):
    """Cosine distributed as `hg`.

    The textbook's (1 + g^2 - ((1 - g^2)/t)^2) / (2 g) with t = 1 - g + 2 g u, solved for the distance of
    the cosine from its peak: 1 - cos = 2 (1 - g)^2 (1 - u) (1 + g u) / t^2, which has nothing to cancel.
    """
    size = abs(g)
    v = u if g >= 0.0 else 1.0 - u
    ratio = (1.0 - size) / (1.0 - size + 2.0 * size * v)
    distance = 2.0 * ratio * ratio * (1.0 - v) * (1.0 + size * v)
    return 1.0 - distance if g >= 0.0 else distance - 1.0


@kernel(allocates=False)
def rayleigh(cos):
    """Rayleigh scattering of unpolarised light: 3/(16 pi) (1 + cos^2)."""
    return 3.0 / (16.0 * math.pi) * (1.0 + cos * cos)


@kernel(allocates=False)
def sample_rayleigh(u):
    """Cosine distributed as `rayleigh`: the real root of cos^3 + 3 cos = 8 u - 4."""
    return 2.0 * math.sinh(math.asinh(4.0 * u - 2.0) / 3.0)


@kernel(allocates=False)
def rayleigh_polarisation(cos):
    """What `gonio.core.stokes.mueller` needs for a Rayleigh scattering whose density is `rayleigh`.

    The dipole keeps E across the scattering plane and turns cos of E in it on: a_s = 1, a_p = cos, both
    times sqrt(2 / (1 + cos^2)), so that unpolarised light keeps its I: the density carries that factor.

    Returns
    -------
    tuple of float
        |a_s|^2, |a_p|^2, a_s a_p*, with s perpendicular to both directions.
    """
    scale = 2.0 / (1.0 + cos * cos)
    return scale, scale * cos * cos, scale * cos


def tabulated_cdf(cosines: ArrayLike, values: ArrayLike) -> NDArray[np.float64]:
    """Cumulative 2 pi integral of a tabulated phase function, from 0 at cosine -1 to exactly 1.

    Parameters
    ----------
    cosines, values : array_like, shape (N,)
        As in `phase_value`.

    Returns
    -------
    ndarray, shape (N,)
    """
    cosines, values = np.asarray(cosines, float), np.asarray(values, float)
    areas = np.pi * (values[1:] + values[:-1]) * np.diff(cosines)
    cdf = np.concatenate([[0.0], np.cumsum(areas)])
    return cdf / cdf[-1]


@kernel(allocates=False)
def _interval(edges, x):
    """Index i with edges[i] <= x < edges[i + 1], by bisection; the outermost intervals take what lies beyond."""
    low, high = 0, edges.shape[0] - 1
    while high - low > 1:
        middle = (low + high) // 2
        if edges[middle] <= x:
            low = middle
        else:
            high = middle
    return low
