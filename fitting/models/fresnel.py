"""Fresnel reflectance of facets for unpolarised light: exact, of dielectrics and conductors, and Schlick's."""

from __future__ import annotations

from fitting.models.contract import Parameter
from gonio.core.jit import kernel
from gonio.core.optics import fresnel_conductor, fresnel_dielectric

ETA = Parameter("eta", 1.01, 4.0, "linear", "index of refraction relative to that above; glass is 1.5", True)
METAL_ETA = Parameter(
    "eta", 0.02, 10.0, "log", "real part of the index of refraction; gold at 630 nm is 0.2", True
)
METAL_K = Parameter("k", 0.0, 12.0, "linear", "extinction coefficient; gold at 630 nm is 3.4", True)


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


@kernel(allocates=False)
def fresnel_slopes(cos_i, eta, k):
    """Derivatives by eta and by k of `conductor`, and by eta of `dielectric` at k = 0 and eta > 1.

    With n = eta + i k and t = n cos_t = sqrt(n^2 - sin^2): r_s = (c - t)/(c + t), r_p = (n^2 c - t)/(n^2 c + t),
    dt/dn = n/t, and the change of |r|^2/2 is the real part of conj(r) dr.
    """
    c = min(1.0, cos_i)
    n = complex(eta, k)
    t = (n * n - (1.0 - c * c)) ** 0.5
    r_s = (c - t) / (c + t)
    d_s = -2.0 * c * (n / t) / ((c + t) * (c + t))
    nc = n * n * c
    r_p = (nc - t) / (nc + t)
    d_p = 2.0 * (2.0 * n * c * t - nc * (n / t)) / ((nc + t) * (nc + t))
    change = r_s.conjugate() * d_s + r_p.conjugate() * d_p
    return change.real, -change.imag
