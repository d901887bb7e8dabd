"""Ashikhmin-Shirley 2000: a normalised Phong lobe of the half vector, anisotropic or not, and its diffuse term.

As in `cook_torrance`, Schlick's Fresnel term is split into its F0 and F90 parts, whose weights are
coefficients per channel. The paper couples the diffuse term to the specular by R_d (1 - R_s); that
product per channel is the coefficient here.
"""

from __future__ import annotations

import math

from fitting.models.contract import SHAPE, VARIANTS, Lobe, Parameter, Term
from fitting.models.fresnel import schlick_weight
from fitting.models.microfacet import reflect
from gonio.core.directions import dot, half_vector
from gonio.core.jit import kernel

FAMILY = 4
_ISOTROPIC, _ANISOTROPIC, _DIFFUSE = range(3)
_SOURCE = "Ashikhmin and Shirley, An anisotropic Phong BRDF model, Journal of Graphics Tools 5(2), 2000, eq. "

SPECULAR = Lobe(
    name="ashikhmin_shirley",
    kind=VARIANTS * FAMILY + _ISOTROPIC,
    parameters=(Parameter("exponent", 1.0, 1e6, "log", "n_u = n_v; about 2/alpha^2, so 200 is alpha = 0.1"),),
    terms=(Term("f0"), Term("f90")),
    source=_SOURCE + "4",
)
ANISOTROPIC = Lobe(
    name="ashikhmin_shirley_anisotropic",
    kind=VARIANTS * FAMILY + _ANISOTROPIC,
    parameters=(
        Parameter("exponent_u", 1.0, 1e6, "log", "n_u, along x; about 2/alpha_x^2"),
        Parameter("exponent_v", 1.0, 1e6, "log", "n_v, along y; about 2/alpha_y^2"),
    ),
    terms=(Term("f0"), Term("f90")),
    source=_SOURCE + "4",
    isotropic=False,
)
DIFFUSE = Lobe(
    name="ashikhmin_shirley_diffuse",
    kind=VARIANTS * FAMILY + _DIFFUSE,
    parameters=(),
    terms=(Term("rd"),),
    source=_SOURCE + "5; rd stands for R_d (1 - R_s)",
    diffuse=True,
)


@kernel(allocates=False)
def terms(variant, p, wi, wo):
    """The lobe, density of normals / (4 wi.wh max(cos_i, cos_o)), times the F0 and the F90 part, 1/sr.

    The diffuse term is 28/(23 pi) (1 - (1 - cos_i/2)^5) (1 - (1 - cos_o/2)^5).
    """
    if variant == _DIFFUSE:
        grazing_i = schlick_weight(0.5 * wi[2])
        grazing_o = schlick_weight(0.5 * wo[2])
        return 28.0 / (23.0 * math.pi) * (1.0 - grazing_i) * (1.0 - grazing_o), 0.0
    wh = half_vector(wi, wo)
    c = dot(wi, wh)
    value = 0.25 * _density(variant, p, wh) / (c * max(wi[2], wo[2]))
    s = schlick_weight(c)
    return value * (1.0 - s), value * s


@kernel(allocates=False)
def slopes(p, wi, wo, values, out):
    """Derivatives by the exponent of the isotropic lobe; see `fitting.models.contract`."""
    wh = half_vector(wi, wo)
    sin2 = wh[0] * wh[0] + wh[1] * wh[1]
    log = 1.0 / (p[SHAPE] + 1.0) + (0.5 * math.log1p(-sin2) if sin2 < 1.0 else 0.0)
    out[0], out[1] = values[0] * log, values[1] * log


@kernel(allocates=False)
def sample(variant, p, wi, u0, u1):
    """Reflection off a half vector drawn by its density (eq. 6 to 9); may point below the horizon."""
    n_u, n_v = _exponents(variant, p)
    phi = 2.0 * math.pi * u1
    x, y = math.cos(phi) / math.sqrt(n_u + 1.0), math.sin(phi) / math.sqrt(n_v + 1.0)
    scale = 1.0 / math.sqrt(x * x + y * y)
    x, y = x * scale, y * scale
    # cos = (1 - u0)^(1/(n+1)); the sine by expm1, since cos rounds to 1 at large n
    log_cos = math.log1p(-u0) / (n_u * x * x + n_v * y * y + 1.0)
    sine = math.sqrt(-math.expm1(2.0 * log_cos))
    return reflect(wi, (sine * x, sine * y, math.exp(log_cos)))


@kernel(allocates=False)
def pdf(variant, p, wi, wo):
    """Density of `sample`, 1/sr.

    A half vector below the horizon is the flip of a drawn one that faced away from `wi`.
    """
    wh = half_vector(wi, wo)
    c = dot(wi, wh)
    if c <= 0.0:
        return 0.0
    return _density(variant, p, wh) / (4.0 * c)


@kernel(allocates=False)
def _exponents(variant, p):
    return p[SHAPE], p[SHAPE + 1] if variant == _ANISOTROPIC else p[SHAPE]


@kernel(allocates=False)
def _density(variant, p, wh):
    """Of half vectors: sqrt((n_u + 1)(n_v + 1))/(2 pi) |cos_h|^(n_u cos^2 phi + n_v sin^2 phi), 1/sr.

    The power from the sine: at n = 1e6 a rounded cosine would cost ten digits.
    """
    n_u, n_v = _exponents(variant, p)
    sin2 = wh[0] * wh[0] + wh[1] * wh[1]
    exponent, scale = n_u, n_u + 1.0
    if variant == _ANISOTROPIC:
        scale = math.sqrt((n_u + 1.0) * (n_v + 1.0))
        if sin2 > 0.0:
            exponent = (n_u * wh[0] * wh[0] + n_v * wh[1] * wh[1]) / sin2
    if sin2 >= 1.0:
        return 0.0
    return scale / (2.0 * math.pi) * math.exp(0.5 * exponent * math.log1p(-sin2))
