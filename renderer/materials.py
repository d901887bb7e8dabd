"""All materials behind two kernels: `evaluate` and `sample`.

Directions are local, z the shading normal; `wi` points to the light, `wo` to the camera (the detector).
`evaluate` returns the BRDF times cos(theta_i) of everything but mirror reflection and refraction; `sample`
draws `wi` for a given `wo` and returns BRDF times cosine over density, mirror terms included. A material
shows its back black unless it is two-sided or lets light through.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gonio.core.directions import cosine_hemisphere
from gonio.core.jit import kernel
from gonio.core.optics import fresnel_conductor, fresnel_dielectric
from gonio.table.anisotropic_pool import AnisotropicPool
from gonio.table.pool import Pool
from renderer.analytic import Lobes, analytic_evaluate, analytic_sample
from renderer.anisotropic import anisotropic_evaluate, anisotropic_sample
from renderer.microfacet import rough_evaluate, rough_sample
from renderer.tabulated import tabulated_evaluate, tabulated_sample

KINDS = ("none", "diffuse", "conductor", "rough_conductor", "dielectric", "plastic", "tabulated", "analytic")
NONE, DIFFUSE, CONDUCTOR, ROUGH_CONDUCTOR, DIELECTRIC, PLASTIC, TABULATED, ANALYTIC = range(len(KINDS))
TRANSMITTING = len(KINDS)
"""An analytic material with lobes that let light through."""
ANISOTROPIC = TRANSMITTING + 1
"""A tabulated material that knows the azimuth; its local x and y are those of `renderer.geometry.tangents`."""


class Materials(NamedTuple):
    """The materials of a scene as kernels take them."""

    kind: np.ndarray  # int64 (M,)
    two_sided: np.ndarray  # int64 (M,)
    values: np.ndarray  # (M, 12), meaning by kind: see renderer.pack_materials
    first: np.ndarray  # int64 (M,), the table in the pool, or the first lobe
    n_lobes: np.ndarray  # int64 (M,), of an analytic model
    pool: Pool
    anisotropic: AnisotropicPool
    lobes: Lobes


@kernel(allocates=False)
def conductor_reflectance(values, m, cosine):
    """Fresnel reflectance of conductor `m`, unpolarised, times its colour: (red, green, blue)."""
    s, p = fresnel_conductor(cosine, values[m, 0], values[m, 3])
    red = 0.5 * (s + p) * values[m, 6]
    s, p = fresnel_conductor(cosine, values[m, 1], values[m, 4])
    green = 0.5 * (s + p) * values[m, 7]
    s, p = fresnel_conductor(cosine, values[m, 2], values[m, 5])
    return red, green, 0.5 * (s + p) * values[m, 8]


@kernel(allocates=False)
def _dielectric_reflectance(cosine, eta):
    s, p = fresnel_dielectric(cosine, eta)
    return 0.5 * (s + p)


@kernel(allocates=False)
def _plastic_diffuse(values, m, cos_i, cos_o):
    """Diffuse part of plastic over Lambert's 1/pi: light that entered, scattered inside and left again."""
    eta = values[m, 0]
    through = (1.0 - _dielectric_reflectance(cos_i, eta)) * (1.0 - _dielectric_reflectance(cos_o, eta))
    through /= eta * eta
    back = values[m, 7]
    red, green, blue = values[m, 1], values[m, 2], values[m, 3]
    if values[m, 8] != 0.0:  # nonlinear: every inner bounce takes its colour
        return (
            through * red / (1.0 - red * back),
            through * green / (1.0 - green * back),
            through * blue / (1.0 - blue * back),
        )
    through /= 1.0 - back
    return through * red, through * green, through * blue


@kernel(allocates=False)
def _plastic_mirror_chance(values, m, cos_o):
    """Chance to follow plastic's mirror reflection rather than its diffuse part."""
    mirror = _dielectric_reflectance(cos_o, values[m, 0])
    weight = values[m, 9]
    return mirror * weight / (mirror * weight + (1.0 - mirror) * (1.0 - weight))


