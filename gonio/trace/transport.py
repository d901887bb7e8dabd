"""Transport of light over one opaque surface: 16 paths at a time, from the plane above it until they leave.

The fast way for a periodic tile of mirrors, conductors or Lambertian facets; whatever else a specimen can be
goes through `gonio.trace.layered`.

The packet that Embree traces is itself the state of the 16 paths, in single precision; path weights are
double. A packet's lanes start beside each other and in one direction; where they lie so close that they
meet the same few facets, Embree traces every segment with its coherent flag (neighbours stay neighbours
after a bounce more often than not).
"""

from __future__ import annotations

import math

import numpy as np

from gonio.core.directions import cosine_hemisphere, dot, frame
from gonio.core.embree import (
    DIR_X,
    DIR_Y,
    DIR_Z,
    GEOM_ID,
    HIT_U,
    HIT_V,
    MISS,
    NORMAL_X,
    NORMAL_Y,
    NORMAL_Z,
    ORG_X,
    ORG_Y,
    ORG_Z,
    PACKET_WIDTH,
    T_FAR,
    VALID,
    intersect16,
)  # fmt: skip
from gonio.core.jit import kernel
from gonio.core.optics import fresnel_amplitudes, fresnel_conductor
from gonio.core.philox import uniforms
from gonio.core.stokes import mueller, perpendicular, rotation
from gonio.trace.horizon import escapes
from gonio.trace.start import fall, is_vertical

# How a path ended. Every path has exactly one of these.
REFLECTED = 1  # left through the plane above
TRANSMITTED = 2  # left below
ABSORBED = 3  # nothing is left of it, or Russian roulette ended it; its energy is in the ledger's absorbed
KILLED = 4  # still bouncing at the cap
LOST = 5  # fell through the surface or wandered without end: numerics, or a hole in the mesh

ROULETTE_BOUNCES = 4
MAX_SEGMENTS = 100_000  # of a path, crossings of the tile's faces included: no path can go on for ever

# In steps off the facet: how far inside the body a path is no longer where rounding put it, and how far
# before its last bounce it starts again.
INSIDE = np.float32(16.0)
RETREAT = np.float32(64.0)

# Rows of the packet where Embree leaves what we do not need: direction times unit normal at a hit, and
# whether a ray that hit nothing goes out above.
D_N, LEAVES = HIT_U, HIT_V

_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_FAR = np.float32(np.inf)


