"""Flight and scattering of light in a homogeneous medium."""

from __future__ import annotations

import math

from gonio.core.directions import combine, frame, unit
from gonio.core.jit import kernel
from gonio.core.phase import RAYLEIGH, phase_sample, rayleigh_polarisation
from gonio.core.philox import uniforms
from gonio.core.stokes import mueller, perpendicular, rotation
from gonio.trace.interface import scale, turn
from gonio.trace.stack import ABSORBS, CURVE_COUNT, CURVE_FIRST, PHASE_KIND, SCATTERS


@kernel(allocates=False)
def fly(media, medium, share, light, limit, path, event, seed, batch):
    """Free flight of at most `limit` metres: how far, and whether it ends in a collision with the medium.

    Absorption takes its part along the way. Collisions are drawn for one sample, taken by energy, and
    weigh for the others by the balance heuristic (spectral MIS: Wilkie et al. 2014, section 3).
    """
    if media.phase[medium, SCATTERS] == 0:
        if media.phase[medium, ABSORBS] == 1:
            for s in range(light.shape[0]):
                scale(light[s], _transmittance(media.sigma_a[medium, s], limit))
        return limit, False
    u0, u1, _, _ = uniforms(path, path >> 32, event, 0, seed, batch)
    total = 0.0
    for s in range(light.shape[0]):
        total += share[s] * light[s, 0]
    chosen = 0
    below = 0.0
    for s in range(light.shape[0]):
        if light[s, 0] > 0.0 and below <= u0 * total:
            chosen = s
        below += share[s] * light[s, 0]
    sigma = media.sigma_s[medium, chosen]
    distance = -math.log(u1) / sigma if sigma > 0.0 else math.inf
    collided = distance < limit
    if not collided:
        distance = limit
    density = 0.0
    for s in range(light.shape[0]):
        sigma = media.sigma_s[medium, s]
        density += (
            share[s] * light[s, 0] / total * _transmittance(sigma, distance) * (sigma if collided else 1.0)
        )
    for s in range(light.shape[0]):
        sigma = media.sigma_s[medium, s]
        factor = _transmittance(sigma, distance) * (sigma if collided else 1.0) / density
        scale(light[s], factor * _transmittance(media.sigma_a[medium, s], distance))
    return distance, collided


@kernel(allocates=False)
def _transmittance(sigma, distance):
    """exp(-sigma distance), 1 for nothing over infinity."""
    return math.exp(-sigma * distance) if sigma > 0.0 else 1.0


@kernel(allocates=False)
def scatter(media, medium, polarised, v, e, light, path, event, seed, batch):
    """New direction and axis after a collision. Rayleigh's law polarises, all others depolarise."""
    u0, u1, _, _ = uniforms(path, path >> 32, event, 1, seed, batch)
    kind = media.phase[medium, PHASE_KIND]
    first = media.phase[medium, CURVE_FIRST]
    last = first + media.phase[medium, CURVE_COUNT]
    curve = media.curve[:, first:last]
    c = phase_sample(kind, media.g[medium], curve[0], curve[1], curve[2], u0)
    radius = math.sqrt(max(0.0, 1.0 - c * c))
    a, b = radius * math.cos(2.0 * math.pi * u1), radius * math.sin(2.0 * math.pi * u1)
    s, t = frame(v)
    w = unit(combine(a, s, b, t, c, v))
    across = perpendicular(v, w)
    if kind != RAYLEIGH or not polarised:
        light[:, 1:] = 0.0
        return w, across
    turn(light, rotation(e, v, across))
    a_s2, a_p2, cross = rayleigh_polarisation(c)
    for i in range(light.shape[0]):
        light[i, 0], light[i, 1], light[i, 2], light[i, 3] = mueller(
            light[i, 0], light[i, 1], light[i, 2], light[i, 3], a_s2, a_p2, cross
        )
    return w, across
