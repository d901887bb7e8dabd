"""Walter et al. 2007: reflection and refraction at a rough dielectric, Beckmann or GGX, separable Smith.

The term above the horizon is F D G/(4 cos_i cos_o), the one across it eq. 21. `wi` may lie on either side:
below it light meets the inverse index. Transmitted radiance is compressed: f_s(i, o)/n_o^2 = f_s(o, i)/n_i^2.
"""

from __future__ import annotations

import math

from fitting.models.contract import SHAPE, VARIANTS, Lobe, Parameter, Term
from fitting.models.fresnel import ETA, dielectric, fresnel_slopes
from fitting.models.microfacet import (
    beckmann,
    beckmann_hidden,
    beckmann_hidden_slope,
    beckmann_slope,
    ggx,
    ggx_hidden,
    ggx_hidden_slope,
    ggx_slope,
    reflect,
    visible_ggx,
    visible_ggx_pdf,
)
from gonio.core.directions import dot, half_vector, unit
from gonio.core.jit import kernel
from gonio.core.optics import refract

FAMILY = 8
_BECKMANN, _GGX = range(2)


def _lobe(variant: int, name: str, meaning: str) -> Lobe:
    return Lobe(
        name=name,
        kind=VARIANTS * FAMILY + variant,
        parameters=(Parameter("alpha", 1e-3, 2.0, "log", meaning), ETA),
        terms=(Term("specular_reflectance"), Term("specular_transmittance")),
        source="Walter et al., Microfacet models for refraction through rough surfaces, EGSR 2007, eq. 20, 21, 23",
        errata="Smith's G1 of Beckmann facets is exact, not the paper's rational fit (eq. 27).",
        transmits=True,
    )


BECKMANN = _lobe(
    _BECKMANN, "walter_beckmann", "Beckmann roughness, sqrt(2) x rms slope per axis; 0.1 is rough"
)
GGX = _lobe(_GGX, "walter_ggx", "GGX width; 0.1 is rough")


@kernel(allocates=False)
def terms(variant, p, wi, wo):
    """The reflected and the transmitted term, 1/sr; the one whose side `wo` is not on is 0."""
    if wi[2] == 0.0 or wo[2] == 0.0:
        return 0.0, 0.0
    wi, wo, eta = _upright(p, wi, wo)
    if wo[2] > 0.0:
        wh = half_vector(wi, wo)
        value = 0.25 * _density(variant, p, wh) * dielectric(dot(wi, wh), eta)
        return value * _masking(variant, p, wi, wo), 0.0
    wm, cos_i, cos_o = _refracting(wi, wo, eta)
    if cos_i <= 0.0:
        return 0.0, 0.0
    value = (1.0 - dielectric(cos_i, eta)) * _density(variant, p, wm) * cos_i * -cos_o
    jacobian = (cos_i + eta * cos_o) / eta
    return 0.0, value / (jacobian * jacobian) * _masking(variant, p, wi, (wo[0], wo[1], -wo[2]))


@kernel(allocates=False)
def slopes(variant, p, wi, wo, values, out):
    """Derivatives by alpha and eta of the reflected term of light from above; see `fitting.models.contract`."""
    wh = half_vector(wi, wo)
    c = dot(wi, wh)
    if variant == _GGX:
        log = ggx_slope(p[SHAPE], wh)
        hidden_i, slope_i = ggx_hidden_slope(p[SHAPE], wi[2])
        hidden_o, slope_o = ggx_hidden_slope(p[SHAPE], wo[2])
    else:
        log = beckmann_slope(p[SHAPE], wh)
        hidden_i, slope_i = beckmann_hidden_slope(p[SHAPE], wi)
        hidden_o, slope_o = beckmann_hidden_slope(p[SHAPE], wo)
    log -= slope_i / (wi[2] + hidden_i) + slope_o / (wo[2] + hidden_o)
    by_eta, _ = fresnel_slopes(c, p[SHAPE + 1], 0.0)
    out[0], out[1] = values[0] * log, 0.0
    out[2], out[3] = values[0] / dielectric(c, p[SHAPE + 1]) * by_eta, 0.0


