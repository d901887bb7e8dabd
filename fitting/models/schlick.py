"""Schlick 1994: a rational lobe of the half vector, its shadowing, and what it hides sent out evenly.

f_r = F (G(cos_i) G(cos_o) Z(cos_h) A(w) / (4 pi cos_i cos_o) + (1 - G(cos_i) G(cos_o)) / pi), with Schlick's F
split into its F0 and F90 parts as in `cook_torrance`. Z is GGX's distribution of width alpha = sqrt(r).
"""

from __future__ import annotations

import math

from fitting.models.contract import SHAPE, VARIANTS, Lobe, Parameter, Term
from fitting.models.fresnel import schlick_weight
from fitting.models.microfacet import reflect
from gonio.core.directions import dot, half_vector
from gonio.core.jit import kernel

FAMILY = 6
_ISOTROPIC, _ANISOTROPIC = range(2)

_ROUGHNESS = Parameter("roughness", 1e-6, 1.0, "log", "r, GGX's alpha squared; 0.01 is rough, 1 flat")
_SOURCE = (
    "Schlick, An inexpensive BRDF model for physically-based rendering, Computer Graphics Forum 13(3), 1994: "
    "Z, A, G, and D with the self-shadowed light sent out evenly"
)
_ERRATA = (
    "The paper divides D among a diffuse, a glossy and a mirror part by weights made of r; here the glossy "
    "part stands alone, under a coefficient of its own. It creates energy towards grazing: the albedo of a "
    "white lobe passes 1 beyond 60 degrees and at 89 degrees is 1.24 at r = 1, 1.70 at r = 0.25, 2.43 at "
    "r = 0.01."
)

ISOTROPIC = Lobe(
    name="schlick",
    kind=VARIANTS * FAMILY + _ISOTROPIC,
    parameters=(_ROUGHNESS,),
    terms=(Term("f0"), Term("f90")),
    source=_SOURCE,
    errata=_ERRATA,
)
ANISOTROPIC = Lobe(
    name="schlick_anisotropic",
    kind=VARIANTS * FAMILY + _ANISOTROPIC,
    parameters=(
        _ROUGHNESS,
        Parameter("isotropy", 0.01, 1.0, "log", "p, 1 is isotropic; less stretches the highlight along y"),
    ),
    terms=(Term("f0"), Term("f90")),
    source=_SOURCE,
    errata=_ERRATA
    + " A is normalised at p = 1 only: its mean over the azimuth is 0.97 at p = 0.5, 0.74 at p = 0.1.",
    isotropic=False,
)


@kernel(allocates=False)
def terms(variant, p, wi, wo):
    """The F0 and the F90 term, 1/sr."""
    wh = half_vector(wi, wo)
    r = p[SHAPE]
    # G(v)/v = 1/(r - r v + v)
    i, o = 1.0 / (r - r * wi[2] + wi[2]), 1.0 / (r - r * wo[2] + wo[2])
    hidden = 1.0 - i * wi[2] * o * wo[2]
    value = (0.25 * i * o * _zenith(r, wh) * math.sqrt(_azimuth(variant, p, wh)) + hidden) / math.pi
    s = schlick_weight(dot(wi, wh))
    return value * (1.0 - s), value * s


@kernel(allocates=False)
def slopes(p, wi, wo, out):
    """Derivatives by the roughness of the isotropic lobe; see `fitting.models.contract`."""
    wh = half_vector(wi, wo)
    r = p[SHAPE]
    i, o = 1.0 / (r - r * wi[2] + wi[2]), 1.0 / (r - r * wo[2] + wo[2])
    seen = -i * o * ((1.0 - wi[2]) * i + (1.0 - wo[2]) * o)  # d(i o)/dr
    cos2 = wh[2] * wh[2]
    base = wh[0] * wh[0] + wh[1] * wh[1] + r * cos2
    zenith = (base - 2.0 * r * cos2) / (base * base * base)
    value = (0.25 * (seen * _zenith(r, wh) + i * o * zenith) - wi[2] * wo[2] * seen) / math.pi
    s = schlick_weight(dot(wi, wh))
    out[0], out[1] = value * (1.0 - s), value * s


@kernel(allocates=False)
def sample(variant, p, wi, u0, u1):
    """Half of the draws reflect off a half vector of density Z A^2/pi cos, half are cosine-distributed."""
    phi = 2.0 * math.pi * u1
    if u0 < 0.5:
        r = math.sqrt(2.0 * u0)
        return r * math.cos(phi), r * math.sin(phi), math.sqrt(1.0 - 2.0 * u0)
    u0 = 2.0 * u0 - 1.0
    cos2 = (1.0 - u0) / (1.0 - u0 + p[SHAPE] * u0)
    sine, cosine = math.sqrt(p[SHAPE] * u0 / (1.0 - u0 + p[SHAPE] * u0)), math.sqrt(cos2)
    x, y = math.cos(phi), math.sin(phi)
    if variant == _ANISOTROPIC:
        x *= p[SHAPE + 1]
        scale = 1.0 / math.sqrt(x * x + y * y)
        x, y = x * scale, y * scale
    return reflect(wi, (sine * x, sine * y, cosine))


@kernel(allocates=False)
def pdf(variant, p, wi, wo):
    """Density of `sample`, 1/sr; a half vector below the horizon is the flip of a drawn one."""
    wh = half_vector(wi, wo)
    c = dot(wi, wh)
    diffuse = 0.5 * max(0.0, wo[2]) / math.pi
    if c <= 0.0:
        return diffuse
    normals = _zenith(p[SHAPE], wh) * _azimuth(variant, p, wh) / math.pi * abs(wh[2])
    return diffuse + 0.5 * normals / (4.0 * c)


@kernel(allocates=False)
def _zenith(r, wh):
    """Z = r / (1 + r cos_h^2 - cos_h^2)^2."""
    base = wh[0] * wh[0] + wh[1] * wh[1] + r * wh[2] * wh[2]
    return r / (base * base)


@kernel(allocates=False)
def _azimuth(variant, p, wh):
    """A(w)^2 = p / (p^2 - p^2 w^2 + w^2), w = cos of the half vector's azimuth; its mean over it is 1."""
    if variant == _ISOTROPIC:
        return 1.0
    sin2 = wh[0] * wh[0] + wh[1] * wh[1]
    if sin2 == 0.0:
        return 1.0
    w2 = wh[0] * wh[0] / sin2
    isotropy = p[SHAPE + 1]
    return isotropy / (isotropy * isotropy * (1.0 - w2) + w2)
