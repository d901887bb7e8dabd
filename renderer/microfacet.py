"""Rough conductors: one microfacet reflection with Smith's masking, Beckmann or GGX.

Directions are local, z the shading normal, all in the upper hemisphere. Masking of the two directions is
independent (separable), as in Mitsuba's ``roughconductor``. GGX facets are drawn as the viewer sees them
(Dupuy & Benyoub 2023, "Sampling visible GGX normals with spherical caps"), Beckmann's by D cos.
"""

from __future__ import annotations

import math

from gonio.core.jit import kernel

BECKMANN, GGX = 0, 1


@kernel(allocates=False)
def facet_density(cosine, alpha, distribution):
    """D(m) of Walter et al. 2007, equations 25 and 33, in 1/sr."""
    cos2 = cosine * cosine
    tan2 = (1.0 - cos2) / cos2
    if distribution == GGX:
        x = alpha / (cos2 * (alpha * alpha + tan2))
        return x * x / math.pi
    return math.exp(-tan2 / (alpha * alpha)) / (math.pi * alpha * alpha * cos2 * cos2)


@kernel(allocates=False)
def masking(cosine, alpha, distribution):
    """Smith's G1 of a direction, exact (Beckmann's with the error function, not its rational fit)."""
    if cosine >= 1.0:
        return 1.0
    tangent = math.sqrt(1.0 - cosine * cosine) / cosine
    x = alpha * tangent
    if distribution == GGX:
        return 2.0 / (1.0 + math.sqrt(1.0 + x * x))
    a = 1.0 / x
    if a > 6.0:
        return 1.0
    return 1.0 / (1.0 + 0.5 * (math.erf(a) - 1.0) + math.exp(-a * a) / (2.0 * a * math.sqrt(math.pi)))


@kernel(allocates=False)
def rough_evaluate(wi, wo, alpha, distribution):
    """BRDF times cos(theta_i), without Fresnel, its density, and the cosine at the facet.

    Returns
    -------
    value : float
        1/sr, for reflectance 1.
    density : float
        Of `wi` drawn by `rough_sample` from `wo`, 1/sr.
    cosine : float
        Between `wi` and the facet.
    """
    x, y, z = wi[0] + wo[0], wi[1] + wo[1], wi[2] + wo[2]
    scale = 1.0 / math.sqrt(x * x + y * y + z * z)
    cos_m = z * scale
    cosine = min(1.0, scale * (x * wo[0] + y * wo[1] + z * wo[2]))
    if cosine <= 0.0:
        return 0.0, 0.0, 1.0
    d = facet_density(cos_m, alpha, distribution)
    g_o = masking(wo[2], alpha, distribution)
    value = d * g_o * masking(wi[2], alpha, distribution) / (4.0 * wo[2])
    if distribution == GGX:
        return value, d * g_o / (4.0 * wo[2]), cosine
    return value, d * cos_m / (4.0 * cosine), cosine


@kernel(allocates=False)
def rough_sample(wo, alpha, distribution, u0, u1):
    """A direction of reflection `wi`; it may point below the surface, where the BRDF is zero."""
    phi = 2.0 * math.pi * u0
    if distribution == GGX:
        x, y, z = alpha * wo[0], alpha * wo[1], wo[2]
        scale = 1.0 / math.sqrt(x * x + y * y + z * z)
        x, y, z = x * scale, y * scale, z * scale
        height = (1.0 - u1) * (1.0 + z) - z
        r = math.sqrt(max(0.0, 1.0 - height * height))
        mx, my, mz = alpha * (r * math.cos(phi) + x), alpha * (r * math.sin(phi) + y), height + z
    else:
        r = alpha * math.sqrt(-math.log(u1))
        mx, my, mz = r * math.cos(phi), r * math.sin(phi), 1.0
    scale = 1.0 / math.sqrt(mx * mx + my * my + mz * mz)
    mx, my, mz = mx * scale, my * scale, mz * scale
    twice = 2.0 * (wo[0] * mx + wo[1] * my + wo[2] * mz)
    return twice * mx - wo[0], twice * my - wo[1], twice * mz - wo[2]