@kernel(allocates=False)
def sample(variant, p, wi, u0, u1):
    """Reflection off or refraction at a visible GGX normal.

    Which of the two is drawn by the flat surface's Fresnel reflectance, kept off 0 and 1: the facet's own
    would need a third number. 0 0 0 where refraction was drawn and the facet reflects totally.
    """
    below = wi[2] < 0.0
    wi, _, eta = _upright(p, wi, wi)
    share = _reflected_share(wi[2], eta)
    if u0 < share:
        wm = visible_ggx(p[SHAPE], wi, u0 / share, u1)
        wo = reflect(wi, wm)
    else:
        wm = visible_ggx(p[SHAPE], wi, (u0 - share) / (1.0 - share), u1)
        wo, _ = refract((-wi[0], -wi[1], -wi[2]), wm, eta)
    return (wo[0], wo[1], -wo[2]) if below else wo


@kernel(allocates=False)
def pdf(variant, p, wi, wo):
    """Density of `sample`, 1/sr, over the whole sphere."""
    if wi[2] == 0.0 or wo[2] == 0.0:
        return 0.0
    wi, wo, eta = _upright(p, wi, wo)
    share = _reflected_share(wi[2], eta)
    # a reflection may leave below the horizon, where refractions go too
    density = share * visible_ggx_pdf(p[SHAPE], wi, half_vector(wi, wo))
    wm, cos_i, cos_o = _refracting(wi, wo, eta)
    if cos_i > 0.0:
        jacobian = (cos_i + eta * cos_o) / eta
        normals = 4.0 * cos_i * visible_ggx_pdf(p[SHAPE], wi, wm)
        density += (1.0 - share) * normals * -cos_o / (jacobian * jacobian)
    return density


@kernel(allocates=False)
def _upright(p, wi, wo):
    """Both directions with `wi` above the horizon, and the index on the other side over that on its own."""
    if wi[2] >= 0.0:
        return wi, wo, p[SHAPE + 1]
    return (wi[0], wi[1], -wi[2]), (wo[0], wo[1], -wo[2]), 1.0 / p[SHAPE + 1]


@kernel(allocates=False)
def _reflected_share(cos_i, eta):
    return 0.1 + 0.8 * dielectric(cos_i, eta)


@kernel(allocates=False)
def _refracting(wi, wo, eta):
    """The facet that refracts `wi` to `wo` (eq. 16), its cosines with them; cos_i = 0 where there is none."""
    x, y, z = wi[0] + eta * wo[0], wi[1] + eta * wo[1], wi[2] + eta * wo[2]
    if z == 0.0:
        return (0.0, 0.0, 1.0), 0.0, 0.0
    sign = math.copysign(1.0, z)
    wm = unit((sign * x, sign * y, sign * z))
    cos_i, cos_o = dot(wi, wm), dot(wo, wm)
    if cos_i <= 0.0 or cos_o >= 0.0:
        return wm, 0.0, 0.0
    return wm, cos_i, cos_o


@kernel(allocates=False)
def _density(variant, p, wm):
    return ggx(p[SHAPE], wm) if variant == _GGX else beckmann(p[SHAPE], wm)


@kernel(allocates=False)
def _masking(variant, p, wi, wo):
    """G1(wi) G1(wo) / (cos_i cos_o)."""
    if variant == _GGX:
        hidden_i, hidden_o = ggx_hidden(p[SHAPE], wi[2]), ggx_hidden(p[SHAPE], wo[2])
    else:
        hidden_i, hidden_o = beckmann_hidden(p[SHAPE], wi), beckmann_hidden(p[SHAPE], wo)
    return 1.0 / ((wi[2] + hidden_i) * (wo[2] + hidden_o))