@kernel(allocates=False)
def trace_packet(
    embree,
    box,
    horizon,
    coherent,
    packet,
    eta_k,
    albedo,
    max_bounces,
    seed,
    batch,
    path,
    weight,
    polarisation,
    axis,
    retreat,
    bounces,
    status,
    absorbed,
):
    """Follow the 16 paths of a started packet to their ends.

    Parameters
    ----------
    embree : Handle
    box : Box
    horizon : Horizon
        Of a height field, or none. Paths that climb past it are out without another ray, and those that come straight
        down need none to find their first facet.
    coherent : bool
        Whether neighbouring paths start within a few facets of each other: Embree then traces them
        together, else each for itself.
    packet : ndarray
        Started by `gonio.trace.start.start_packet`; on return its directions are those the paths left in.
    eta_k, albedo : ndarray or None
        As in `gonio.trace.scene.Optics`.
    max_bounces : int
        A path that would bounce once more is killed.
    seed, batch, path : int
        As in `gonio.trace.start.start_packet`.
    weight : ndarray, shape (16, S)
        Set to what is left of each path's energy at its end.
    polarisation, axis : ndarray or None, shapes (16, S, 3) and (16, 3)
        Work space for Q, U, V of each path and the axis they refer to, where `eta_k` is given: light comes
        in unpolarised, and every metal facet polarises it.
    retreat : ndarray of float32, shape (3, 16)
        Work space: a place just before each path's last bounce. In a sharp valley the step off one wall can
        end behind the other; a path found inside the body starts again from here, once.
    bounces, status : ndarray of int64, shape (16,)
        Set to each path's number of bounces and to how it ended.
    absorbed : ndarray, shape (S,)
        Energy absorbed is added; Russian roulette takes and gives here, so that the sum over all ends of
        a path is exactly 1.

    Returns
    -------
    int
        Rays traced.
    """
    if packet.shape[1] != PACKET_WIDTH:  # tells the compiler
        return 0
    ints = packet.view(np.int32)
    weight[:, :] = 1.0
    bounces[:] = 0
    retreat[:, :] = np.nan
    segments = 0
    active = PACKET_WIDTH
    rays = 0
    has_horizon = horizon.slopes.shape[0] > 0
    falls = has_horizon and is_vertical(packet)
    while active > 0:
        if falls:
            fall(horizon.samples, box, packet)
            falls = False
        else:
            intersect16(embree, packet, coherent)
            rays += active
        segments += 1
        arrive(box, packet, albedo is None, retreat, bounces)
        for lane in range(PACKET_WIDTH):
            if ints[VALID, lane] == 0:
                continue
            end = 0
            if ints[GEOM_ID, lane] == MISS:
                end = REFLECTED if packet[LEAVES, lane] == _ONE else cross(box, packet, lane)
                if end == LOST and send_back(packet, lane, retreat):
                    end = 0
            elif packet[D_N, lane] >= _ZERO:
                # a facet's back: the path started a rounding error below the surface, and goes on through
                if packet[T_FAR, lane] >= INSIDE * box.lift:
                    send_back(packet, lane, retreat)
            elif bounces[lane] > max_bounces:
                bounces[lane] = max_bounces
                end = KILLED
            elif albedo is not None or eta_k is not None:
                end = _scatter(
                    packet, lane, eta_k, albedo, seed, batch, path + lane, weight, polarisation, axis,
                    bounces, absorbed,
                )  # fmt: skip
            if end == 0 and segments >= MAX_SEGMENTS:
                end = LOST
            if end != 0:
                status[lane] = end
                ints[VALID, lane] = 0
                active -= 1
        if has_horizon and active > 0:
            active -= _escape(horizon, packet, status)
        for lane in range(PACKET_WIDTH):
            packet[T_FAR, lane] = _FAR
            ints[GEOM_ID, lane] = MISS
    return rays


@kernel(allocates=False)
def arrive(box, packet, reflects, retreat, bounces):
    """Take all rays to where they hit and off the facet, mirrored in its normal if it `reflects`.

    Nothing here branches, so that the compiler does many lanes at once. The normals become unit vectors;
    D_N tells back from front, LEAVES whether a ray that hit nothing goes out through the plane above.
    """
    if packet.shape[1] != PACKET_WIDTH or retreat.shape[1] != PACKET_WIDTH:  # tells the compiler
        return
    ints = packet.view(np.int32)
    lift = box.lift
    for lane in range(PACKET_WIDTH):
        hit = (ints[VALID, lane] != 0) & (ints[GEOM_ID, lane] != MISS)
        nx, ny, nz = packet[NORMAL_X, lane], packet[NORMAL_Y, lane], packet[NORMAL_Z, lane]
        vx, vy, vz = packet[DIR_X, lane], packet[DIR_Y, lane], packet[DIR_Z, lane]
        square = nx * nx + ny * ny + nz * nz
        inverse = _ONE / np.float32(math.sqrt(square if hit else _ONE))
        nx *= inverse
        ny *= inverse
        nz *= inverse
        d_n = vx * nx + vy * ny + vz * nz
        front = hit & (d_n < _ZERO)
        distance = packet[T_FAR, lane] if hit else _ZERO
        x = packet[ORG_X, lane] + vx * distance
        y = packet[ORG_Y, lane] + vy * distance
        z = packet[ORG_Z, lane] + vz * distance
        back = min(_HALF * distance, RETREAT * lift)
        retreat[0, lane] = x - vx * back if front else retreat[0, lane]
        retreat[1, lane] = y - vy * back if front else retreat[1, lane]
        retreat[2, lane] = z - vz * back if front else retreat[2, lane]
        # Single precision puts a hit a little off the surface: step off along the normal, past the facet
        # itself. A fixed step along the ray would jump over a neighbour in a crease (and lost 1 path in 10^7).
        packet[ORG_X, lane] = x + nx * lift if hit else x
        packet[ORG_Y, lane] = y + ny * lift if hit else y
        packet[ORG_Z, lane] = z + nz * lift if hit else z
        if reflects:
            twice = _TWO * d_n
            packet[DIR_X, lane] = vx - twice * nx if front else vx
            packet[DIR_Y, lane] = vy - twice * ny if front else vy
            packet[DIR_Z, lane] = vz - twice * nz if front else vz
        bounces[lane] += front
        packet[NORMAL_X, lane] = nx
        packet[NORMAL_Y, lane] = ny
        packet[NORMAL_Z, lane] = nz
        packet[D_N, lane] = d_n
        to_top = (box.top - z) / (vz if vz > _ZERO else _ONE)
        x += vx * to_top
        y += vy * to_top
        inside = (x >= _ZERO) & (x <= box.width_x) & (y >= _ZERO) & (y <= box.width_y)
        packet[LEAVES, lane] = _ONE if (vz > _ZERO) & inside else _ZERO


