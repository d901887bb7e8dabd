"""The path tracer: light and BRDF sampling combined by the power heuristic (Veach 1997, 9.2.4).

Paths go in packets of 16, one sample each of a block of 4 x 4 pixels. Random numbers are keyed by
(seed, pixel) and counted by (sample, segment, use), and every pixel belongs to one block and takes its
samples in order: a picture has the same bits for any number of threads, and for any way of cutting its
samples into passes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gonio.core.directions import frame
from gonio.core.embree import (
    DIR_X,
    DIR_Y,
    DIR_Z,
    GEOM_ID,
    INST_ID,
    MISS,
    ORG_X,
    ORG_Y,
    ORG_Z,
    PACKET_WIDTH,
    T_FAR,
    VALID,
    intersect16,
    new_packet,
)
from gonio.core.jit import kernel
from gonio.core.philox import uniforms
from renderer.camera import View, camera_ray
from renderer.environment import environment_radiance
from renderer.geometry import Geometry, nearest_quadric, offset, surface, tangents
from renderer.lights import Lights, area_density, sample_light
from renderer.materials import ANISOTROPIC, Materials, evaluate, sample

# The kernels below that take the whole World are inlined where they are called, once each: by value it is
# some 400 words, and copying it doubled the time of a path.

BLOCK = 4
_NO_HIT = np.float32(np.inf)
# What a set of four random numbers is for: the counter's last word.
_FOR_CAMERA, _FOR_LIGHT, _FOR_MATERIAL = 0, 1, 2
# Lane state, columns of a float64 array: throughput, density of the last direction (0: mirror), radiance.
_RED, _GREEN, _BLUE, _DENSITY, _SUM_RED, _SUM_GREEN, _SUM_BLUE = range(7)


class World(NamedTuple):
    """A scene as kernels take it."""

    camera: View
    geometry: Geometry
    materials: Materials
    lights: Lights
    limits: np.ndarray  # int64 (3,): longest path in segments, segment of the first roulette, MIS or not


@kernel(allocates=False)
def _aim(packet, lane, origin, direction, t_far):
    """Make a lane ready for the next call of Embree."""
    ids = packet.view(np.int32)
    packet[ORG_X, lane], packet[ORG_Y, lane], packet[ORG_Z, lane] = origin[0], origin[1], origin[2]
    packet[DIR_X, lane], packet[DIR_Y, lane], packet[DIR_Z, lane] = direction[0], direction[1], direction[2]
    packet[T_FAR, lane] = t_far
    ids[GEOM_ID, lane] = MISS
    ids[INST_ID, lane] = MISS
    ids[VALID, lane] = -1


@kernel(allocates=False)
def _ray(packet, lane):
    """Origin and direction of a lane, as Embree sees them."""
    origin = (
        np.float64(packet[ORG_X, lane]),
        np.float64(packet[ORG_Y, lane]),
        np.float64(packet[ORG_Z, lane]),
    )
    direction = (
        np.float64(packet[DIR_X, lane]),
        np.float64(packet[DIR_Y, lane]),
        np.float64(packet[DIR_Z, lane]),
    )
    return origin, direction


@kernel(allocates=False)
def _trace(geometry, packet, quadrics, coherent):
    """Nearest hits of the packet's valid lanes; `quadrics` gets the sphere or disk Embree was cut off at."""
    ids = packet.view(np.int32)
    if len(geometry.quadric):
        for lane in range(PACKET_WIDTH):
            if ids[VALID, lane]:
                origin, direction = _ray(packet, lane)
                t, quadrics[lane] = nearest_quadric(
                    geometry, origin, direction, np.float64(packet[T_FAR, lane])
                )
                packet[T_FAR, lane] = t
    if len(geometry.first_face):
        intersect16(geometry.handle, packet, coherent)


@kernel(allocates=False)
def _heuristic(density, other, strategy, preferred):
    """Weight of a sample of `density` that the other strategy draws with density `other`; 0 stands for a
    delta, which only one of the two can draw. Strategy 0 combines, 1 trusts materials, 2 trusts lights.
    """
    if strategy == 0 or density == 0.0 or other == 0.0:
        if density == 0.0 or other == 0.0:
            return 1.0
        ratio = other / density
        return 1.0 / (1.0 + ratio * ratio)
    return 1.0 if strategy == preferred else 0.0


@kernel(allocates=False)
def _add(state, lane, first, red, green, blue):
    state[lane, first] += red
    state[lane, first + 1] += green
    state[lane, first + 2] += blue


