"""Where 16 paths start, and where they first meet a surface if that is below them.

Light from straight above meets a height field below where it starts, and no ray need be traced: normal incidence
stands in nearly every list of angles that is measured, and a fifth of what a path costs there is saved.
"""

from __future__ import annotations

import numpy as np

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
    PACKET_WIDTH,
    T_FAR,
    T_NEAR,
    VALID,
)
from gonio.core.jit import kernel
from gonio.core.philox import uniforms

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_FAR = np.float32(np.inf)


@kernel(allocates=False)
def start_packet(packet, wi, box, x0, y0, dx, dy, seed, batch, path):
    """Place 16 paths on the plane at the top of the box, one in each cell of a 4 x 4 grid of strata, heading along -wi.

    Parameters
    ----------
    packet : ndarray
        From `gonio.core.embree.new_packet`.
    wi : direction
        Towards the light.
    box : Box
    x0, y0, dx, dy : float
        Corner and size of one stratum, tile units.
    seed, batch, path : int
        Key and counter of the random numbers; the packet's paths are path ... path + 15.
    """
    if packet.shape[1] != PACKET_WIDTH:  # tells the compiler, which then vectorises
        return
    half = PACKET_WIDTH // 2
    for lane in range(half):
        # four numbers, for two paths
        u, v, p, q = uniforms(path + lane, (path + lane) >> 32, 0, 0, seed, batch)
        packet[ORG_X, lane] = x0 + (lane // 4 + u) * dx
        packet[ORG_Y, lane] = y0 + (lane % 4 + v) * dy
        packet[ORG_X, lane + half] = x0 + (lane // 4 + half // 4 + p) * dx
        packet[ORG_Y, lane + half] = y0 + (lane % 4 + q) * dy
    for lane in range(PACKET_WIDTH):
        packet[DIR_X, lane] = -wi[0]
        packet[DIR_Y, lane] = -wi[1]
        packet[DIR_Z, lane] = -wi[2]
    ready_packet(packet, box)


@kernel(allocates=False)
def ready_packet(packet, box):
    """Lift 16 paths, whose x, y and directions are set, to the plane at the top of the box, ready to be traced."""
    if packet.shape[1] != PACKET_WIDTH:  # tells the compiler
        return
    ints = packet.view(np.int32)
    # rounding may put a path on a face of the box, where Embree sees no facet straight below
    low, x_high, y_high = box.lift, box.width_x - box.lift, box.width_y - box.lift
    for lane in range(PACKET_WIDTH):
        packet[ORG_X, lane] = min(max(packet[ORG_X, lane], low), x_high)
        packet[ORG_Y, lane] = min(max(packet[ORG_Y, lane], low), y_high)
        packet[ORG_Z, lane] = box.top
        packet[T_NEAR, lane] = _ZERO
        packet[T_FAR, lane] = _FAR
        ints[GEOM_ID, lane] = MISS
        ints[INST_ID, lane] = MISS
        ints[INST_PRIM_ID, lane] = MISS
        ints[VALID, lane] = -1


@kernel(allocates=False)
def is_vertical(packet):
    """Whether all rays of a started packet head straight down."""
    slanted = 0
    for lane in range(PACKET_WIDTH):
        slanted += (packet[DIR_X, lane] != 0.0) | (packet[DIR_Y, lane] != 0.0)
    return slanted == 0


@kernel(allocates=False)
def fall(heights, box, packet):
    """Put the hits of 16 rays straight down where `intersect16` puts them.

    Parameters
    ----------
    heights : ndarray of float32, shape (nx + 1, ny + 1)
        Samples as Embree has them, the first row and column again at the far side. A quad is split from
        (i + 1, j) to (i, j + 1), as Embree's grids are.
    box : Box
    packet : ndarray
        Started by `start_packet`.
    """
    if packet.shape[1] != PACKET_WIDTH:  # tells the compiler
        return
    ints = packet.view(np.int32)
    nx, ny = heights.shape[0] - 1, heights.shape[1] - 1
    per_x, per_y = np.float32(nx) / box.width_x, np.float32(ny) / box.width_y
    for lane in range(PACKET_WIDTH):
        x, y = packet[ORG_X, lane] * per_x, packet[ORG_Y, lane] * per_y
        i, j = min(np.int64(x), nx - 1), min(np.int64(y), ny - 1)
        u, v = x - np.float32(i), y - np.float32(j)
        z10, z01 = heights[i + 1, j], heights[i, j + 1]
        near = u + v <= _ONE
        corner = heights[i, j] if near else heights[i + 1, j + 1]
        along_x = z10 - corner if near else corner - z01
        along_y = z01 - corner if near else corner - z10
        z = (
            corner + u * along_x + v * along_y
            if near
            else corner - (_ONE - u) * along_x - (_ONE - v) * along_y
        )
        packet[T_FAR, lane] = packet[ORG_Z, lane] - z
        packet[NORMAL_X, lane] = -along_x * per_x
        packet[NORMAL_Y, lane] = -along_y * per_y
        packet[NORMAL_Z, lane] = _ONE
        ints[GEOM_ID, lane] = 0