@kernel(allocates=False)
def _escape(horizon, packet, status):
    """End the paths that have just left a facet and will meet no other; returns how many."""
    if packet.shape[1] != PACKET_WIDTH:  # tells the compiler
        return 0
    ints = packet.view(np.int32)
    ended = 0
    for lane in range(PACKET_WIDTH):
        left = (ints[VALID, lane] != 0) & (ints[GEOM_ID, lane] != MISS) & (packet[D_N, lane] < _ZERO)
        if left and escapes(
            horizon,
            packet[ORG_X, lane], packet[ORG_Y, lane], packet[ORG_Z, lane],
            packet[DIR_X, lane], packet[DIR_Y, lane], packet[DIR_Z, lane],
        ):  # fmt: skip
            status[lane] = REFLECTED
            ints[VALID, lane] = 0
            ended += 1
    return ended


@kernel(allocates=False)
def cross(box, packet, lane):
    """Take a ray that hit nothing in its tile to the tile's face: out above, lost below, or in again opposite."""
    x, y, z = packet[ORG_X, lane], packet[ORG_Y, lane], packet[ORG_Z, lane]
    vx, vy, vz = packet[DIR_X, lane], packet[DIR_Y, lane], packet[DIR_Z, lane]
    distance = _FAR
    end = LOST  # a ray that goes nowhere
    if vz > _ZERO:
        distance = (box.top - z) / vz
        end = REFLECTED
    elif vz < _ZERO:
        distance = (box.bottom - z) / vz
    face = 0
    if vx != _ZERO:
        to_x = ((box.width_x if vx > _ZERO else _ZERO) - x) / vx
        if to_x < distance:
            distance, face = to_x, 1
    if vy != _ZERO:
        to_y = ((box.width_y if vy > _ZERO else _ZERO) - y) / vy
        if to_y < distance:
            distance, face = to_y, 2
    if face == 0:
        return end
    x += vx * distance
    y += vy * distance
    if face == 1:  # exactly onto the opposite face
        x = _ZERO if vx > _ZERO else box.width_x
    else:
        y = _ZERO if vy > _ZERO else box.width_y
    packet[ORG_X, lane] = x
    packet[ORG_Y, lane] = y
    packet[ORG_Z, lane] = z + vz * distance
    return 0


