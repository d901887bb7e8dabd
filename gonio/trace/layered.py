"""Transport of light through a stack of layers: one path at a time, from the plane above until it ends.

Everything a specimen can be made of: rough interfaces that reflect and refract, films, media that absorb and
scatter, tables as facets. A single opaque surface of one material has a faster way, `gonio.trace.transport`.
Where zones, gaps and media are is said in `gonio.trace.stack`.

A path knows which medium it is in. A hit from the other side of an interface than that medium's is a
rounding error at a crease, and passed through; a path that leaves a zone in the wrong medium is lost.
"""

from __future__ import annotations

import math

import numpy as np

from gonio.core.directions import dot, unit
from gonio.core.embree import (
    DIR_X,
    DIR_Y,
    DIR_Z,
    GEOM_ID,
    INST_ID,
    INST_PRIM_ID,
    MISS,
    NORMAL_X,
    NORMAL_Y,
    NORMAL_Z,
    ORG_X,
    ORG_Y,
    ORG_Z,
    PRIM_ID,
    T_FAR,
    T_NEAR,
    Handle,
    intersect1,
)  # fmt: skip
from gonio.core.jit import kernel
from gonio.core.philox import uniforms
from gonio.core.stokes import perpendicular
from gonio.trace.interface import interact, scale
from gonio.trace.stack import (
    BOTTOM,
    LIFT,
    NONE,
    PLANE,
    TOP,
    UNIT,
    WIDTH_X,
    WIDTH_Y,
)
from gonio.trace.stack_looks import join_collision, join_facet
from gonio.trace.transport import (
    ABSORBED,
    INSIDE,
    KILLED,
    LOST,
    MAX_SEGMENTS,
    REFLECTED,
    RETREAT,
    ROULETTE_BOUNCES,
    TRANSMITTED,
)
from gonio.trace.volume import fly, scatter

_UP = (0.0, 0.0, 1.0)
_DOWN = (0.0, 0.0, -1.0)
_NOTHING = 1e-9  # a share of energy that rounding may take


