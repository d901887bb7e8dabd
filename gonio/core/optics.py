"""Fresnel reflectance of smooth interfaces, as kernels on scalars."""

from __future__ import annotations

import math

from gonio.core.jit import kernel


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
    # eta^2 cos^2 theta_t, written so that nothing cancels at grazing incidence or eta near 1
    cos2_t = (eta - 1.0) * (eta + 1.0) + cos_i * cos_i
    if cos2_t <= 0.0:
        return 1.0, 1.0
    cos_t = math.sqrt(cos2_t) / eta
    r_s = (cos_i - eta * cos_t) / (cos_i + eta * cos_t)
    r_p = (eta * cos_i - cos_t) / (eta * cos_i + cos_t)
    return r_s * r_s, r_p * r_p


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
    cos2 = cos_i * cos_i
    sin2 = 1.0 - cos2
    # a + i b = sqrt((eta + i k)^2 - sin^2)
    real = (eta - 1.0) * (eta + 1.0) - k * k + cos2
    imaginary = 2.0 * eta * k
    modulus = math.sqrt(real * real + imaginary * imaginary)
    # the larger root directly, the other from a b = eta k: no cancellation at small k
    if real >= 0.0:
        a = math.sqrt(0.5 * (modulus + real))
        b = eta * k / a
    else:
        b = math.sqrt(0.5 * (modulus - real))
        a = eta * k / b
    r_s = ((a - cos_i) * (a - cos_i) + b * b) / ((a + cos_i) * (a + cos_i) + b * b)
    if cos_i == 0.0:
        return 1.0, 1.0
    tangent = sin2 / cos_i
    r_p = r_s * ((a - tangent) * (a - tangent) + b * b) / ((a + tangent) * (a + tangent) + b * b)
    return r_s, r_p