@kernel(allocates=False)
def _scatter(
    packet, lane, eta_k, albedo, seed, batch, path, weight, polarisation, axis, bounces, absorbed
):  # fmt: skip
    """What a facet does to a path but mirror it; returns how it ended, or 0 if it goes on."""
    n = (float(packet[NORMAL_X, lane]), float(packet[NORMAL_Y, lane]), float(packet[NORMAL_Z, lane]))
    if albedo is not None:
        u, v, _, _ = uniforms(path, path >> 32, bounces[lane], 0, seed, batch)
        s, t = frame(n)
        a, b, c = cosine_hemisphere(u, v)
        packet[DIR_X, lane] = a * s[0] + b * t[0] + c * n[0]
        packet[DIR_Y, lane] = a * s[1] + b * t[1] + c * n[1]
        packet[DIR_Z, lane] = a * s[2] + b * t[2] + c * n[2]
        for channel in range(weight.shape[1]):
            w = weight[lane, channel]
            weight[lane, channel] = w * albedo[channel]
            absorbed[channel] += w - weight[lane, channel]
    if eta_k is not None:
        twice = 2.0 * packet[D_N, lane]
        v = (
            packet[DIR_X, lane] + twice * n[0],
            packet[DIR_Y, lane] + twice * n[1],
            packet[DIR_Z, lane] + twice * n[2],
        )
        _reflect_polarised(
            v, n, eta_k, bounces[lane] == 1, weight[lane], polarisation[lane], axis[lane], absorbed
        )
    if bounces[lane] >= ROULETTE_BOUNCES:
        return _roulette(lane, eta_k, seed, batch, path, weight, polarisation, bounces, absorbed)
    return 0


@kernel(allocates=False)
def send_back(packet, lane, retreat):
    """Send a path found inside the body back to before its last bounce, in its new direction; False if it was."""
    if math.isnan(retreat[0, lane]):
        return False
    packet[ORG_X, lane] = retreat[0, lane]
    packet[ORG_Y, lane] = retreat[1, lane]
    packet[ORG_Z, lane] = retreat[2, lane]
    retreat[0, lane] = np.nan
    return True


@kernel(allocates=False)
def _reflect_polarised(v, n, eta_k, first, intensity, polarisation, axis, absorbed):
    """Reflect Stokes vectors at a conductor; what comes from the light is not polarised yet."""
    cosine = min(1.0, -dot(v, n))
    across = perpendicular(v, n)
    if first:
        for s in range(intensity.shape[0]):
            r_s, r_p = fresnel_conductor(cosine, eta_k[s, 0], eta_k[s, 1])
            i = intensity[s]
            intensity[s] = i * (0.5 * (r_s + r_p))
            polarisation[s, 0] = i * (0.5 * (r_s - r_p))
            polarisation[s, 1] = 0.0
            polarisation[s, 2] = 0.0
            absorbed[s] += i - intensity[s]
    else:
        c, d = rotation((axis[0], axis[1], axis[2]), v, across)
        for s in range(intensity.shape[0]):
            r_s, r_p = fresnel_amplitudes(cosine, eta_k[s, 0], eta_k[s, 1])
            i, q, u = intensity[s], polarisation[s, 0], polarisation[s, 1]
            intensity[s], polarisation[s, 0], polarisation[s, 1], polarisation[s, 2] = mueller(
                i, c * q + d * u, c * u - d * q, polarisation[s, 2],
                r_s.real * r_s.real + r_s.imag * r_s.imag, r_p.real * r_p.real + r_p.imag * r_p.imag,
                r_s * r_p.conjugate(),
            )  # fmt: skip
            absorbed[s] += i - intensity[s]
    axis[0], axis[1], axis[2] = across


@kernel(allocates=False)
def _roulette(lane, eta_k, seed, batch, path, weight, polarisation, bounces, absorbed):
    """Russian roulette on the strongest channel: survivors carry the energy of those that end here."""
    channels = weight.shape[1]
    survival = 0.0
    for channel in range(channels):
        survival = max(survival, weight[lane, channel])
    if survival >= 1.0:
        return 0
    u, _, _, _ = uniforms(path, path >> 32, bounces[lane], 1, seed, batch)
    if u >= survival:
        for channel in range(channels):
            absorbed[channel] += weight[lane, channel]
            weight[lane, channel] = 0.0
        return ABSORBED
    for channel in range(channels):
        w = weight[lane, channel]
        weight[lane, channel] = w / survival
        absorbed[channel] += w - weight[lane, channel]
        if eta_k is not None:
            for i in range(3):
                polarisation[lane, channel, i] /= survival
    return 0