@kernel(allocates=False)
def evaluate(materials, m, wi, wo, memory):
    """BRDF times cos(theta_i) of material `m` without mirror terms, and the density of `wi`.

    Parameters
    ----------
    memory : ndarray, shape (6,)
        Working memory.

    Returns
    -------
    tuple of 4 float
        Red, green, blue in 1/sr; probability density in 1/sr of `sample` drawing `wi` from `wo` by other
        than mirror reflection. All zero where there is no reflection.
    """
    kind = materials.kind[m]
    values = materials.values
    if kind == TRANSMITTING:
        return analytic_evaluate(materials.lobes, materials.first[m], materials.n_lobes[m], wi, wo)
    if materials.two_sided[m] and wo[2] < 0.0:
        wi, wo = (wi[0], wi[1], -wi[2]), (wo[0], wo[1], -wo[2])
    if wi[2] <= 0.0 or wo[2] <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    if kind == DIFFUSE:
        density = wi[2] / math.pi
        return values[m, 0] * density, values[m, 1] * density, values[m, 2] * density, density
    if kind == ROUGH_CONDUCTOR:
        value, density, cosine = rough_evaluate(wi, wo, values[m, 9], int(values[m, 10]))
        red, green, blue = conductor_reflectance(values, m, cosine)
        return red * value, green * value, blue * value, density
    if kind == PLASTIC:
        red, green, blue = _plastic_diffuse(values, m, wi[2], wo[2])
        density = wi[2] / math.pi
        chance = 1.0 - _plastic_mirror_chance(values, m, wo[2])
        return red * density, green * density, blue * density, chance * density
    if kind == TABULATED:
        return tabulated_evaluate(materials.pool, materials.first[m], wi, wo, memory)
    if kind == ANALYTIC:
        return analytic_evaluate(materials.lobes, materials.first[m], materials.n_lobes[m], wi, wo)
    if kind == ANISOTROPIC:
        return anisotropic_evaluate(materials.anisotropic, materials.first[m], wi, wo, memory)
    return 0.0, 0.0, 0.0, 0.0


@kernel(allocates=False)
def sample(materials, m, wo, u0, u1, u2, memory):
    """Draw a direction `wi` to go on in.

    Returns
    -------
    wi : tuple of 3 float
    red, green, blue : float
        BRDF times cos(theta_i) over the density of `wi`; for mirror reflection and refraction the
        reflectance or transmittance over the chance. All zero: the path ends.
    density : float
        In 1/sr, as `evaluate` gives; 0 for mirror reflection and refraction.
    """
    kind = materials.kind[m]
    if kind == DIELECTRIC:
        return _sample_dielectric(materials.values, m, wo, u0)
    if kind == TRANSMITTING:
        return analytic_sample(materials.lobes, materials.first[m], materials.n_lobes[m], wo, u0, u1, u2)
    flip = materials.two_sided[m] and wo[2] < 0.0
    if flip:
        wo = (wo[0], wo[1], -wo[2])
    wi, red, green, blue, density = _sample_upper(materials, m, wo, u0, u1, u2, memory)
    if flip:
        wi = (wi[0], wi[1], -wi[2])
    return wi, red, green, blue, density


@kernel(allocates=False)
def _sample_upper(materials, m, wo, u0, u1, u2, memory):
    kind = materials.kind[m]
    values = materials.values
    mirror = (-wo[0], -wo[1], wo[2])
    if wo[2] <= 0.0 or kind == NONE:
        return mirror, 0.0, 0.0, 0.0, 0.0
    if kind == DIFFUSE:
        wi = cosine_hemisphere(u1, u2)
        return wi, values[m, 0], values[m, 1], values[m, 2], wi[2] / math.pi
    if kind == CONDUCTOR:
        red, green, blue = conductor_reflectance(values, m, wo[2])
        return mirror, red, green, blue, 0.0
    if kind == TABULATED:
        return tabulated_sample(materials.pool, materials.first[m], wo, u0, u1, u2, memory)
    if kind == ANALYTIC:
        return analytic_sample(materials.lobes, materials.first[m], materials.n_lobes[m], wo, u0, u1, u2)
    if kind == ANISOTROPIC:
        return anisotropic_sample(materials.anisotropic, materials.first[m], wo, u0, u1, u2, memory)
    if kind == PLASTIC:
        chance = _plastic_mirror_chance(values, m, wo[2])
        if u0 < chance:
            weight = _dielectric_reflectance(wo[2], values[m, 0]) / chance
            return mirror, weight * values[m, 4], weight * values[m, 5], weight * values[m, 6], 0.0
        wi = cosine_hemisphere(u1, u2)
    else:
        wi = rough_sample(wo, values[m, 9], int(values[m, 10]), u1, u2)
    red, green, blue, density = evaluate(materials, m, wi, wo, memory)
    if density <= 0.0:
        return mirror, 0.0, 0.0, 0.0, 0.0
    return wi, red / density, green / density, blue / density, density


@kernel(allocates=False)
def _sample_dielectric(values, m, wo, u):
    """Reflect or refract with the chance of Fresnel's reflectance; radiance grows with the index squared."""
    cos_o = abs(wo[2])
    eta = values[m, 0] if wo[2] > 0.0 else 1.0 / values[m, 0]
    reflectance = _dielectric_reflectance(cos_o, eta)
    if u < reflectance:
        return (-wo[0], -wo[1], wo[2]), values[m, 1], values[m, 2], values[m, 3], 0.0
    cos_t = math.sqrt(max(0.0, 1.0 - (1.0 - cos_o * cos_o) / (eta * eta)))
    wi = (-wo[0] / eta, -wo[1] / eta, -math.copysign(cos_t, wo[2]))
    scale = 1.0 / (eta * eta)
    return wi, scale * values[m, 4], scale * values[m, 5], scale * values[m, 6], 0.0
