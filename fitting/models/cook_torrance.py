"""Cook-Torrance microfacet lobes: f_r = F D G / (4 cos_i cos_o) with a choice of each factor.

D: Beckmann, GGX or generalised Trowbridge-Reitz (`fitting.models.gtr`).
G: Smith's with correlated heights, 1/(1 + Lambda_i + Lambda_o), which masks as a random height field does;
Smith's separable G1(i) G1(o), which many programs use and which is darker; that of V-cavities, of 1982.
F: Schlick's F = F0 (1 - s) + F90 s, s = (1 - wi.wh)^5, or exact for a dielectric or a conductor.

Schlick's F is linear in F0 and F90, so both are coefficients per channel and the roughness alpha is the only
number to search: a coloured metal keeps its own F0 in each channel, and no two shape parameters trade
against each other. With F0 and F90 at most 1 the lobe cannot create energy; a fit does not force this, it
reports the albedo it found. An F90 other than 1 takes up what Schlick's curve and single scattering leave
out. With the exact F the index is a shape parameter, and the coefficient a factor on it, 1 if clean.
"""

from __future__ import annotations

import math
from itertools import product

from fitting.models import gtr as gtr_facets
from fitting.models.contract import SHAPE, VARIANTS, Lobe, Parameter, Term
from fitting.models.fresnel import (
    ETA,
    METAL_ETA,
    METAL_K,
    conductor,
    dielectric,
    fresnel_slopes,
    schlick_weight,
)
from fitting.models.gtr import gtr, sin2_normal
from fitting.models.microfacet import (
    beckmann,
    beckmann_hidden,
    beckmann_hidden_slope,
    beckmann_slope,
    ggx,
    ggx_hidden,
    ggx_hidden_slope,
    ggx_slope,
    normal_of_tangent,
    reflect,
    visible_ggx,
    visible_ggx_pdf,
)
from gonio.core.directions import dot, half_vector
from gonio.core.jit import kernel

FAMILY = 3
# variant = distribution + 3 shadowing + 9 Fresnel term
_BECKMANN, _GGX, _GTR = range(3)
_SMITH, _SEPARABLE, _V_CAVITY = range(3)
_SCHLICK, _DIELECTRIC, _CONDUCTOR = range(3)

_gtr_hidden, _gtr_hidden_slopes, gtr_slope = (
    gtr_facets.hidden,
    gtr_facets.hidden_slopes,
    gtr_facets.log_slopes,
)

_DISTRIBUTIONS: tuple[tuple[str, tuple[Parameter, ...], str], ...] = (
    (
        "beckmann",
        (
            Parameter(
                "alpha", 1e-3, 2.0, "log", "Beckmann roughness, sqrt(2) x rms slope per axis; 0.1 is rough"
            ),
        ),
        "D of Walter et al., Microfacet models for refraction, 2007, eq. 25",
    ),
    (
        "ggx",
        (Parameter("alpha", 1e-3, 2.0, "log", "GGX width; 0.1 is rough"),),
        "D of Walter et al., Microfacet models for refraction, 2007, eq. 33",
    ),
    (
        "gtr",
        (gtr_facets.ALPHA, gtr_facets.GAMMA),
        "D of Burley, Physically based shading at Disney, 2012, appendix B.2",
    ),
)
_SHADOWINGS = (
    ("", "height-correlated Smith, Heitz, Understanding the masking-shadowing function, 2014, eq. 99"),
    ("_separable", "separable Smith, Walter et al. 2007, eq. 23"),
    ("_v_cavity", "G of V-cavities, Cook and Torrance 1982"),
)
_FRESNELS: tuple[tuple[str, tuple[Parameter, ...], tuple[Term, ...], str], ...] = (
    ("", (), (Term("f0"), Term("f90")), "Fresnel term of Schlick 1994, eq. 15"),
    ("_dielectric", (ETA,), (Term("specular_reflectance"),), "exact Fresnel term of a dielectric"),
    ("_conductor", (METAL_ETA, METAL_K), (Term("specular_reflectance"),), "exact Fresnel term of a metal"),
)
_ERRATA = (
    "The 1982 paper divides by pi where its D, not normalised, makes the lobe 4 times too bright; "
    "4 and the normalised D are used."
)
_GTR_ERRATA = (
    " Burley pairs D with GGX's G; with Smith's the lobe needs the G of its own facets, and has it here."
)


