"""Fresnel's equations and Snell's law at smooth interfaces, as kernels on scalars.

Time dependence exp(-i omega t), indices eta + i k with k >= 0, relative to the real index on the incident side.
Fields are taken along s = d x n and p = d x s, with d the direction of propagation and n the normal; the
same rule holds before and after the interface, so that r_p = -r_s at normal incidence.
"""

from __future__ import annotations

import math

from gonio.core.jit import kernel


@kernel(allocates=False)
def root(real, imaginary):
    """Square root (a, b), a + i b with a, b >= 0, of a complex number in the upper half-plane.

    Of the two waves in a medium it is the one that dies away from the interface, evanescent (real < 0,
    imaginary = 0) or absorbed. The larger part comes from the modulus, the other from 2 a b = imaginary:
    nothing cancels.
    """
    if imaginary == 0.0:
        return (math.sqrt(real), 0.0) if real >= 0.0 else (0.0, math.sqrt(-real))
    modulus = math.sqrt(real * real + imaginary * imaginary)
    if real >= 0.0:
        a = math.sqrt(0.5 * (modulus + real))
        return a, 0.5 * imaginary / a
    b = math.sqrt(0.5 * (modulus - real))
    return 0.5 * imaginary / b, b


@kernel(allocates=False)
def _cos2_t(cos_i, eta):
    """eta^2 cos^2 theta_t, so written that nothing cancels at grazing incidence or eta near 1; <= 0 is TIR."""
    return (eta - 1.0) * (eta + 1.0) + cos_i * cos_i


@kernel(allocates=False)
def refract(d, n, eta):
    """Direction beyond an interface by Snell's law.

    Parameters
    ----------
    d : direction
        Of propagation, towards the interface.
    n : direction
        Unit normal against `d`: d . n <= 0.
    eta : float
        Index beyond the interface over the index on the incident side.

    Returns
    -------
    direction, float
        The refracted direction and cos theta_t > 0; at total internal reflection (0, 0, 0) and 0.
    """
    cos_i = -(d[0] * n[0] + d[1] * n[1] + d[2] * n[2])
    cos2_t = _cos2_t(cos_i, eta)
    if cos2_t <= 0.0:
        return (0.0, 0.0, 0.0), 0.0
    # eta times the direction; its length undoes the rounding of d and n, which else grows by eta^2 on leaving glass
    along = cos_i - math.sqrt(cos2_t)
    x, y, z = d[0] + along * n[0], d[1] + along * n[1], d[2] + along * n[2]
    length = math.sqrt(x * x + y * y + z * z)
    return (x / length, y / length, z / length), math.sqrt(cos2_t) / eta


@kernel(allocates=False)
def fresnel_dielectric(cos_i, eta):
    """Intensity reflectances (R_s, R_p) of a lossless interface.

    Parameters
    ----------
    cos_i : float
        Cosine of the angle of incidence, in [0, 1].
    eta : float
        Index beyond the interface over the index on the incident side.

    Returns
    -------
    tuple of float
        R_s, R_p; both exactly 1 at total internal reflection, exactly 0 for equal indices.
    """
    if eta == 1.0:
        return 0.0, 0.0
    cos2_t = _cos2_t(cos_i, eta)
    if cos2_t <= 0.0:
        return 1.0, 1.0
    cos_t = math.sqrt(cos2_t) / eta
    r_s = (cos_i - eta * cos_t) / (cos_i + eta * cos_t)
    r_p = (eta * cos_i - cos_t) / (eta * cos_i + cos_t)
    return r_s * r_s, r_p * r_p


