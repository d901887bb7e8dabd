"""EON, the energy-preserving Oren-Nayar model (Portsmouth, Kutz and Hill 2024): Fujii's variant + what it loses.

f_r = rho f_ss + rho^2 / (1 - rho (1 - <E>)) f_ms: single scattering of Lambertian cavities, and multiple
scattering sent where the single one lacks energy, with the albedo of all its bounces. A white surface
reflects all light at every angle and roughness.
"""

from __future__ import annotations

import math

from fitting.models.contract import SHAPE, VARIANTS, Lobe, Parameter, Term
from gonio.core.directions import cosine_hemisphere, dot
from gonio.core.jit import kernel

FAMILY = 2
_INV_PI = 1.0 / math.pi
_C1 = 0.5 - 2.0 / (3.0 * math.pi)
_C2 = 2.0 / 3.0 - 28.0 / (15.0 * math.pi)


def missing(roughness: float) -> float:
    """1 - <E>: the share of diffuse light that single scattering of a white surface does not return."""
    return (_C1 - _C2) * roughness / (1.0 + _C1 * roughness)


LOBE = Lobe(
    name="eon",
    kind=VARIANTS * FAMILY,
    parameters=(
        Parameter("roughness", 0.0, 1.0, "linear", "Fujii's r; 0 is Lambert, 1 as rough as the model goes"),
    ),
    terms=(Term("rho"), Term("rho", power=2, feedback=missing)),
    source=(
        "Portsmouth, Kutz and Hill, EON: a practical energy-preserving rough diffuse BRDF, "
        "arXiv 2410.18026, 2024"
    ),
    errata="The exact directional albedo is used, not the paper's fit to it.",
    diffuse=True,
)


@kernel(allocates=False)
def terms(p, wi, wo):
    """f_ss and f_ms, 1/sr."""
    r = p[SHAPE]
    scale = 1.0 / (1.0 + _C1 * r)
    s = dot(wi, wo) - wi[2] * wo[2]
    if s > 0.0:
        s /= max(wi[2], wo[2])
    average = scale * (1.0 + _C2 * r)
    # (1 - E_i)(1 - E_o)/(1 - <E>)
    lacking = scale * r * _lacking(wi[2]) * _lacking(wo[2]) / (_C1 - _C2)
    return scale * (1.0 + r * s) * _INV_PI, average * lacking * _INV_PI


@kernel(allocates=False)
def slopes(p, wi, wo, out):
    """Derivatives by the roughness; see `fitting.models.contract`."""
    r = p[SHAPE]
    scale = 1.0 / (1.0 + _C1 * r)
    s = dot(wi, wo) - wi[2] * wo[2]
    if s > 0.0:
        s /= max(wi[2], wo[2])
    # d scale/dr = -C1 scale^2; f_ms = scale^2 (r + C2 r^2) x lacking
    out[0] = scale * (s - _C1 * scale * (1.0 + r * s)) * _INV_PI
    lacking = _lacking(wi[2]) * _lacking(wo[2]) / (_C1 - _C2)
    growth = 1.0 + 2.0 * _C2 * r - 2.0 * _C1 * scale * r * (1.0 + _C2 * r)
    out[1] = scale * scale * growth * lacking * _INV_PI


@kernel(allocates=False)
def sample(p, wi, u0, u1):
    """Cosine-distributed, or uniform, which bounds the weight towards grazing retro-reflection."""
    uniform = _uniform_share(p[SHAPE])
    if u0 >= uniform:
        return cosine_hemisphere((u0 - uniform) / (1.0 - uniform), u1)
    z = u0 / uniform
    sine = math.sqrt(1.0 - z * z)
    phi = 2.0 * math.pi * u1
    return sine * math.cos(phi), sine * math.sin(phi), z


@kernel(allocates=False)
def pdf(p, wi, wo):
    """Density of `sample`, 1/sr."""
    if wo[2] <= 0.0:
        return 0.0
    uniform = _uniform_share(p[SHAPE])
    return ((1.0 - uniform) * wo[2] + 0.5 * uniform) * _INV_PI


@kernel(allocates=False)
def _uniform_share(r):
    return 0.3 * r


@kernel(allocates=False)
def _lacking(mu):
    """C1 - G/pi, in which the albedo E = 1 - r (C1 - G/pi)/(1 + C1 r); 0 at the horizon.

    So written that mu = 0 is no 0/0.
    """
    sine = math.sqrt(max(0.0, 1.0 - mu * mu))
    grazing = sine * mu * (1.0 + sine + sine * sine) / (1.0 + sine)  # tan (1 - sin^3)
    g = sine * (math.acos(min(1.0, mu)) - sine * mu) + 2.0 / 3.0 * (grazing - sine)
    return max(0.0, _C1 - g * _INV_PI)