def _lobe(d: int, g: int, f: int) -> Lobe:
    distribution, shape, d_source = _DISTRIBUTIONS[d]
    shadowing, g_source = _SHADOWINGS[g]
    fresnel, index, terms_, f_source = _FRESNELS[f]
    return Lobe(
        name=distribution + shadowing + fresnel,
        kind=VARIANTS * FAMILY + d + 3 * g + 9 * f,
        parameters=(*shape, *index),
        terms=terms_,
        source=(
            "Cook and Torrance, A reflectance model for computer graphics, 1982; "
            f"{d_source}; {g_source}; {f_source}"
        ),
        errata=_ERRATA + (_GTR_ERRATA if d == _GTR else ""),
        derive=gtr_facets.derive if d == _GTR else None,
    )


LOBES = tuple(_lobe(d, g, f) for f, g, d in product(range(3), repeat=3))
"""beckmann, ggx, gtr; with _separable, _v_cavity; with _dielectric, _conductor."""


@kernel(allocates=False)
def _density(d, p, wm):
    """D of the distribution `d`, 1/sr."""
    if d == _GGX:
        return ggx(p[SHAPE], wm)
    if d == _BECKMANN:
        return beckmann(p[SHAPE], wm)
    return gtr(p, wm)


@kernel(allocates=False)
def _hidden(d, p, w):
    """Smith's Lambda x cos of the distribution `d`."""
    if d == _GGX:
        return ggx_hidden(p[SHAPE], w[2])
    if d == _BECKMANN:
        return beckmann_hidden(p[SHAPE], w)
    return _gtr_hidden(p, w[2])


@kernel(allocates=False)
def terms(variant, p, wi, wo):
    """With Schlick's F the F0 and the F90 term; else the lobe, 1/sr."""
    d = variant % 3
    if variant // 3 % 3 == _V_CAVITY:
        return terms_of_sides(variant, p, wi, wo, 0.0, 0.0)
    return terms_of_sides(variant, p, wi, wo, _hidden(d, p, wi), _hidden(d, p, wo))


@kernel(allocates=False)
def side(variant, p, tangents, w, out):
    """What Smith's G needs of one direction alone: Lambda x cos, and with tangents its derivatives."""
    d = variant % 3
    if variant // 3 % 3 == _V_CAVITY:
        return
    if len(tangents) == 0:
        out[0] = _hidden(d, p, w)
    else:
        out[0], out[1], out[2] = _hidden_slopes(d, p, tangents, w)


@kernel(allocates=False)
def terms_of_sides(variant, p, wi, wo, hidden_i, hidden_o):
    """`terms`, of what `side` gives of each direction."""
    d, g, f = variant % 3, variant // 3 % 3, variant // 9
    wh = half_vector(wi, wo)
    value = 0.25 * _density(d, p, wh)
    if value == 0.0:
        return 0.0, 0.0
    c = dot(wi, wh)
    # G/(cos_i cos_o), so written that it is finite at the horizon
    if g == _V_CAVITY:
        value *= min(1.0 / (wi[2] * wo[2]), 2.0 * wh[2] / (c * max(wi[2], wo[2])))
    elif g == _SMITH:
        value /= wi[2] * wo[2] + wo[2] * hidden_i + wi[2] * hidden_o
    else:
        value /= (wi[2] + hidden_i) * (wo[2] + hidden_o)
    if f == _SCHLICK:
        s = schlick_weight(c)
        return value * (1.0 - s), value * s
    at = SHAPE + 2 if d == _GTR else SHAPE + 1
    if f == _DIELECTRIC:
        return value * dielectric(c, p[at]), 0.0
    return value * conductor(c, p[at], p[at + 1]), 0.0


