"""A loop that traces rough mirrors and nothing else, with the same books as the instrument, as a yardstick.

It has the periodic tile, the cap on bounces, the ledger, the delta term and the tallies, and no materials, weights,
polarisation, channels, orders or transmission. What the instrument takes longer is what all that it can
model costs a path that does not need it.
"""

from __future__ import annotations

import math

import numpy as np

from gonio.core.directions import cos_delta_phi
from gonio.core.embree import (
    DIR_X,
    DIR_Y,
    DIR_Z,
    GEOM_ID,
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
    new_packet,
)  # fmt: skip
from gonio.core.jit import kernel
from gonio.core.lookup import find
from gonio.core.philox import uniforms
from gonio.trace.analog import morton
from gonio.trace.horizon import escapes
from gonio.trace.start import fall, start_packet
from gonio.trace.tracer import MAX_BOUNCES
from gonio.trace.transport import MAX_SEGMENTS

_ZERO = np.float32(0)
_FAR = np.float32(np.inf)


@kernel
def trace_mirror(embree, box, horizon, theta, phi, sin_i, strata, first, last, seed, cells, ledger):
    """Trace packets first ... last - 1 of strata x strata over a rough mirror, from one angle of incidence.

    Parameters
    ----------
    embree : Handle
    box : Box
    horizon : Horizon
    theta, phi : Axis
        Edges of sin^2 theta_r and -cos(delta phi).
    sin_i : float
    strata, first, last, seed : int
    cells : ndarray, shape (R * P, 2)
        Energy and number of the paths that leave through each cell are added.
    ledger : ndarray, shape (5,)
        Reflected, of these in the mirror direction, killed, lost; rays.
    """
    bounces = np.zeros(PACKET_WIDTH, np.int64)
    own = np.zeros(5)  # apart: threads that write to one cache line wait for each other
    _trace(
        embree, box, horizon, theta, phi, sin_i, strata, first, last, seed, cells, own, new_packet(), bounces
    )
    ledger += own


@kernel(allocates=False)
def _trace(
    embree, box, horizon, theta, phi, sin_i, strata, first, last, seed, cells, ledger, packet, bounces
):
    ints = packet.view(np.int32)
    dx, dy = box.width_x / (4 * strata), box.width_y / (4 * strata)
    sectors = phi.edges.shape[0] - 1
    for k in range(first, last):
        i, j = morton(k)
        _, v, _, _ = uniforms(16 * k, 0, 0, 1, seed, 0)
        azimuth = 2.0 * math.pi * v
        wi = (sin_i * math.cos(azimuth), sin_i * math.sin(azimuth), math.sqrt(1.0 - sin_i * sin_i))
        start_packet(packet, wi, box, 4 * i * dx, 4 * j * dy, dx, dy, seed, 0, 16 * k)
        mirror_x, mirror_y = packet[DIR_X, 0], packet[DIR_Y, 0]
        bounces[:] = 0
        active = PACKET_WIDTH
        segments = 0
        while active > 0:
            if segments == 0 and sin_i == 0.0:
                fall(horizon.samples, box, packet)
            else:
                intersect16(embree, packet, True)
                ledger[4] += active
            segments += 1
            for lane in range(PACKET_WIDTH):
                if ints[VALID, lane] == 0:
                    continue
                ended, out = segments >= MAX_SEGMENTS, False
                if ended:
                    ledger[3] += 1.0
                elif ints[GEOM_ID, lane] != MISS:
                    ended = bounces[lane] >= MAX_BOUNCES
                    if ended:
                        ledger[2] += 1.0
                    elif _reflect(packet, lane, box.lift):
                        bounces[lane] += 1
                        out = escapes(
                            horizon,
                            packet[ORG_X, lane], packet[ORG_Y, lane], packet[ORG_Z, lane],
                            packet[DIR_X, lane], packet[DIR_Y, lane], packet[DIR_Z, lane],
                        )  # fmt: skip
                else:
                    out = _wrap(box, packet, lane)
                if out:
                    ended = True
                    x, y, z = packet[DIR_X, lane], packet[DIR_Y, lane], packet[DIR_Z, lane]
                    if z < _ZERO:
                        ledger[3] += 1.0
                    else:
                        ledger[0] += 1.0
                        if x == mirror_x and y == mirror_y:
                            ledger[1] += 1.0
                        else:
                            wo = (float(x), float(y), float(z))
                            sin2, cos2 = wo[0] * wo[0] + wo[1] * wo[1], wo[2] * wo[2]
                            ring, sector = (
                                find(theta, sin2 / (sin2 + cos2)),
                                find(phi, -cos_delta_phi(wi, wo)),
                            )
                            cells[ring * sectors + sector, 0] += 1.0
                            cells[ring * sectors + sector, 1] += 1.0
                if ended:
                    ints[VALID, lane] = 0
                    active -= 1
                packet[T_FAR, lane] = _FAR
                ints[GEOM_ID, lane] = MISS


@kernel(allocates=False)
def _reflect(packet, lane, lift):
    """Reflect a ray at its hit; False if it met the back of a facet, and goes on through."""
    nx, ny, nz = packet[NORMAL_X, lane], packet[NORMAL_Y, lane], packet[NORMAL_Z, lane]
    vx, vy, vz = packet[DIR_X, lane], packet[DIR_Y, lane], packet[DIR_Z, lane]
    scale = np.float32(1) / np.float32(math.sqrt(nx * nx + ny * ny + nz * nz))
    nx, ny, nz = nx * scale, ny * scale, nz * scale
    distance = packet[T_FAR, lane]
    packet[ORG_X, lane] += vx * distance + nx * lift
    packet[ORG_Y, lane] += vy * distance + ny * lift
    packet[ORG_Z, lane] += vz * distance + nz * lift
    along = vx * nx + vy * ny + vz * nz
    if along >= _ZERO:
        return False
    packet[DIR_X, lane] = vx - np.float32(2) * along * nx
    packet[DIR_Y, lane] = vy - np.float32(2) * along * ny
    packet[DIR_Z, lane] = vz - np.float32(2) * along * nz
    return True


@kernel(allocates=False)
def _wrap(box, packet, lane):
    """Move a ray that hit nothing to the tile's face and in again opposite; True if it is out."""
    x, y, z = packet[ORG_X, lane], packet[ORG_Y, lane], packet[ORG_Z, lane]
    vx, vy, vz = packet[DIR_X, lane], packet[DIR_Y, lane], packet[DIR_Z, lane]
    to_z = ((box.top if vz > _ZERO else box.bottom) - z) / vz
    to_x = ((box.width_x if vx > _ZERO else _ZERO) - x) / vx
    to_y = ((box.width_y if vy > _ZERO else _ZERO) - y) / vy
    if not (to_z > to_x or to_z > to_y):
        return True
    t = min(to_x, to_y)
    packet[ORG_X, lane] = x + vx * t
    packet[ORG_Y, lane] = y + vy * t
    packet[ORG_Z, lane] = z + vz * t
    if to_x < to_y:
        packet[ORG_X, lane] = _ZERO if vx > _ZERO else box.width_x
    else:
        packet[ORG_Y, lane] = _ZERO if vy > _ZERO else box.width_y
    return False