@kernel(allocates=False)
def trace_path(
    zones, facets, tables, media, share, polarised, to_channels, eye, v, x, y, max_bounces, seed, batch, path, ray,
    light, scratch, absorbed,
):  # fmt: skip
    """Follow one path to its end.

    Parameters
    ----------
    zones : Zones
    facets : Facets
    tables : Pool or None
    media : Media
    share : ndarray, shape (S,)
    polarised : bool
        As in `gonio.trace.stack.Stack`.
    to_channels : ndarray or None
        As in `gonio.trace.analog.trace_surface`.
    eye : Eye or None
        Detectors to join light to wherever it scatters.
    v : direction
        Where the light goes: down.
    x, y : float
        Where it meets the top of zone 0, metres from the tile's corner.
    max_bounces : int
        A path that would bounce (at a facet or in a medium) once more is killed.
    seed, batch, path : int
        Key and counter of the random numbers.
    ray : ndarray
        From `gonio.core.embree.new_ray`.
    light : ndarray, shape (S, 4)
        Set to the Stokes vectors that are left of unit intensity at the path's end.
    scratch : ndarray, shape (SCRATCH_ROWS, S)
    absorbed : ndarray, shape (2 L,)
        Energy absorbed is added: at layer l in 2 l, in the medium below it in 2 l + 1. What the path's chances
        (reflected or refracted, roulette) take and give is booked there too, so that the sum over all
        ends of a path is exactly 1.

    Returns
    -------
    status : int
    v : direction
        Where it left.
    bounces : int
    straight : bool
        Whether it met nothing but smooth interfaces parallel to the macroscopic plane: the delta term.
    joined : bool
        Whether its light, if it left above, was joined to detectors.
    rays : int
        Of Embree.
    """
    light[:, :] = 0.0
    light[:, 0] = 1.0
    n_zones = zones.scene.shape[0]
    zone = 0
    medium = 0
    in_gap = False
    z = zones.box[0, TOP]
    depth = 0.0  # in the gap, metres below its top
    # where the tile's corner is, metres; in the gap, where the path is
    corner_x, corner_y = x, y
    x, y, corner_x, corner_y = _locate(zones.box[0], corner_x, corner_y)
    e = perpendicular(v, _UP)
    bounces = 0
    straight = True
    joined = False
    rays = 0
    # a place just before the last reflection, for a path that the step off a facet put inside the body
    can_retreat = False
    retreat = (0.0, 0.0, 0.0)
    for event in range(1, MAX_SEGMENTS):
        energy = _energy(light, share)
        if _strongest(light) == 0.0:
            return ABSORBED, v, bounces, straight, joined, rays
        if in_gap:
            gap = zones.gap[zone]  # above `zone`
            limit = math.inf
            if v[2] < 0.0:
                limit = (gap - depth) / -v[2]
            elif v[2] > 0.0:
                limit = depth / v[2]
            distance, collided = fly(media, medium, share, light, limit, path, event, seed, batch)
            if medium > 0:
                absorbed[2 * medium - 1] += _lose(light, share, energy, bounces, path, event, 4, seed, batch)
            if not collided and limit == math.inf:
                if zone < n_zones or v[2] >= 0.0:
                    return LOST, v, bounces, straight, joined, rays
                return (
                    (TRANSMITTED if _strongest(light) > 0.0 else ABSORBED),
                    v,
                    bounces,
                    straight,
                    joined,
                    rays,
                )
            corner_x += distance * v[0]
            corner_y += distance * v[1]
            depth -= distance * v[2]
            if not collided:
                in_gap = False
                can_retreat = False
                if v[2] < 0.0:
                    z = zones.box[zone, TOP]
                else:
                    zone -= 1
                    z = zones.box[zone, BOTTOM]
                x, y, corner_x, corner_y = _locate(zones.box[zone], corner_x, corner_y)
                continue
        elif zones.scene[zone] == PLANE:
            layer = zones.first_layer[zone]
            front = v[2] < 0.0
            material = facets.material[layer, 0]
            crossed = True
            if facets.kind[material] != NONE:
                if bounces >= max_bounces:
                    return KILLED, v, bounces, straight, joined, rays
                bounces += 1
                if eye is not None:
                    here, looks = join_facet(
                        zones, facets, tables, media, share, polarised, to_channels, eye, zone, layer, material,
                        medium, v, _UP if front else _DOWN, light, x, y, z, corner_x, corner_y, bounces, ray, scratch,
                    )  # fmt: skip
                    rays += looks
                    joined = joined or here
                v, e, crossed, specular = interact(
                    facets, tables, media, share, polarised, layer, material, front, v, _UP if front else _DOWN,
                    e, light, scratch, path, event, seed, batch,
                )  # fmt: skip
                straight = straight and specular
                joined = joined and (crossed or not specular)
                absorbed[2 * layer] += _lose(light, share, energy, bounces, path, event, 2, seed, batch)
            if crossed:
                medium = layer + 1 if front else layer
            in_gap = True
            if front == crossed:  # it goes on down
                zone += 1
                depth = 0.0
            elif zone == 0:
                return _left(light), v, bounces, straight, joined, rays
            else:
                depth = zones.gap[zone]
            continue
        else:
            box = zones.box[zone]
            metres = box[UNIT]
            ids = ray.view(np.int32)
            ray[ORG_X], ray[ORG_Y], ray[ORG_Z] = x, y, z
            ray[DIR_X], ray[DIR_Y], ray[DIR_Z] = v
            ray[T_NEAR] = 0.0
            ray[T_FAR] = np.inf
            ids[GEOM_ID] = MISS
            ids[INST_ID] = MISS
            ids[INST_PRIM_ID] = MISS
            h = zones.embree
            intersect1(
                Handle(
                    h.intersect1,
                    h.intersect16,
                    h.occluded1,
                    h.occluded16,
                    zones.scene[zone],
                    h.coherent,
                    h.incoherent,
                ),
                ray,
            )
            rays += 1
            hit = ids[GEOM_ID] != MISS
            face = 0
            if hit:
                limit = float(ray[T_FAR])
            else:
                limit, face = _to_face(box, x, y, z, v)
            distance, collided = fly(media, medium, share, light, limit * metres, path, event, seed, batch)
            distance /= metres
            if medium > 0:
                absorbed[2 * medium - 1] += _lose(light, share, energy, bounces, path, event, 4, seed, batch)
                energy = _energy(light, share)
            x += distance * v[0]
            y += distance * v[1]
            z += distance * v[2]
            if not collided and not hit:
                if face == 1:  # exactly onto the opposite face
                    corner_x += math.copysign(box[WIDTH_X] * metres, v[0])
                    x = 0.0 if v[0] > 0.0 else box[WIDTH_X]
                elif face == 2:
                    corner_y += math.copysign(box[WIDTH_Y] * metres, v[1])
                    y = 0.0 if v[1] > 0.0 else box[WIDTH_Y]
                else:
                    up = v[2] > 0.0
                    if not up:
                        zone += 1
                    if face != 3 or medium != zones.first_layer[zone]:
                        if not can_retreat:
                            return LOST, v, bounces, straight, joined, rays
                        can_retreat = False
                        x, y, z = retreat
                        zone -= 0 if up else 1
                        continue
                    if zone == 0:
                        return _left(light), v, bounces, straight, joined, rays
                    in_gap = True
                    depth = zones.gap[zone] if up else 0.0
                    corner_x += x * metres
                    corner_y += y * metres
                continue
            if not collided:
                layer = zones.first_layer[zone] + ids[GEOM_ID]
                n = unit((float(ray[NORMAL_X]), float(ray[NORMAL_Y]), float(ray[NORMAL_Z])))
                front = dot(v, n) < 0.0
                if not front:
                    n = (-n[0], -n[1], -n[2])
                crossed = True
                if medium != (layer if front else layer + 1):
                    if can_retreat and distance > INSIDE * box[LIFT]:
                        can_retreat = False
                        x, y, z = retreat
                        continue
                else:
                    label = 0
                    if facets.label_first[layer] >= 0:
                        label = facets.labels[facets.label_first[layer] + ids[PRIM_ID]]
                    material = facets.material[layer, label]
                    if facets.kind[material] != NONE:
                        if bounces >= max_bounces:
                            return KILLED, v, bounces, straight, joined, rays
                        bounces += 1
                        back = min(0.5 * distance, RETREAT * box[LIFT])
                        retreat = (x - back * v[0], y - back * v[1], z - back * v[2])
                        if eye is not None:
                            joined, looks = join_facet(
                                zones, facets, tables, media, share, polarised, to_channels, eye, zone, layer,
                                material, medium, v, n, light, x, y, z, corner_x, corner_y, bounces, ray, scratch,
                            )  # fmt: skip
                            rays += looks
                        v, e, crossed, specular = interact(
                            facets, tables, media, share, polarised, layer, material, front, v, n, e, light,
                            scratch, path, event, seed, batch,
                        )  # fmt: skip
                        joined = joined and not specular
                        straight = straight and specular and n[0] == 0.0 and n[1] == 0.0
                        absorbed[2 * layer] += _lose(
                            light, share, energy, bounces, path, event, 2, seed, batch
                        )
                    can_retreat = not crossed
                    if crossed:
                        medium = layer + 1 if front else layer
                # single precision puts a hit a little off the facet: step off it, to the side the path goes on
                step = -box[LIFT] if crossed else box[LIFT]
                x += step * n[0]
                y += step * n[1]
                z += step * n[2]
                continue
        # a collision, in the gap or between facets
        if bounces >= max_bounces:
            return KILLED, v, bounces, straight, joined, rays
        bounces += 1
        straight = False
        can_retreat = False
        if eye is not None:
            joined, looks = join_collision(
                zones, facets, media, share, polarised, to_channels, eye, zone, in_gap, medium, v, e, light, x, y, z,
                depth, corner_x, corner_y, bounces, ray, scratch,
            )  # fmt: skip
            rays += looks
        energy = _energy(light, share)
        v, e = scatter(media, medium, polarised, v, e, light, path, event, seed, batch)
        absorbed[2 * medium - 1] += energy - _energy(light, share)
    return LOST, v, bounces, straight, joined, rays