@kernel(allocates=False)
def fresnel_transmission(cos_i, eta):
    """Transmittances (T_s, T_p) of a lossless interface, and what becomes of E_s E_p*.

    Parameters
    ----------
    cos_i, eta : float
        As in `fresnel_dielectric`.

    Returns
    -------
    T_s, T_p : float
        Fractions of the power, eta cos theta_t / cos theta_i |t|^2 = 1 - R; 0 at total internal reflection.
    cross : float
        eta cos theta_t / cos theta_i t_s t_p, the factor of E_s E_p*; its square is T_s T_p.
    """
    cos2_t = _cos2_t(cos_i, eta)
    if eta == 1.0:
        return 1.0, 1.0, 1.0
    if cos2_t <= 0.0:
        return 0.0, 0.0, 0.0
    cos_t = math.sqrt(cos2_t) / eta
    power = 4.0 * eta * cos_i * cos_t
    s = cos_i + eta * cos_t
    p = eta * cos_i + cos_t
    return power / (s * s), power / (p * p), power / (s * p)


@kernel(allocates=False)
def fresnel_conductor(cos_i, eta, k):
    """Intensity reflectances (R_s, R_p) of an absorbing half-space of index eta + i k seen from vacuum.

    Born & Wolf, Principles of Optics, section 14.2; k = 0 is `fresnel_dielectric`, for eta < 1 too.

    Parameters
    ----------
    cos_i : float
        Cosine of the angle of incidence, in [0, 1].
    eta, k : float
        Real and imaginary part of the relative index.
    """
    if k == 0.0:
        return fresnel_dielectric(cos_i, eta)
    if cos_i == 0.0:
        return 1.0, 1.0
    cos2 = cos_i * cos_i
    sin2 = 1.0 - cos2
    # a + i b = sqrt((eta + i k)^2 - sin^2)
    a, b = root((eta - 1.0) * (eta + 1.0) - k * k + cos2, 2.0 * eta * k)
    r_s = ((a - cos_i) * (a - cos_i) + b * b) / ((a + cos_i) * (a + cos_i) + b * b)
    tangent = sin2 / cos_i
    r_p = r_s * ((a - tangent) * (a - tangent) + b * b) / ((a + tangent) * (a + tangent) + b * b)
    return r_s, r_p


@kernel(allocates=False)
def fresnel_amplitudes(cos_i, eta, k):
    """Amplitude reflectances (r_s, r_p), complex, of a half-space of index eta + i k.

    r_s = (cos_i - q)/(cos_i + q) and r_p = (n^2 cos_i - q)/(n^2 cos_i + q) with n = eta + i k and
    q = n cos theta_t = sqrt(n^2 - sin^2 theta_i), Im q >= 0 (Born & Wolf, sections 1.5 and 14.2, with
    n + i k for n (1 + i kappa)). |r| = 1 to 1 ulp at total internal reflection.

    Parameters
    ----------
    cos_i : float
        Cosine of the angle of incidence, in [0, 1].
    eta, k : float
        Real and imaginary part of the relative index, k >= 0.
    """
    if k == 0.0 and eta == 1.0:
        return complex(0.0, 0.0), complex(0.0, 0.0)
    if cos_i == 0.0:
        return complex(-1.0, 0.0), complex(-1.0, 0.0)
    cos2 = cos_i * cos_i
    sin2 = 1.0 - cos2
    a, b = root((eta - 1.0) * (eta + 1.0) - k * k + cos2, 2.0 * eta * k)
    denominator = (cos_i + a) * (cos_i + a) + b * b
    r_s = complex(((cos_i - a) * (cos_i + a) - b * b) / denominator, -2.0 * cos_i * b / denominator)
    # r_p = -r_s (q cos - sin^2)/(q cos + sin^2), of modulus |r_s| where q is imaginary
    total = a == 0.0
    a *= cos_i
    b *= cos_i
    denominator = (a + sin2) * (a + sin2) + b * b
    ratio = complex(((a - sin2) * (a + sin2) + b * b) / denominator, 2.0 * b * sin2 / denominator)
    r_p = -r_s * ratio
    return (_unit(r_s), _unit(r_p)) if total else (r_s, r_p)


@kernel(allocates=False)
def _unit(r):
    """Put a number of modulus 1 but for a few roundings onto the unit circle: a Newton step of 1/|r|."""
    return r * (1.5 - 0.5 * (r.real * r.real + r.imag * r.imag))
