"""Ashikhmin-Shirley 2000, isotropic (n_u = n_v = n): a normalised Phong lobe and its diffuse term.

As in `cook_torrance`, Schlick's Fresnel term is split into its F0 and F90 parts, whose weights are
coefficients per channel. The paper couples the diffuse term to the specular by R_d (1 - R_s); that
product per channel is the coefficient here.
"""

from __future__ import annotations

import math

from fitting.models.contract import SHAPE, Lobe, Parameter, Term
from fitting.models.microfacet import dot, schlick_weight
from gonio.core.directions import half_vector
from gonio.core.jit import kernel

_SOURCE = "Ashikhmin and Shirley, An anisotropic Phong BRDF model, Journal of Graphics Tools 5(2), 2000, eq. "

SPECULAR = Lobe(
    name="ashikhmin_shirley",
    kind=5,
    parameters=(Parameter("exponent", 1.0, 1e6, "log", "n_u = n_v; about 2/alpha^2, so 200 is alpha = 0.1"),),
    terms=(Term("f0"), Term("f90")),
    source=_SOURCE + "4",
)
DIFFUSE = Lobe(
    name="ashikhmin_shirley_diffuse",
    kind=6,
    parameters=(),
    terms=(Term("rd"),),
    source=_SOURCE + "5; rd stands for R_d (1 - R_s)",
)


@kernel(allocates=False)
def terms(p, wi, wo):
    """(n + 1)/(8 pi) cos_h^n / (wi.wh max(cos_i, cos_o)), times the F0 and the F90 part, 1/sr."""
    if wi[2] <= 0.0 or wo[2] <= 0.0:
        return 0.0, 0.0
    n = p[SHAPE]
    wh = half_vector(wi, wo)
    c = dot(wi, wh)
    if c <= 0.0:
        return 0.0, 0.0
    value = (n + 1.0) / (8.0 * math.pi) * _power(wh, n) / (c * max(wi[2], wo[2]))
    s = schlick_weight(c)
    return value * (1.0 - s), value * s


@kernel(allocates=False)
def diffuse_terms(p, wi, wo):
    """28/(23 pi) (1 - (1 - cos_i/2)^5) (1 - (1 - cos_o/2)^5), 1/sr."""
    if wi[2] <= 0.0 or wo[2] <= 0.0:
        return 0.0, 0.0
    grazing_i = schlick_weight(0.5 * wi[2])
    grazing_o = schlick_weight(0.5 * wo[2])
    return 28.0 / (23.0 * math.pi) * (1.0 - grazing_i) * (1.0 - grazing_o), 0.0


@kernel(allocates=False)
def sample(p, wi, u0, u1):
    """Reflection off a half vector of density (n + 1)/(2 pi) cos^n (eq. 6); may point below the horizon."""
    n = p[SHAPE]
    # cos = (1 - u0)^(1/(n+1)); the sine by expm1, since cos rounds to 1 at large n
    log_cos = math.log1p(-u0) / (n + 1.0)
    z = math.exp(log_cos)
    sine = math.sqrt(-math.expm1(2.0 * log_cos))
    phi = 2.0 * math.pi * u1
    x, y = sine * math.cos(phi), sine * math.sin(phi)
    d = 2.0 * (wi[0] * x + wi[1] * y + wi[2] * z)
    return d * x - wi[0], d * y - wi[1], d * z - wi[2]


@kernel(allocates=False)
def pdf(p, wi, wo):
    """Density of `sample`, 1/sr.

    A half vector below the horizon is the flip of a drawn one that faced away from `wi`.
    """
    wh = half_vector(wi, wo)
    c = dot(wi, wh)
    if c <= 0.0:
        return 0.0
    return (p[SHAPE] + 1.0) / (8.0 * math.pi) * _power(wh, p[SHAPE]) / c


@kernel(allocates=False)
def _power(wh, n):
    """|cos_h|^n, from the sine: at n = 1e6 a rounded cosine would cost ten digits."""
    sin2 = wh[0] * wh[0] + wh[1] * wh[1]
    if sin2 >= 1.0:
        return 0.0
    return math.exp(0.5 * n * math.log1p(-sin2))
