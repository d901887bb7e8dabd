"""Lambert's law: the same radiance in all directions, f_r = albedo / pi (Lambert 1760)."""

from __future__ import annotations

import math

from fitting.models.contract import VARIANTS, Lobe, Term
from gonio.core.directions import cosine_hemisphere
from gonio.core.jit import kernel

FAMILY = 0
_INV_PI = 1.0 / math.pi

LOBE = Lobe(
    name="lambert",
    kind=VARIANTS * FAMILY,
    parameters=(),
    terms=(Term("albedo"),),
    source="J. H. Lambert, Photometria, 1760",
    diffuse=True,
)


@kernel(allocates=False)
def terms(p, wi, wo):
    """1/pi; see `fitting.models.contract`."""
    return _INV_PI, 0.0


@kernel(allocates=False)
def sample(p, wi, u0, u1):
    """Cosine-distributed, for any diffuse lobe."""
    return cosine_hemisphere(u0, u1)


@kernel(allocates=False)
def pdf(p, wi, wo):
    """Density of `sample`: cos(theta_o)/pi above the horizon."""
    return max(0.0, wo[2]) * _INV_PI