@kernel(allocates=False)
def slopes(variant, p, tangents, wi, wo, values, side_i, side_o, out):
    """Derivatives by the shape parameters, of which D and G know the first ones and F the others.

    `tangents`, shape (parameters, SIZE), are derivatives of `p`; see `fitting.models.contract`. Those of G are
    in `side_i` and `side_o`, of `side`.
    """
    d, g, f = variant % 3, variant // 3 % 3, variant // 9
    wh = half_vector(wi, wo)
    facets = 2 if d == _GTR else 1
    for j in range(facets):
        if d == _GGX:
            log = ggx_slope(p[SHAPE], wh)
        elif d == _BECKMANN:
            log = beckmann_slope(p[SHAPE], wh)
        else:
            log = gtr_slope(p, tangents, wh, j)
        if g == _SMITH:
            seen = wi[2] * wo[2] + wo[2] * side_i[0] + wi[2] * side_o[0]
            log -= (wo[2] * side_i[1 + j] + wi[2] * side_o[1 + j]) / seen
        elif g == _SEPARABLE:
            log -= side_i[1 + j] / (wi[2] + side_i[0]) + side_o[1 + j] / (wo[2] + side_o[0])
        out[2 * j], out[2 * j + 1] = values[0] * log, values[1] * log
    if f == _SCHLICK:
        return
    c = dot(wi, wh)
    at = SHAPE + facets
    if f == _DIELECTRIC:
        reflected, k = dielectric(c, p[at]), 0.0
    else:
        reflected, k = conductor(c, p[at], p[at + 1]), p[at + 1]
    by_eta, by_k = fresnel_slopes(c, p[at], k)
    out[2 * facets], out[2 * facets + 1] = values[0] / reflected * by_eta, 0.0
    if f == _CONDUCTOR:
        out[2 * facets + 2], out[2 * facets + 3] = values[0] / reflected * by_k, 0.0


@kernel(allocates=False)
def _hidden_slopes(d, p, tangents, w):
    """`_hidden` and its derivatives by the facets' parameters, the second 0 where there is one."""
    if d == _GTR:
        return _gtr_hidden_slopes(p, tangents, w[2])
    value, slope = ggx_hidden_slope(p[SHAPE], w[2]) if d == _GGX else beckmann_hidden_slope(p[SHAPE], w)
    return value, slope, 0.0


@kernel(allocates=False)
def sample(variant, p, wi, u0, u1):
    """Reflection off a facet.

    Smith's lobes draw visible GGX normals of width alpha. For Beckmann facets too: GGX's tails lie above
    Beckmann's, so with Smith's G the weight stays below (4/e) sqrt(pi) = 2.6, where drawing from D cos is
    unbounded towards grazing. V-cavities draw from D cos: their G is at most 2 cos_h cos_i / wi.wh, so the
    weight is at most 2. GTR draws from D cos, as its tails may lie above GGX's.
    """
    d, g = variant % 3, variant // 3 % 3
    if g != _V_CAVITY and d != _GTR:
        return reflect(wi, visible_ggx(p[SHAPE], wi, u0, u1))
    if d == _GTR:
        sin2 = sin2_normal(p, u0)
        sine, cosine = math.sqrt(sin2), math.sqrt(1.0 - sin2)
        phi = 2.0 * math.pi * u1
        return reflect(wi, (sine * math.cos(phi), sine * math.sin(phi), cosine))
    tangent = math.sqrt(u0 / (1.0 - u0)) if d == _GGX else math.sqrt(-math.log1p(-u0))
    tangent *= p[SHAPE]
    phi = 2.0 * math.pi * u1
    return reflect(wi, normal_of_tangent(tangent * math.cos(phi), tangent * math.sin(phi)))


@kernel(allocates=False)
def pdf(variant, p, wi, wo):
    """Density of `sample`, 1/sr."""
    d, g = variant % 3, variant // 3 % 3
    wh = half_vector(wi, wo)
    if g != _V_CAVITY and d != _GTR:
        return visible_ggx_pdf(p[SHAPE], wi, wh)
    c = dot(wi, wh)
    if c <= 0.0:
        return 0.0
    # below the horizon it is the flip of a drawn one that faced away from `wi`
    cos_h = abs(wh[2])
    return _density(d, p, (wh[0], wh[1], cos_h)) * cos_h / (4.0 * c)
