"""Half-spaces and slabs of a scattering medium, index-matched: Chandrasekhar's H and single scattering.

Chandrasekhar, Radiative Transfer (1950), chapters III and V; Hapke (1981) for the notation.
"""

from __future__ import annotations

import math

import numpy as np

_NODES = 128


def h_function(mu, albedo):
    """Chandrasekhar's H of isotropic scattering.

    Solves 1/H(mu) = sqrt(1-w) + (w/2) int_0^1 x H(x) / (mu + x) dx (his eq. V.13), which unlike the
    form with mu in front converges for w = 1 too, by damped iteration to 1e-13. Quadrature is
    Gauss-Legendre in x = t^2, for H is not smooth at 0.
    """
    t, weight = np.polynomial.legendre.leggauss(_NODES)
    t, weight = 0.5 * (t + 1), 0.5 * weight
    x, weight = t**2, weight * 2 * t
    kernel = 0.5 * albedo * x * weight / (x[:, None] + x)
    root = math.sqrt(1 - albedo)
    h = np.ones_like(x)
    for _ in range(10_000):
        new = 1.0 / (root + kernel @ h)
        change = np.max(np.abs(new / h - 1))
        h = np.sqrt(new * h)  # the plain iteration goes to and fro
        if change < 1e-14:
            break
    else:
        raise AssertionError("H did not converge")
    mu = np.asarray(mu, float)
    return 1.0 / (root + (0.5 * albedo * x * weight / (mu[..., None] + x)) @ h)


def half_space(mu_i, mu_o, albedo):
    """BRDF of an isotropically scattering half-space, 1/sr."""
    mu_i, mu_o = np.asarray(mu_i, float), np.asarray(mu_o, float)
    return albedo * h_function(mu_i, albedo) * h_function(mu_o, albedo) / (4 * math.pi * (mu_i + mu_o))


def half_space_albedo(mu_i, albedo):
    """Directional-hemispherical reflectance of the same: 1 - sqrt(1-w) H(mu)."""
    return 1 - math.sqrt(1 - albedo) * h_function(mu_i, albedo)


def single_scattering(mu_i, mu_o, albedo, tau=math.inf, phase=1.0):
    """Light scattered once by a slab and reflected, 1/sr: Lommel-Seeliger for tau = inf and phase = 1.

    Parameters
    ----------
    mu_i, mu_o : float or ndarray
    albedo : float
    tau : float
        Optical thickness.
    phase : float or ndarray
        4 pi times the phase function (mean 1) at the scattering angle.
    """
    if math.isinf(tau):
        escape = 1.0
    else:
        escape = -np.expm1(-tau * (1 / mu_i + 1 / mu_o))
    return albedo * phase * escape / (4 * math.pi * (mu_i + mu_o))


def single_transmission(mu_i, mu_o, albedo, tau, phase=1.0):
    """Light scattered once by a slab and transmitted, 1/sr (mu_o counted downwards, mu_o != mu_i)."""
    return albedo * phase * (np.exp(-tau / mu_i) - np.exp(-tau / mu_o)) / (4 * math.pi * (mu_i - mu_o))


def henyey_greenstein(cosine, g):
    """4 pi times the phase function; `cosine` between the directions of travel (forward is 1)."""
    return (1 - g * g) / (1 + g * g - 2 * g * cosine) ** 1.5


def rayleigh(cosine):
    """4 pi times Rayleigh's phase function for unpolarised light."""
    return 0.75 * (1 + cosine**2)