@kernel(allocates=False)
def _energy(light, share):
    """Energy of the samples as the mean over the table's channels."""
    total = 0.0
    for s in range(share.shape[0]):
        total += share[s] * light[s, 0]
    return total


@kernel(allocates=False)
def _strongest(light):
    """Intensity of the strongest sample."""
    strongest = 0.0
    for s in range(light.shape[0]):
        strongest = max(strongest, light[s, 0])
    return strongest


@kernel(allocates=False)
def _left(light):
    """Light that left above is reflected, if there is any."""
    return REFLECTED if _strongest(light) > 0.0 else ABSORBED


@kernel(allocates=False)
def _locate(box, x, y):
    """From metres to a place in the zone's tile and that tile's corner; a plane's tile is all of it."""
    if box[WIDTH_X] == math.inf:
        return 0.0, 0.0, x, y
    width_x, width_y = box[WIDTH_X] * box[UNIT], box[WIDTH_Y] * box[UNIT]
    corner_x, corner_y = math.floor(x / width_x) * width_x, math.floor(y / width_y) * width_y
    in_x = min(max((x - corner_x) / box[UNIT], 0.0), box[WIDTH_X])
    in_y = min(max((y - corner_y) / box[UNIT], 0.0), box[WIDTH_Y])
    return in_x, in_y, corner_x, corner_y


@kernel(allocates=False)
def _to_face(box, x, y, z, v):
    """Distance to the face through which a ray leaves the box, and which: 1 x, 2 y, 3 top or bottom, 0 none."""
    distance = math.inf
    face = 0
    if v[2] != 0.0:
        distance = max(((box[TOP] if v[2] > 0.0 else box[BOTTOM]) - z) / v[2], 0.0)
        face = 3
    if v[0] != 0.0:
        to_x = ((box[WIDTH_X] if v[0] > 0.0 else 0.0) - x) / v[0]
        if to_x < distance:
            distance, face = to_x, 1
    if v[1] != 0.0:
        to_y = ((box[WIDTH_Y] if v[1] > 0.0 else 0.0) - y) / v[1]
        if to_y < distance:
            distance, face = to_y, 2
    return max(distance, 0.0), face


@kernel(allocates=False)
def _lose(light, share, before, bounces, path, event, dimension, seed, batch):
    """What the light lost of the energy it had before; after a few bounces, whoever loses plays Russian roulette.

    Survivors carry the energy of those that end; nobody plays where nothing is absorbed, so that the ledger
    shows nothing there.

    Returns
    -------
    float
        Energy lost, that of a path that ends or, negative, that given to a survivor included.
    """
    energy = _energy(light, share)
    if bounces >= ROULETTE_BOUNCES and energy < min(1.0, before * (1.0 - _NOTHING)):
        u, _, _, _ = uniforms(path, path >> 32, event, dimension, seed, batch)
        for s in range(light.shape[0]):
            scale(light[s], 1.0 / energy if u < energy else 0.0)
    return before - _energy(light, share)
