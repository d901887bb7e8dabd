"""Anisotropic tables as materials; as `renderer.tabulated`, whose reasons hold here too."""

from __future__ import annotations

import math

from gonio.core.directions import cosine_hemisphere
from gonio.core.jit import kernel
from gonio.table.anisotropic_interpolation import (
    eval_anisotropic,
    pdf_anisotropic,
    row_quantities_anisotropic,
    sample_anisotropic,
)
from gonio.table.anisotropic_pool import A_CHANNELS
from renderer.tabulated import DEFENSIVE


@kernel(allocates=False)
def _mirror_chance(pool, t, wo, values, specular):
    """Chance to follow the delta term; leaves that term in `specular`."""
    n = pool.header[t, A_CHANNELS]
    row_quantities_anisotropic(pool, t, wo, values, specular)
    rest = 0.0
    mirror = 0.0
    for channel in range(n):
        rest += values[channel]
        mirror += specular[channel]
    return mirror / (mirror + rest) if mirror > 0.0 else 0.0


@kernel(allocates=False)
def _colour(pool, t, values, scale):
    if pool.header[t, A_CHANNELS] == 1:
        return scale * values[0], scale * values[0], scale * values[0]
    return scale * values[0], scale * values[1], scale * values[2]


@kernel(allocates=False)
def anisotropic_evaluate(pool, t, wi, wo, memory):
    """As `renderer.materials.evaluate`, directions above the horizon; `memory` is working memory (6,)."""
    mirror = _mirror_chance(pool, t, wo, memory[:3], memory[3:])
    drawn = pdf_anisotropic(pool, t, wo, wi)
    density = (1.0 - mirror) * ((1.0 - DEFENSIVE) * drawn + DEFENSIVE * wi[2] / math.pi)
    eval_anisotropic(pool, t, wi, wo, memory)
    red, green, blue = _colour(pool, t, memory, wi[2])
    return red, green, blue, density


@kernel(allocates=False)
def anisotropic_sample(pool, t, wo, u0, u1, u2, memory):
    """As `renderer.materials.sample`, `wo` above the horizon."""
    chance = _mirror_chance(pool, t, wo, memory[:3], memory[3:])
    if u0 < chance:
        red, green, blue = _colour(pool, t, memory[3:], 1.0 / chance)
        return (-wo[0], -wo[1], wo[2]), red, green, blue, 0.0
    u0 = (u0 - chance) / (1.0 - chance)
    if u0 < DEFENSIVE:
        wi = cosine_hemisphere(u1, u2)
    else:
        wi, density = sample_anisotropic(pool, t, wo, u1, u2, (u0 - DEFENSIVE) / (1.0 - DEFENSIVE))
        if density <= 0.0:
            return wi, 0.0, 0.0, 0.0, 0.0
    red, green, blue, density = anisotropic_evaluate(pool, t, wi, wo, memory)
    if density <= 0.0:
        return wi, 0.0, 0.0, 0.0, 0.0
    return wi, red / density, green / density, blue / density, density
