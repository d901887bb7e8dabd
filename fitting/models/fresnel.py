"""Fresnel reflectance of facets for unpolarised light: exact, of dielectrics and conductors, and Schlick's."""

from __future__ import annotations

from fitting.models.contract import Parameter
from gonio.core.jit import kernel
from gonio.core.optics import fresnel_conductor, fresnel_dielectric

ETA = Parameter("eta", 1.01, 4.0, "linear", "index of refraction relative to that above; glass is 1.5")
METAL_ETA = Parameter("eta", 0.02, 10.0, "log", "real part of the index of refraction; gold at 630 nm is 0.2")
METAL_K = Parameter("k", 0.0, 12.0, "linear", "extinction coefficient; gold at 630 nm is 3.4")


@kernel(allocates=False)
def schlick_weight(cos_i):
    """(1 - cos)^5, the share of F90 in Schlick's Fresnel term (Schlick 1994, eq. 15)."""
    x = min(1.0, max(0.0, 1.0 - cos_i))
    x2 = x * x
    return x2 * x2 * x


@kernel(allocates=False)
def dielectric(cos_i, eta):
    """Mean of R_s and R_p; 1 at total internal reflection. See `gonio.core.optics.fresnel_dielectric`."""
    s, p = fresnel_dielectric(min(1.0, cos_i), eta)
    return 0.5 * (s + p)


@kernel(allocates=False)
def conductor(cos_i, eta, k):
    """Mean of R_s and R_p of a metal. See `gonio.core.optics.fresnel_conductor`."""
    s, p = fresnel_conductor(min(1.0, cos_i), eta, k)
    return 0.5 * (s + p)
