"""Oren-Nayar 1994: Lambertian V-cavities with masking, shadowing and one interreflection.

The full model is f_r = rho L1(sigma) + rho^2 L2(sigma): the interreflection carries the square of the albedo.
The lobe states this as two terms of one coefficient, rho and rho^2. The fit stays exact: for a given sigma
the sum of squares is a quartic in rho, whose minimum is a root of a cubic. The qualitative model keeps what
matters most of the direct term.
"""

from __future__ import annotations

import math

from fitting.models.contract import SHAPE, VARIANTS, Lobe, Parameter, Term
from gonio.core.directions import cos_delta_phi
from gonio.core.jit import kernel

FAMILY = 1
_FULL, _QUALITATIVE = 0, 1
_INV_PI = 1.0 / math.pi
_SOURCE = "Oren and Nayar, Generalization of Lambert's reflectance model, SIGGRAPH 1994, eq. "
_SIGMA = Parameter(
    "sigma", 0.0, 1.5, "linear", "standard deviation of the facets' slope angle, rad; 0 is Lambert"
)

FULL = Lobe(
    name="oren_nayar",
    kind=VARIANTS * FAMILY + _FULL,
    parameters=(_SIGMA,),
    terms=(Term("rho"), Term("rho", power=2)),
    source=_SOURCE + "25 to 28",
    errata=(
        "The constants are those of 1994, not of the 1993 paper. The direct term turns negative where both "
        "directions graze on opposite sides of a rough surface (sigma = 1, 80 degrees): cut off at 0. "
        "The fitted constants create energy near grazing above rho = 0.97."
    ),
    diffuse=True,
)
QUALITATIVE = Lobe(
    name="oren_nayar_qualitative",
    kind=VARIANTS * FAMILY + _QUALITATIVE,
    parameters=(_SIGMA,),
    terms=(Term("rho"),),
    source=_SOURCE + "30",
    errata=(
        "Without interreflection it is too dark: at sigma = 0.5 and rho = 1 it reflects 0.78 of the light at "
        "normal incidence. At sigma = 0.2 it creates 1.5 % at grazing. The paper's footnote replaces 0.33 by "
        "0.57 to make up for some of the loss; 0.33 is used."
    ),
    diffuse=True,
)


@kernel(allocates=False)
def terms(variant, p, wi, wo):
    """L1 and L2 of the full model, the qualitative one as a single term, in 1/sr."""
    s2 = p[SHAPE] * p[SHAPE]
    c23, bounced = _angles(variant, wi, wo)
    direct = 1.0 - 0.5 * s2 / (s2 + 0.33) + s2 / (s2 + 0.09) * c23
    return max(0.0, direct) * _INV_PI, s2 / (s2 + 0.13) * bounced * _INV_PI


@kernel(allocates=False)
def slopes(variant, p, wi, wo, values, out):
    """Derivatives by sigma; see `fitting.models.contract`."""
    s2 = p[SHAPE] * p[SHAPE]
    c23, bounced = _angles(variant, wi, wo)
    # d/d(s2) of s2/(s2 + k) is k/(s2 + k)^2
    direct = -0.165 / ((s2 + 0.33) * (s2 + 0.33)) + 0.09 / ((s2 + 0.09) * (s2 + 0.09)) * c23
    out[0] = 2.0 * p[SHAPE] * direct * _INV_PI if values[0] > 0.0 else 0.0
    out[1] = 2.0 * p[SHAPE] * 0.13 / ((s2 + 0.13) * (s2 + 0.13)) * bounced * _INV_PI


@kernel(allocates=False)
def _angles(variant, wi, wo):
    """What C2 and C3 (eq. 25), and the interreflection (eq. 28), hold of the angles."""
    cos_phi = cos_delta_phi(wi, wo)
    if variant == _QUALITATIVE:
        if cos_phi <= 0.0:
            return 0.0, 0.0
        # sin(larger angle) tan(smaller angle)
        sines = math.sqrt((1.0 - min(1.0, wi[2] * wi[2])) * (1.0 - min(1.0, wo[2] * wo[2])))
        return 0.45 * cos_phi * sines / max(wi[2], wo[2]), 0.0
    # the paper's alpha and beta: the larger and the smaller polar angle
    large = math.acos(min(1.0, min(wi[2], wo[2])))
    small = math.acos(min(1.0, max(wi[2], wo[2])))
    ratio = 2.0 * small * _INV_PI
    c2 = 0.45 * (math.sin(large) if cos_phi >= 0.0 else math.sin(large) - ratio * ratio * ratio)
    c3 = 0.125 * (2.0 * large * _INV_PI * ratio) ** 2
    direct = cos_phi * c2 * math.tan(small) + (1.0 - abs(cos_phi)) * c3 * math.tan(0.5 * (large + small))
    return direct, 0.17 * (1.0 - cos_phi * ratio * ratio)
