"""Tables as materials.

A table is drawn from for light that comes from the camera's side, `sample_table(wo) -> wi`, and evaluated
with light and detector where they are. For a reciprocal table that is the same density; for a noisy one a
cell may be empty one way and not the other, so a twentieth of all samples is Lambert's: no direction the
table reflects to is out of reach, and no weight exceeds 20 pi f_r (Hesterberg 1995, defensive mixture).
"""

from __future__ import annotations

import math

from gonio.core.directions import cosine_hemisphere
from gonio.core.jit import kernel
from gonio.table.interpolation import eval_table, pdf_table, sample_table
from gonio.table.pool import N_CHANNELS
from gonio.table.row_quantities import albedo_table, specular_table

DEFENSIVE = 0.05
"""Share of samples that are Lambert's."""


@kernel(allocates=False)
def _mean(pool, t, values):
    if pool.header[t, N_CHANNELS] == 1:
        return values[0]
    return (values[0] + values[1] + values[2]) / 3.0


@kernel(allocates=False)
def mirror_chance(pool, t, cosine, values):
    """Chance to follow the delta term; leaves that term in `values`."""
    albedo_table(pool, t, cosine, values)
    rest = _mean(pool, t, values)
    specular_table(pool, t, cosine, values)
    mirror = _mean(pool, t, values)
    if mirror <= 0.0:
        return 0.0
    return mirror / (mirror + rest)


@kernel(allocates=False)
def _density(pool, t, wi, wo, mirror):
    table = pdf_table(pool, t, wo, wi)
    return (1.0 - mirror) * ((1.0 - DEFENSIVE) * table + DEFENSIVE * wi[2] / math.pi)


@kernel(allocates=False)
def tabulated_evaluate(pool, t, wi, wo, values):
    """As `renderer.materials.evaluate`, directions above the horizon; `values` is working memory (3,)."""
    density = _density(pool, t, wi, wo, mirror_chance(pool, t, wo[2], values))
    eval_table(pool, t, wi, wo, values)
    red = values[0] * wi[2]
    if pool.header[t, N_CHANNELS] == 1:
        return red, red, red, density
    return red, values[1] * wi[2], values[2] * wi[2], density


@kernel(allocates=False)
def tabulated_sample(pool, t, wo, u0, u1, u2, values):
    """As `renderer.materials.sample`, `wo` above the horizon."""
    chance = mirror_chance(pool, t, wo[2], values)
    if u0 < chance:
        red = values[0] / chance
        mirror = (-wo[0], -wo[1], wo[2])
        if pool.header[t, N_CHANNELS] == 1:
            return mirror, red, red, red, 0.0
        return mirror, red, values[1] / chance, values[2] / chance, 0.0
    u0 = (u0 - chance) / (1.0 - chance)
    if u0 < DEFENSIVE:
        wi = cosine_hemisphere(u1, u2)
    else:
        wi, density = sample_table(pool, t, wo, u1, u2, (u0 - DEFENSIVE) / (1.0 - DEFENSIVE))
        if density <= 0.0:
            return wi, 0.0, 0.0, 0.0, 0.0
    red, green, blue, density = tabulated_evaluate(pool, t, wi, wo, values)
    if density <= 0.0:
        return wi, 0.0, 0.0, 0.0, 0.0
    return wi, red / density, green / density, blue / density, density