@kernel(inline=True, allocates=False)
def _arrive(world, packet, lane, state, hit, segment):
    """Add the light that shines from where a lane ended up."""
    lights = world.lights
    origin, direction = _ray(packet, lane)
    shape, _, normal, _, distance = hit
    density = state[lane, _DENSITY]
    strategy = world.limits[2]
    other = 0.0
    if shape < 0:
        red, green, blue, other = environment_radiance(lights.environment, direction)
        other /= max(1, len(lights.kind))
    else:
        light = world.geometry.light[shape]
        cosine = -(direction[0] * normal[0] + direction[1] * normal[1] + direction[2] * normal[2])
        if light < 0 or cosine <= 0.0:
            return
        red, green, blue = lights.colour[light, 0], lights.colour[light, 1], lights.colour[light, 2]
        if segment > 1:
            other = area_density(lights, light, origin, distance * distance, cosine)
    weight = _heuristic(density, other, strategy, 1) if segment > 1 else 1.0
    red, green, blue = red * weight, green * weight, blue * weight
    _add(
        state, lane, _SUM_RED, red * state[lane, _RED], green * state[lane, _GREEN], blue * state[lane, _BLUE]
    )


@kernel(allocates=False)
def _to_local(s, t, n, v):
    return (
        s[0] * v[0] + s[1] * v[1] + s[2] * v[2],
        t[0] * v[0] + t[1] * v[1] + t[2] * v[2],
        n[0] * v[0] + n[1] * v[1] + n[2] * v[2],
    )


@kernel(inline=True, allocates=False)
def _light_up(world, shadows, pending, lane, state, hit, axes, wo, u, memory):
    """Draw a light and, if it would matter, aim the lane's shadow ray at it. Returns whether it was aimed."""
    shape, point, normal, shading, distance = hit
    material = world.geometry.material[shape]
    s, t = axes
    direction, reach, red, green, blue, density = sample_light(world.lights, point, u[0], u[1], u[2], u[3])
    if red + green + blue <= 0.0:
        return False
    f_red, f_green, f_blue, other = evaluate(
        world.materials, material, _to_local(s, t, shading, direction), wo, memory
    )
    weight = _heuristic(density, other, world.limits[2], 2)
    pending[lane, 0] = weight * f_red * red * state[lane, _RED]
    pending[lane, 1] = weight * f_green * green * state[lane, _GREEN]
    pending[lane, 2] = weight * f_blue * blue * state[lane, _BLUE]
    if pending[lane, 0] + pending[lane, 1] + pending[lane, 2] <= 0.0:
        return False
    start = offset(world.geometry, shape, point, normal, direction, distance)
    _aim(shadows, lane, start, direction, np.float32(reach * (1.0 - 1e-4)))
    return True


@kernel(inline=True, allocates=False)
def _go_on(world, packet, lane, state, hit, axes, wo, u, segment, memory):
    """Draw the path's next direction and aim the lane in it. Returns whether the path goes on."""
    shape, point, normal, shading, distance = hit
    s, t = axes
    wi, red, green, blue, density = sample(
        world.materials, world.geometry.material[shape], wo, u[0], u[1], u[2], memory
    )
    red, green, blue = red * state[lane, _RED], green * state[lane, _GREEN], blue * state[lane, _BLUE]
    brightest = max(red, max(green, blue))
    if brightest <= 0.0:
        return False
    if segment >= world.limits[1]:
        chance = min(brightest, 0.95)
        if u[3] >= chance:
            return False
        red, green, blue = red / chance, green / chance, blue / chance
    state[lane, _RED], state[lane, _GREEN], state[lane, _BLUE] = red, green, blue
    state[lane, _DENSITY] = density
    direction = (
        s[0] * wi[0] + t[0] * wi[1] + shading[0] * wi[2],
        s[1] * wi[0] + t[1] * wi[1] + shading[1] * wi[2],
        s[2] * wi[0] + t[2] * wi[1] + shading[2] * wi[2],
    )
    _aim(packet, lane, offset(world.geometry, shape, point, normal, direction, distance), direction, _NO_HIT)
    return True


@kernel(inline=True, allocates=False)
def _shadow(geometry, shadows, quadrics, state, pending):
    """Trace the shadow rays and add the light of those that met nothing."""
    ids = shadows.view(np.int32)
    for lane in range(PACKET_WIDTH):
        quadrics[lane] = -1
    _trace(geometry, shadows, quadrics, True)
    for lane in range(PACKET_WIDTH):
        if ids[VALID, lane] and ids[GEOM_ID, lane] == MISS and quadrics[lane] < 0:
            _add(state, lane, _SUM_RED, pending[lane, 0], pending[lane, 1], pending[lane, 2])
        ids[VALID, lane] = 0


