"""Oren-Nayar 1994, the full model: Lambertian V-cavities with masking, shadowing and one interreflection.

f_r = rho L1(sigma) + rho^2 L2(sigma): the interreflection carries the square of the albedo. The lobe
states this as two terms of one coefficient, rho and rho^2. The fit stays exact: for a given sigma the
sum of squares is a quartic in rho, whose minimum is a root of a cubic.
"""

from __future__ import annotations

import math

from fitting.models.contract import SHAPE, Lobe, Parameter, Term
from gonio.core.directions import cos_delta_phi
from gonio.core.jit import kernel

_INV_PI = 1.0 / math.pi

LOBE = Lobe(
    name="oren_nayar",
    kind=1,
    parameters=(
        Parameter(
            "sigma", 0.0, 1.5, "linear", "standard deviation of the facets' slope angle, rad; 0 is Lambert"
        ),
    ),
    terms=(Term("rho"), Term("rho", power=2)),
    source="Oren and Nayar, Generalization of Lambert's reflectance model, SIGGRAPH 1994, eq. 25 to 28",
    errata=(
        "The constants are those of 1994, not of the 1993 paper. The direct term turns negative where both "
        "directions graze on opposite sides of a rough surface (sigma = 1, 80 degrees): cut off at 0. "
        "The fitted constants create energy near grazing above rho = 0.97."
    ),
)


@kernel(allocates=False)
def terms(p, wi, wo):
    """L1 and L2, in 1/sr; see `fitting.models.contract`."""
    if wi[2] <= 0.0 or wo[2] <= 0.0:
        return 0.0, 0.0
    s2 = p[SHAPE] * p[SHAPE]
    # the paper's alpha and beta: the larger and the smaller polar angle
    large = math.acos(min(1.0, min(wi[2], wo[2])))
    small = math.acos(min(1.0, max(wi[2], wo[2])))
    cos_phi = cos_delta_phi(wi, wo)
    ratio = 2.0 * small * _INV_PI
    c1 = 1.0 - 0.5 * s2 / (s2 + 0.33)
    rough = s2 / (s2 + 0.09)
    c2 = 0.45 * rough * (math.sin(large) if cos_phi >= 0.0 else math.sin(large) - ratio * ratio * ratio)
    c3 = 0.125 * rough * (2.0 * large * _INV_PI * ratio) ** 2
    direct = c1 + cos_phi * c2 * math.tan(small) + (1.0 - abs(cos_phi)) * c3 * math.tan(0.5 * (large + small))
    interreflection = 0.17 * s2 / (s2 + 0.13) * (1.0 - cos_phi * ratio * ratio)
    return max(0.0, direct) * _INV_PI, interreflection * _INV_PI
