"""Cook-Torrance microfacet lobes: Beckmann and GGX with height-correlated Smith, and 1982's V-cavities.

f_r = F D G / (4 cos_i cos_o). Schlick's F = F0 (1 - s) + F90 s, s = (1 - wi.wh)^5, is linear in F0 and
F90, so both are coefficients per channel and the roughness alpha is the only number to search: a coloured
metal keeps its own F0 in each channel, and no two shape parameters trade against each other. With F0 and
F90 at most 1 the lobe cannot create energy (G is height-correlated Smith's, whose single-scattering
albedo is at most 1); a fit does not force this, it reports the albedo it found. An F90 other than 1
takes up what Schlick's curve and single scattering leave out.
"""

from __future__ import annotations

from fitting.models.contract import SHAPE, Lobe, Parameter, Term
from fitting.models.microfacet import (
    beckmann,
    beckmann_lambda,
    dot,
    ggx,
    ggx_root,
    sample_visible_ggx,
    schlick_weight,
    visible_ggx_pdf,
)
from gonio.core.directions import half_vector
from gonio.core.jit import kernel

_FRESNEL = (Term("f0"), Term("f90"))
_BECKMANN_ALPHA = Parameter(
    "alpha", 1e-3, 2.0, "log", "Beckmann roughness, sqrt(2) x rms slope per axis; 0.1 is rough"
)

BECKMANN = Lobe(
    name="beckmann",
    kind=2,
    parameters=(_BECKMANN_ALPHA,),
    terms=_FRESNEL,
    source=(
        "Cook and Torrance, A reflectance model for computer graphics, 1982, with Walter et al. 2007, eq. 20 "
        "and 25, and height-correlated Smith shadowing, Heitz 2014, eq. 99"
    ),
    errata=(
        "The 1982 paper divides by pi where its D, not normalised, makes the lobe 4 times too bright; "
        "4 and the normalised D are used."
    ),
)
GGX = Lobe(
    name="ggx",
    kind=3,
    parameters=(Parameter("alpha", 1e-3, 2.0, "log", "GGX width; 0.1 is rough"),),
    terms=_FRESNEL,
    source="Walter et al., Microfacet models for refraction, 2007, eq. 20, 33; shadowing Heitz 2014, eq. 99",
)
V_CAVITY = Lobe(
    name="v_cavity",
    kind=4,
    parameters=(_BECKMANN_ALPHA,),
    terms=_FRESNEL,
    source="Cook and Torrance, A reflectance model for computer graphics, 1982: Beckmann, G of V-cavities",
    errata=BECKMANN.errata,
)


@kernel(allocates=False)
def beckmann_terms(p, wi, wo):
    """Beckmann with exact height-correlated Smith: the F0 and the F90 term, 1/sr."""
    if wi[2] <= 0.0 or wo[2] <= 0.0:
        return 0.0, 0.0
    alpha = p[SHAPE]
    wh = half_vector(wi, wo)
    value = beckmann(alpha, wh)
    if value == 0.0:
        return 0.0, 0.0
    value /= 4.0 * wi[2] * wo[2] * (1.0 + beckmann_lambda(alpha, wi) + beckmann_lambda(alpha, wo))
    s = schlick_weight(dot(wi, wh))
    return value * (1.0 - s), value * s


@kernel(allocates=False)
def ggx_terms(p, wi, wo):
    """GGX with height-correlated Smith: the F0 and the F90 term, 1/sr."""
    if wi[2] <= 0.0 or wo[2] <= 0.0:
        return 0.0, 0.0
    alpha = p[SHAPE]
    wh = half_vector(wi, wo)
    # G2/(4 cos_i cos_o) in closed form, finite towards the horizon
    value = 0.5 * ggx(alpha, wh) / (wo[2] * ggx_root(alpha, wi[2]) + wi[2] * ggx_root(alpha, wo[2]))
    s = schlick_weight(dot(wi, wh))
    return value * (1.0 - s), value * s


@kernel(allocates=False)
def v_cavity_terms(p, wi, wo):
    """Beckmann with G = min(1, 2 cos_h cos_i/wi.wh, 2 cos_h cos_o/wi.wh): the F0 and the F90 term, 1/sr."""
    if wi[2] <= 0.0 or wo[2] <= 0.0:
        return 0.0, 0.0
    wh = half_vector(wi, wo)
    c = dot(wi, wh)
    value = beckmann(p[SHAPE], wh)
    if value == 0.0 or c <= 0.0:
        return 0.0, 0.0
    # G/(cos_i cos_o) with the smaller cosine cancelled
    larger = max(wi[2], wo[2])
    value *= 0.25 * min(1.0 / (wi[2] * wo[2]), 2.0 * wh[2] / (c * larger))
    s = schlick_weight(c)
    return value * (1.0 - s), value * s


@kernel(allocates=False)
def sample(p, wi, u0, u1):
    """Reflection off a visible GGX normal of width alpha.

    For Beckmann facets too: GGX's tails lie above Beckmann's, so with Smith's G the weight stays below
    (4/e) sqrt(pi) = 2.6, where sampling the half vector alone is unbounded towards grazing. With the G of
    V-cavities, which hides less at grazing, it reaches 40 at 89.4 degrees.
    """
    return sample_visible_ggx(p[SHAPE], wi, u0, u1)


@kernel(allocates=False)
def pdf(p, wi, wo):
    """Density of `sample`, 1/sr."""
    return visible_ggx_pdf(p[SHAPE], wi, wo)