@kernel(inline=True, allocates=False)
def _follow(world, scratch, seed, i_sample):
    """Follow the packet's paths to their ends; returns how many rays that took."""
    packet, shadows, quadrics, pixels, state, pending, memory = scratch
    ids = packet.view(np.int32)
    n_rays = 0
    segment = 1
    n_lights = len(world.lights.kind)
    active = True
    while active:
        for lane in range(PACKET_WIDTH):
            quadrics[lane] = -1
        _trace(world.geometry, packet, quadrics, segment == 1)
        active, shadowed = False, False
        for lane in range(PACKET_WIDTH):
            if not ids[VALID, lane]:
                continue
            n_rays += 1
            hit = surface(world.geometry, packet, lane, quadrics[lane])
            _arrive(world, packet, lane, state, hit, segment)
            ids[VALID, lane] = 0
            shading = hit[3]
            if hit[0] < 0 or segment >= world.limits[0]:
                continue
            _, direction = _ray(packet, lane)
            axes = frame(shading)
            if world.materials.kind[world.geometry.material[hit[0]]] == ANISOTROPIC:
                axes = tangents(world.geometry, packet, lane, hit[0], hit[1], shading)
            wo = _to_local(axes[0], axes[1], shading, (-direction[0], -direction[1], -direction[2]))
            if n_lights:
                u = uniforms(i_sample, segment, _FOR_LIGHT, 0, seed, pixels[lane])
                if _light_up(world, shadows, pending, lane, state, hit, axes, wo, u, memory):
                    shadowed = True
                    n_rays += 1
            u = uniforms(i_sample, segment, _FOR_MATERIAL, 0, seed, pixels[lane])
            if _go_on(world, packet, lane, state, hit, axes, wo, u, segment, memory):
                active = True
        if shadowed:
            _shadow(world.geometry, shadows, quadrics, state, pending)
        segment += 1
    return n_rays


class Scratch(NamedTuple):
    """Working memory of one thread."""

    packet: np.ndarray
    shadows: np.ndarray
    quadrics: np.ndarray  # int64 (16,), the sphere or disk each lane was cut off at
    pixels: np.ndarray  # int64 (16,)
    state: np.ndarray  # (16, 7)
    pending: np.ndarray  # (16, 3), light that arrives if the lane's shadow ray meets nothing
    memory: np.ndarray  # (6,), the materials'


def new_scratch() -> Scratch:
    """Working memory for `render_blocks`; one a call."""
    lanes = PACKET_WIDTH
    integers = np.zeros((2, lanes), np.int64)
    return Scratch(
        new_packet(),
        new_packet(),
        integers[0],
        integers[1],
        np.zeros((lanes, 7)),
        np.zeros((lanes, 3)),
        np.zeros(6),
    )


@kernel(allocates=False)
def render_blocks(world, film, scratch, first, last, first_sample, last_sample, seed):
    """Add samples [first_sample, last_sample) of every pixel in blocks [first, last) to the film.

    Parameters
    ----------
    world : World
    film : tuple of 2 ndarray, shape (height, width, 3)
        Sum of the samples' radiance and of its square.
    scratch : Scratch
    first, last : int
        Blocks of 4 x 4 pixels, counted row by row.

    Returns
    -------
    tuple of 2 int
        Rays traced, and samples dropped because they were not finite.
    """
    packet, pixels, state = scratch.packet, scratch.pixels, scratch.state
    sums, squares = film
    ids = packet.view(np.int32)
    width, height = world.camera.size[0], world.camera.size[1]
    columns = (width + BLOCK - 1) // BLOCK
    n_rays, n_dropped = 0, 0
    for block in range(first, last):
        x0, y0 = block % columns * BLOCK, block // columns * BLOCK
        for i_sample in range(first_sample, last_sample):
            for lane in range(PACKET_WIDTH):
                x, y = x0 + lane % BLOCK, y0 + lane // BLOCK
                pixels[lane] = y * width + x
                state[lane, :] = 0.0
                if x >= width or y >= height:
                    ids[VALID, lane] = 0
                    continue
                u = uniforms(i_sample, 0, _FOR_CAMERA, 0, seed, pixels[lane])
                origin, direction = camera_ray(world.camera, x, y, u)
                _aim(packet, lane, origin, direction, _NO_HIT)
                state[lane, _RED], state[lane, _GREEN], state[lane, _BLUE] = 1.0, 1.0, 1.0
            n_rays += _follow(world, scratch, seed, i_sample)
            for lane in range(PACKET_WIDTH):
                x, y = x0 + lane % BLOCK, y0 + lane // BLOCK
                if x >= width or y >= height:
                    continue
                if not math.isfinite(
                    state[lane, _SUM_RED] + state[lane, _SUM_GREEN] + state[lane, _SUM_BLUE]
                ):
                    n_dropped += 1
                    continue
                for c in range(3):
                    value = state[lane, _SUM_RED + c]
                    sums[y, x, c] += value
                    squares[y, x, c] += value * value
    return n_rays, n_dropped
