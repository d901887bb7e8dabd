"""Smooth interfaces: Fresnel's equations, slabs, and slabs over a base, in closed form.

Indices are complex, n + ik with time dependence exp(-i omega t). s and p are kept apart throughout: an array's
first axis is (s, p), and unpolarised light is the mean over it.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import quad


def snell(cos_i, n1, n2):
    """Cosine beyond the interface, complex beyond the critical angle (decaying away from the interface)."""
    sine2 = (n1 / n2) ** 2 * (1.0 - np.asarray(cos_i, float) ** 2)
    cos_t = np.sqrt(1.0 - sine2 + 0j)
    # of the two roots, the one whose wave decays, or travels, away from the interface
    flip = (np.imag(n2 * cos_t) < 0) | ((np.imag(n2 * cos_t) == 0) & (np.real(n2 * cos_t) < 0))
    return np.where(flip, -cos_t, cos_t)


def amplitudes(cos_i, n1, n2):
    """Reflected amplitudes, shape (2, ...): Born & Wolf, section 1.5; r_p = -r_s at normal incidence."""
    cos_t = snell(cos_i, n1, n2)
    r_s = (n1 * cos_i - n2 * cos_t) / (n1 * cos_i + n2 * cos_t)
    r_p = (n2 * cos_i - n1 * cos_t) / (n2 * cos_i + n1 * cos_t)
    return np.array([r_s, r_p])


def reflectance(cos_i, n1, n2):
    """Intensity reflectances (s, p)."""
    return np.abs(amplitudes(cos_i, n1, n2)) ** 2


def unpolarised(cos_i, n1, n2):
    """Intensity reflectance for unpolarised light."""
    return reflectance(cos_i, n1, n2).mean(axis=0)


def refracted_cosine(cos_i, n1, n2):
    """Cosine of the refracted ray; not for total reflection."""
    return np.sqrt(1.0 - (n1 / n2) ** 2 * (1.0 - np.asarray(cos_i, float) ** 2))


def diffuse_external(n):
    """Reflectance of an interface for diffuse light from its thin side (1 to n).

    Quadrature of 2 mu R(mu); Egan & Hilgeman (1973) give the same in closed form.
    """
    return quad(lambda mu: 2 * mu * float(unpolarised(mu, 1.0, n)), 0, 1, epsabs=1e-13, epsrel=1e-12)[0]


def diffuse_internal(n):
    """Reflectance for diffuse light from the dense side, by quadrature; split at the critical angle."""
    critical = math.sqrt(1 - 1 / n**2)

    def inside(mu):
        return 2 * mu * float(unpolarised(mu, n, 1.0))

    return critical**2 + quad(inside, critical, 1, epsabs=1e-13, epsrel=1e-12)[0]


def slab(cos_i, n, tau=0.0, n_above=1.0, n_below=1.0):
    """Reflectance and transmittance (s, p) of a plane-parallel slab by the incoherent geometric series.

    Parameters
    ----------
    cos_i : float
    n : float
        Real index of the slab.
    tau : float
        Absorption optical thickness along the normal; along the refracted ray it is tau / cos_t.
    n_above, n_below : float

    Returns
    -------
    R, T : ndarray, shape (2,)
    """
    cos_t = refracted_cosine(cos_i, n_above, n)
    first, second = reflectance(cos_i, n_above, n), reflectance(cos_t, n, n_below)
    once = math.exp(-tau / cos_t)
    series = 1.0 / (1.0 - first * second * once**2)
    return first + (1 - first) ** 2 * second * once**2 * series, (1 - first) * (1 - second) * once * series


def plate_over_metal(cos_i, n, metal, tau=0.0):
    """Reflectance (s, p) of a smooth plate of index n in touch with smooth metal of complex index `metal`."""
    cos_t = refracted_cosine(cos_i, 1.0, n)
    first, second = reflectance(cos_i, 1.0, n), reflectance(cos_t, n, metal)
    once = math.exp(-tau / cos_t)
    return first + (1 - first) ** 2 * second * once**2 / (1.0 - first * second * once**2)


def interfaced_lambert(cos_i, cos_o, n, rho, tau=0.0):
    """BRDF without the mirror term of a smooth dielectric over a Lambertian base, 1/sr.

    f = rho/pi T_i T_o e^(-tau/mu_i - tau/mu_o) / (n^2 (1 - rho R_in)), with R_in the diffuse internal reflectance
    of the interface seen through the absorbing layer twice (Elias, Simonot & Menu 2001, eq. 9, with absorption).
    """
    mu_i, mu_o = refracted_cosine(cos_i, 1.0, n), refracted_cosine(cos_o, 1.0, n)
    through = (1 - unpolarised(cos_i, 1.0, n)) * (1 - unpolarised(cos_o, 1.0, n))
    path = np.exp(-tau / mu_i - tau / mu_o)
    return rho / math.pi * through * path / (n**2 * (1 - rho * _returned(n, tau)))


def interfaced_lambert_albedo(cos_i, n, rho, tau=0.0):
    """Directional-hemispherical reflectance of the same, its mirror term included."""
    mirror = float(unpolarised(cos_i, 1.0, n))
    mu_i = refracted_cosine(cos_i, 1.0, n)
    arrives = (1 - mirror) * math.exp(-tau / mu_i)
    return mirror + arrives * rho * _escaped(n, tau) / (1 - rho * _returned(n, tau))


def _critical(n):
    return math.sqrt(max(0.0, 1 - 1 / n**2))


def _returned(n, tau):
    """Share of a Lambertian base's light that comes back to it."""

    def back(mu):
        return 2 * mu * float(unpolarised(mu, n, 1.0)) * math.exp(-2 * tau / mu)

    total = quad(back, _critical(n), 1, epsabs=1e-13, epsrel=1e-12)[0]
    if n > 1:  # totally reflected
        total += quad(
            lambda mu: 2 * mu * math.exp(-2 * tau / mu) if mu else 0.0, 0, _critical(n), epsabs=1e-13
        )[0]
    return total


def _escaped(n, tau):
    """Share of a Lambertian base's light that leaves through the interface."""

    def out(mu):
        return 2 * mu * (1 - float(unpolarised(mu, n, 1.0))) * math.exp(-tau / mu) if mu else 0.0

    return quad(out, _critical(n), 1, epsabs=1e-13, epsrel=1e-12)[0]
