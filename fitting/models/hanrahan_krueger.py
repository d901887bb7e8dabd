"""Hanrahan and Krueger 1993: single scattering in a layer under a smooth interface, and a Lambertian base below it.

f_r = albedo T_i T_o/n^2 p(cos) (1 - exp(-tau (1/mu_i + 1/mu_o))) / (mu_i + mu_o)
      + base T_i T_o/n^2 exp(-tau (1/mu_i + 1/mu_o)) / pi

with mu the cosines inside, T the interface's transmittances, p Henyey-Greenstein's phase function. The mirror
reflection at the interface is no part of the lobe: add one for it.
"""

from __future__ import annotations

import math

from fitting.models.contract import SHAPE, VARIANTS, Lobe, Parameter, Term
from fitting.models.fresnel import dielectric, fresnel_slopes
from gonio.core.jit import kernel
from gonio.core.phase import hg

FAMILY = 9

LOBE = Lobe(
    name="hanrahan_krueger",
    kind=VARIANTS * FAMILY,
    parameters=(
        Parameter("tau", 1e-3, 100.0, "log", "optical depth of the layer; 10 is as good as infinite", True),
        Parameter("g", -0.95, 0.95, "linear", "mean cosine of scattering; above 0 is forward", True),
        Parameter("eta", 1.0, 2.5, "linear", "index of the layer relative to that above; 1 is matched", True),
    ),
    terms=(Term("albedo"), Term("base")),
    source=(
        "Hanrahan and Krueger, Reflection from layered surfaces due to subsurface scattering, SIGGRAPH 1993, "
        "sections 3 and 4; the single-scattering albedo and the albedo of the base are the coefficients"
    ),
    errata=(
        "The paper's T12 and T21 hold n^2 and 1/n^2, which cancel only before the incident radiance is "
        "written as irradiance: a BRDF keeps 1/n^2. Light reflected inside at the interface is not followed."
    ),
    diffuse=True,
)


@kernel(allocates=False)
def terms(p, wi, wo):
    """The layer's term at a single-scattering albedo of 1, and the white base's, 1/sr."""
    tau, g, eta = p[SHAPE], p[SHAPE + 1], p[SHAPE + 2]
    mu_i, mu_o = _inside(wi[2], eta), _inside(wo[2], eta)
    through = (1.0 - dielectric(wi[2], eta)) * (1.0 - dielectric(wo[2], eta)) / (eta * eta)
    # of the direction of propagation before and after scattering
    cosine = -(wi[0] * wo[0] + wi[1] * wo[1]) / (eta * eta) - mu_i * mu_o
    depth = tau * (1.0 / mu_i + 1.0 / mu_o)
    scattered = -math.expm1(-depth) * hg(g, cosine) / (mu_i + mu_o)
    return through * scattered, through * math.exp(-depth) / math.pi


@kernel(allocates=False)
def slopes(p, wi, wo, values, out):
    """Derivatives by tau, g and eta; see `fitting.models.contract`."""
    tau, g, eta = p[SHAPE], p[SHAPE + 1], p[SHAPE + 2]
    mu_i, mu_o = _inside(wi[2], eta), _inside(wo[2], eta)
    eta2 = eta * eta
    plane = wi[0] * wo[0] + wi[1] * wo[1]
    cosine = -plane / eta2 - mu_i * mu_o
    path = 1.0 / mu_i + 1.0 / mu_o
    # of 1 - exp(-depth), relative; and depth/(exp(depth) - 1) is 1 at depth 0
    grown = 1.0 / math.expm1(tau * path) if tau * path < 700.0 else 0.0
    out[0], out[1] = values[0] * path * grown, -values[1] * path
    # d log hg/dg and d log hg/d cosine
    base = 1.0 + g * g - 2.0 * g * cosine
    out[2], out[3] = values[0] * (-2.0 * g / (1.0 - g * g) - 3.0 * (g - cosine) / base), 0.0
    d_i = (1.0 - mu_i * mu_i) / (eta * mu_i)
    d_o = (1.0 - mu_o * mu_o) / (eta * mu_o)
    through = -2.0 / eta
    for cos in (wi[2], wo[2]):
        by_eta, _ = fresnel_slopes(cos, eta, 0.0)
        through -= by_eta / (1.0 - dielectric(cos, eta))
    turned = 2.0 * plane / (eta2 * eta) - d_i * mu_o - mu_i * d_o
    shorter = -tau * (d_i / (mu_i * mu_i) + d_o / (mu_o * mu_o))
    log = through + shorter * grown + 3.0 * g / base * turned - (d_i + d_o) / (mu_i + mu_o)
    out[4], out[5] = values[0] * log, values[1] * (through - shorter)


@kernel(allocates=False)
def _inside(cosine, eta):
    """Cosine beyond the interface."""
    return math.sqrt((eta - 1.0) * (eta + 1.0) + cosine * cosine) / eta
