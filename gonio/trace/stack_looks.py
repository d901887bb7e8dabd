"""Next-event estimates in a stack of layers: light is joined to detectors above wherever a path scatters.

At a Lambertian or tabulated facet and at a collision in a medium, the light that would go towards a detector is
known: it is counted in the detector's cell, less what Fresnel's laws, the media and the facets on the way keep.
Smooth interfaces parallel to the macroscopic plane bend it (Snell): a detector's projected solid angle is
n^2 times as small inside, n^2 cos dw = cos_o dw_o. Light takes part as the Stokes vector it is.

Where it has gone that way a path is *joined*, and counted no more when it leaves. Mirrors, and interfaces that are
rough or reflect, are met by chance: what comes from these is binned as the analog estimator does. So every path is
counted once.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import dot, frame
from gonio.core.embree import (
    DIR_X,
    DIR_Y,
    DIR_Z,
    ORG_X,
    ORG_Y,
    ORG_Z,
    T_FAR,
    T_NEAR,
    Handle,
    occluded1,
)  # fmt: skip
from gonio.core.jit import kernel
from gonio.core.lookup import Axis
from gonio.core.optics import refract
from gonio.core.phase import RAYLEIGH, phase_value, rayleigh_polarisation
from gonio.core.stokes import mueller, perpendicular, rotation
from gonio.table.interpolation import eval_table
from gonio.trace.interface import T_S, apply_amplitudes, scale, split, turn
from gonio.trace.stack import (
    ABSORBS,
    BOTTOM,
    CLEAR,
    CURVE_COUNT,
    CURVE_FIRST,
    LAMBERT,
    LIFT,
    NONE,
    PHASE_KIND,
    PLANE,
    SCATTERS,
    TABLE,
    TOP,
    UNIT,
    WIDTH_X,
    WIDTH_Y,
    Facets,
    Zones,
)

LOOKS = 16
"""Detectors looked at from a facet that scatters."""
_FACET_LOOKS = 4  # for each one from a collision

_DOWN = (0.0, 0.0, -1.0)
_SIDEWAYS = (1.0, 0.0, 0.0)
# Roberts 2018, "The unreasonable effectiveness of quasirandom sequences": powers of the plastic number's inverse
_STEP_RING, _STEP_AZIMUTH = 0.7548776662466927, 0.5698402909980532

# Eye.state
AZIMUTH_X, AZIMUTH_Y, NUMBER, SHIFT_RING, SHIFT_AZIMUTH, STATES = range(6)


class Eye(NamedTuple):
    """Detectors, and where their light is summed."""

    looks: int
    """Detectors looked at from a facet; from a collision so many / `_FACET_LOOKS`."""
    clear: int
    """As from `clear_zones`."""
    theta: Axis
    """Edges of sin^2 theta_r."""
    sectors: int
    """Cells along delta phi."""
    orders: int
    cells: NDArray[np.float64]
    """As in `gonio.trace.binning.Sums`."""
    state: NDArray[np.float64]
    """(STATES,): cosine and sine of the light's azimuth, the number of the next look, the sequence's random shift."""
    light: NDArray[np.float64]
    """(S, 4): work space."""


def clear_zones(zones: Zones, facets: Facets) -> int:
    """Number of zones, from the top, that light leaves upwards in a known way: planes, and facets that are opaque."""
    for zone, scene in enumerate(zones.scene):
        layers = facets.material[zones.first_layer[zone] : zones.first_layer[zone + 1]]
        if scene != PLANE and np.isin(facets.kind[layers], (NONE, CLEAR)).any():
            return zone
    return len(zones.scene)


@kernel(allocates=False)
def join_facet(
    zones, facets, tables, media, share, polarised, to_channels, eye, zone, layer, material, medium, v, n, light, x, y,
    z, corner_x, corner_y, bounces, ray, scratch,
):  # fmt: skip
    """Join what a facet scatters to detectors, if it scatters; before `interact` changes the light.

    Parameters as in `gonio.trace.layered.trace_path`; `x`, `y`, `z` is the place of the hit in the zone's tile.

    Returns
    -------
    joined : bool
        Whether it does, and detectors may see it.
    rays : int
        Of Embree.
    """
    kind = facets.kind[material]
    if zone >= eye.clear or (kind != LAMBERT and kind != TABLE):
        return False, 0
    rays = 0
    plane = zones.scene[zone] == PLANE
    if not plane:
        step = zones.box[zone, LIFT]
        x, y, z = x + step * n[0], y + step * n[1], z + step * n[2]
    for _ in range(eye.looks):
        ring, sector, w, worth = _detector(eye, media, medium, light)
        cosine = dot(w, n)
        if cosine <= 0.0:
            continue
        seen = eye.light
        if kind == LAMBERT:
            for s in range(light.shape[0]):
                seen[s, 0] = light[s, 0] * facets.albedo[material, s] * cosine / math.pi
        elif tables is not None:
            s_axis, t_axis = frame(n)
            wi = (-dot(v, s_axis), -dot(v, t_axis), -dot(v, n))
            wo = (dot(w, s_axis), dot(w, t_axis), cosine)
            f = scratch[0]
            eval_table(tables, facets.table[material], wi, wo, f)
            for s in range(light.shape[0]):
                seen[s, 0] = light[s, 0] * f[s] * cosine
        seen[:, 1:] = 0.0
        rays += _leave(
            zones, facets, media, share, polarised, w, perpendicular(w, n), zone, plane, x, y, z,
            zones.gap[zone], corner_x, corner_y, medium, seen, ray, scratch,
        )  # fmt: skip
        _deposit(eye, to_channels, ring, sector, bounces, worth / eye.looks)
    return True, rays


@kernel(allocates=False)
def join_collision(
    zones, facets, media, share, polarised, to_channels, eye, zone, in_gap, medium, v, e, light, x, y, z, depth,
    corner_x, corner_y, bounces, ray, scratch,
):  # fmt: skip
    """Join what a collision scatters to a detector; as `join_facet`, before `scatter` changes the light."""
    if zone >= eye.clear + in_gap:
        return False, 0
    kind = media.phase[medium, PHASE_KIND]
    first = media.phase[medium, CURVE_FIRST]
    last = first + media.phase[medium, CURVE_COUNT]
    curve = media.curve[:, first:last]
    looks = max(1, eye.looks // _FACET_LOOKS)
    rays = 0
    for _ in range(looks):
        ring, sector, w, worth = _detector(eye, media, medium, light)
        if w[2] <= 0.0:
            continue
        c = dot(v, w)
        p = phase_value(kind, media.g[medium], curve[0], curve[1], c)
        across = perpendicular(v, w)
        seen = eye.light
        for s in range(light.shape[0]):
            for i in range(4):
                seen[s, i] = light[s, i]
        if kind == RAYLEIGH and polarised:
            turn(seen, rotation(e, v, across))
            a_s2, a_p2, cross = rayleigh_polarisation(c)
            for s in range(seen.shape[0]):
                seen[s, 0], seen[s, 1], seen[s, 2], seen[s, 3] = mueller(
                    seen[s, 0], seen[s, 1], seen[s, 2], seen[s, 3], a_s2, a_p2, cross
                )
        else:
            seen[:, 1:] = 0.0
        for s in range(seen.shape[0]):
            scale(seen[s], p)
        rays += _leave(
            zones, facets, media, share, polarised, w, across, zone, in_gap, x, y, z, depth, corner_x, corner_y,
            medium, seen, ray, scratch,
        )  # fmt: skip
        _deposit(eye, to_channels, ring, sector, bounces, worth / looks)
    return True, rays


@kernel(allocates=False)
def _detector(eye, media, medium, light):
    """The next detector: ring and sector of its cell, the direction to it inside, and the worth of a look.

    All cells are looked at equally often. The direction's z is 0 where no light of this medium goes there.
    """
    state = eye.state
    number = state[NUMBER]
    state[NUMBER] += 1.0
    u = (state[SHIFT_RING] + number * _STEP_RING) % 1.0
    t = (state[SHIFT_AZIMUTH] + number * _STEP_AZIMUTH) % 1.0
    edges = eye.theta.edges
    rings = edges.shape[0] - 1
    ring = min(int(u * rings), rings - 1)
    width = edges[ring + 1] - edges[ring]
    sin2 = edges[ring] + (u * rings - ring) * width
    turned = abs(2.0 * t - 1.0)
    sector = min(int(turned * eye.sectors), eye.sectors - 1)
    phi = math.pi * (2.0 * t - 1.0)
    # all samples that carry light have one index here: at an interface where they part, one is left
    eta = 1.0
    for s in range(light.shape[0]):
        if light[s, 0] > 0.0:
            eta = media.eta[medium, s]
    cos2 = 1.0 - sin2 / (eta * eta)
    if cos2 <= 0.0:
        return ring, sector, _SIDEWAYS, 0.0
    sine, cosine = math.sqrt(sin2) / eta, math.sqrt(cos2)
    c, s_ = math.cos(phi), math.sin(phi)
    x, y = state[AZIMUTH_X], state[AZIMUTH_Y]
    w = (sine * (c * x - s_ * y), sine * (c * y + s_ * x), cosine)
    # 1 / density: projected solid angle of all detectors of a ring, times the rings
    return ring, sector, w, math.pi * width * rings / (eta * eta * cosine)


@kernel(allocates=False)
def _leave(
    zones, facets, media, share, polarised, w, e, zone, in_gap, x, y, z, depth, corner_x, corner_y, medium, light,
    ray, scratch,
):  # fmt: skip
    """Take light along `w` out above, through all that lies on the way; returns the rays cast."""
    rays = 0
    if not in_gap:  # from here on, the corner is where the light is
        corner_x += x * zones.box[zone, UNIT]
        corner_y += y * zones.box[zone, UNIT]
    while True:
        if in_gap:
            if zone == 0:
                return rays
            _pass_medium(media, medium, depth / w[2], light)
            corner_x += depth / w[2] * w[0]
            corner_y += depth / w[2] * w[1]
            zone -= 1
            if zones.scene[zone] == PLANE:
                layer = zones.first_layer[zone]
                material = facets.material[layer, 0]
                kind = facets.kind[material]
                if kind != NONE:
                    if kind != CLEAR:
                        light[:, 0] = 0.0
                        return rays
                    across = perpendicular(w, _DOWN)
                    if polarised:
                        turn(light, rotation(e, w, across))
                    split(facets, media, share, layer, material, False, w, _DOWN, light, scratch)
                    ratio = 0.0
                    for s in range(light.shape[0]):
                        if light[s, 0] > 0.0:
                            ratio = media.eta[layer, s] / media.eta[layer + 1, s]
                    apply_amplitudes(light, scratch, T_S, 1.0, polarised)
                    if ratio == 0.0:
                        return rays
                    w, cos_t = refract(w, _DOWN, ratio)
                    e = across
                    if cos_t == 0.0:
                        light[:, 0] = 0.0
                        return rays
                medium = layer
                depth = zones.gap[zone]
                continue
            z = zones.box[zone, BOTTOM]
            x, y = _place(zones.box[zone], corner_x, corner_y)
            in_gap = False
        box = zones.box[zone]
        to_top = (box[TOP] - z) / w[2]
        if medium != zones.first_layer[zone]:
            light[:, 0] = 0.0
            return rays
        _pass_medium(media, medium, to_top * box[UNIT], light)
        corner_x += to_top * w[0] * box[UNIT]
        corner_y += to_top * w[1] * box[UNIT]
        while to_top > 0.0:
            h = zones.embree
            ray[ORG_X], ray[ORG_Y], ray[ORG_Z] = x, y, z
            ray[DIR_X], ray[DIR_Y], ray[DIR_Z] = w
            ray[T_NEAR] = 0.0
            ray[T_FAR] = np.inf
            rays += 1
            handle = Handle(
                h.intersect1,
                h.intersect16,
                h.occluded1,
                h.occluded16,
                zones.scene[zone],
                h.coherent,
                h.incoherent,
            )
            if occluded1(handle, ray):
                light[:, 0] = 0.0
                return rays
            to_x = math.inf
            if w[0] != 0.0:
                to_x = ((box[WIDTH_X] if w[0] > 0.0 else 0.0) - x) / w[0]
            to_y = math.inf
            if w[1] != 0.0:
                to_y = ((box[WIDTH_Y] if w[1] > 0.0 else 0.0) - y) / w[1]
            distance = max(0.0, min(to_x, to_y))
            if distance >= to_top:
                break
            to_top -= distance
            x += distance * w[0]
            y += distance * w[1]
            z += distance * w[2]
            if to_x <= to_y:
                x = 0.0 if w[0] > 0.0 else box[WIDTH_X]
            else:
                y = 0.0 if w[1] > 0.0 else box[WIDTH_Y]
        in_gap = True
        depth = zones.gap[zone]


@kernel(allocates=False)
def _place(box, x, y):
    """From metres to a place in the zone's tile."""
    width_x, width_y = box[WIDTH_X] * box[UNIT], box[WIDTH_Y] * box[UNIT]
    in_x = min((x - math.floor(x / width_x) * width_x) / box[UNIT], box[WIDTH_X])
    in_y = min((y - math.floor(y / width_y) * width_y) / box[UNIT], box[WIDTH_Y])
    return in_x, in_y


@kernel(allocates=False)
def _pass_medium(media, medium, distance, light):
    """What a medium lets through unscattered."""
    if media.phase[medium, SCATTERS] == 0 and media.phase[medium, ABSORBS] == 0:
        return
    for s in range(light.shape[0]):
        scale(light[s], math.exp(-(media.sigma_a[medium, s] + media.sigma_s[medium, s]) * distance))


@kernel(allocates=False)
def _deposit(eye, to_channels, ring, sector, bounces, worth):
    """Count light in a detector's cell, as one path."""
    sheet = min(bounces, eye.orders) - 1
    cell = ring * eye.sectors + sector
    seen = eye.light
    channels = eye.cells.shape[2] - 1
    any_light = False
    for s in range(seen.shape[0]):
        any_light = any_light or seen[s, 0] > 0.0
    if not any_light:
        return
    for channel in range(channels):
        total = 0.0
        if to_channels is None:
            total = seen[channel, 0]
        else:
            for s in range(seen.shape[0]):
                total += to_channels[channel, s] * seen[s, 0]
        eye.cells[sheet, cell, channel] += worth * total
    eye.cells[sheet, cell, channels] += 1.0
