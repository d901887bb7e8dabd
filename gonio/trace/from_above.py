"""Where light from straight above meets a height field: below where it starts, and no ray need be traced.

Normal incidence stands in nearly every list of angles that is measured, and half of what a path costs there is
finding its first facet.
"""

from __future__ import annotations

import numpy as np

from gonio.core.embree import (
    DIR_X,
    DIR_Y,
    GEOM_ID,
    NORMAL_X,
    NORMAL_Y,
    NORMAL_Z,
    ORG_X,
    ORG_Y,
    ORG_Z,
    PACKET_WIDTH,
    T_FAR,
)
from gonio.core.jit import kernel

_ONE = np.float32(1.0)


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
        Started by `gonio.trace.transport.start_packet`.
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
