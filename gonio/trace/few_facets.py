"""Facets that look in few directions: paths on a net, so that every facet is met in proportion to what is seen of it.

Light from one direction leaves such a surface in a few directions only, known in closed form but for the parts of
the surface that each of them belongs to. Over the azimuth of the light these draw arcs across the table. What is left
to find out, which part of the surface does what and when, is a step function of four numbers, place and
direction: chance alone, of which analog binning is made, is the slowest way to its integral.

So the paths of a row and batch start on a Sobol net of points in all four numbers, each path in a direction of its own.
Owen's scrambling (1995, "Randomly permuted (t, m, s)-nets"; by hashes: Laine, Karras 2011, "Stratified sampling for
stochastic transparency") makes every path uniform by itself and every batch an independent estimate: nothing is
biased, and the scatter of batches is the error, as ever. It serves light of any number of bounces.

So rays find what is seen of each facet, and its direction is in closed form. Areas by many rays at one azimuth after
the other, exact one by one, would cost more: the azimuth decides which cell light reaches, and with 64 rays for the
areas there would be a 64th of the azimuths. Interpolated between azimuths they would be biased where shadows begin.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from gonio.core.embree import DIR_X, DIR_Y, DIR_Z, ORG_X, ORG_Y, PACKET_WIDTH, new_packet
from gonio.core.jit import kernel
from gonio.core.philox import philox4x32, unit
from gonio.trace.binning import (
    ABSORBED_COLUMN,
    RAYS,
    add_sums,
    cell_of,
    coordinates,
    count_exit,
    own_sums,
)
from gonio.trace.start import ready_packet
from gonio.trace.transport import trace_packet
from microgeometry.tile import Tile

MOST_DIRECTIONS = 4000
"""Normals of a surface that count as few. Measured, merit over analog's of cells and of the albedo, exact rows at
1 degree and 4 million paths: V-grooves of 30 degrees (2 normals) 180 and 330, pyramids (4) 14 and 25, random ones (4)
5.6 and 1.6, V-grooves of 128 slopes 2.1 and 3.2, half-beads (2600) 1.6 and 4.8, random pits (28 000) 1.0 and 2.2, a
Gaussian surface of alpha 0.5 1.0 and 1.2, a measured map (3 million) 0.8 and 1.1: there the caches miss more."""
_MOST_FACETS = 1 << 17  # that are looked at for that
_SCRAMBLE = 1 << 17  # dimension of the random numbers that no path uses
_ALIKE = 1e-6

_LOW = np.uint64(0xFFFFFFFF)
_BYTES, _NIBBLES = np.uint64(0x00FF00FF), np.uint64(0x0F0F0F0F)
_PAIRS, _ODD = np.uint64(0x33333333), np.uint64(0x55555555)
_LK = np.uint64(0x3D20ADEA), np.uint64(0x05526C56), np.uint64(0x53A22864)


def directions(tile: Tile) -> int:
    """Number of normals that facets of a tile have, but the upward one; or of facets, where these are very many."""
    normals, areas = tile.facets()
    if len(areas) > _MOST_FACETS:
        return len(areas)
    tilted = normals[(areas > 0) & (np.abs(normals[:, :2]).max(axis=1) > _ALIKE)]
    return len(np.unique(np.round(tilted / _ALIKE).astype(np.int64), axis=0))


def net(paths: int) -> NDArray[np.uint32]:
    """Points for a pass of paths, a power of 2 from 16 on, neighbours in place side by side.

    Returns
    -------
    ndarray of uint32, shape (paths, 4)
        x and y on the tile, sin^2 and azimuth of the direction; in units of 2**-32.
    """
    bits = paths.bit_length() - 1
    points = qmc.Sobol(4, scramble=False, bits=32).random_base2(bits)
    whole = (points * 2.0**32).astype(np.uint32)
    # along Morton's curve, finer than there are points: in dimensions 0 and 1 they fill squares evenly
    order = np.zeros(paths, np.int64)
    for bit in range((bits + 1) // 2):
        for axis in (0, 1):
            order = 2 * order + ((whole[:, axis] >> np.uint32(31 - bit)) & np.uint32(1))
    return np.ascontiguousarray(whole[np.argsort(order, kind="stable")])


@kernel
def trace_on_net(
    embree, box, horizon, eta_k, to_channels, bins, beam, points, first, last, seed, batch, max_bounces, sums
):  # fmt: skip
    """Trace paths over one surface of mirror or metal facets and bin them by where they leave.

    Parameters
    ----------
    embree, box, horizon, eta_k, to_channels, bins, beam, seed, batch, max_bounces, sums
        As in `gonio.trace.analog.trace_surface`; `bins` without a peak.
    points : ndarray
        From `net`.
    first, last : int
        Packets of 16 points to trace: first ... last - 1.
    """
    samples = bins.share.shape[0]
    weight = np.empty((PACKET_WIDTH, samples))
    polarisation = None if eta_k is None else np.empty((PACKET_WIDTH, samples, 3))
    axis = None if eta_k is None else np.empty((PACKET_WIDTH, 3))
    own = own_sums(sums)
    _trace_on_net(
        embree, box, horizon, eta_k, to_channels, bins, beam, points, first, last, seed, batch, max_bounces, own,
        new_packet(), np.empty((PACKET_WIDTH, 4)), weight, polarisation, axis,
        np.empty((3, PACKET_WIDTH), np.float32), np.zeros(PACKET_WIDTH, np.int64), np.zeros(PACKET_WIDTH, np.int64),
        np.zeros(samples),
    )  # fmt: skip
    add_sums(own, sums)


@kernel(allocates=False)
def _trace_on_net(
    embree, box, horizon, eta_k, to_channels, bins, beam, points, first, last, seed, batch, max_bounces, sums,
    packet, begun, weight, polarisation, axis, retreat, bounces, status, absorbed,
):  # fmt: skip
    key = philox4x32(beam.row, 0, 0, _SCRAMBLE, seed, batch)
    for k in range(first, last):
        path = beam.row * points.shape[0] + k * PACKET_WIDTH
        for lane in range(PACKET_WIDTH):
            point = points[k * PACKET_WIDTH + lane]
            packet[ORG_X, lane] = unit(_scramble(point[0], key[0])) * box.width_x
            packet[ORG_Y, lane] = unit(_scramble(point[1], key[1])) * box.width_y
            sin2 = beam.sin2_lower + unit(_scramble(point[2], key[2])) * (beam.sin2_upper - beam.sin2_lower)
            turn = 2.0 * math.pi * unit(_scramble(point[3], key[3]))
            cosine, sine = math.cos(turn), math.sin(turn)
            packet[DIR_X, lane] = -math.sqrt(sin2) * cosine
            packet[DIR_Y, lane] = -math.sqrt(sin2) * sine
            packet[DIR_Z, lane] = -math.sqrt(1.0 - sin2)
            begun[lane, 0], begun[lane, 1] = packet[DIR_X, lane], packet[DIR_Y, lane]
            begun[lane, 2], begun[lane, 3] = cosine, sine
        ready_packet(packet, box)
        sums.ledger[RAYS] += trace_packet(
            embree, box, horizon, False, packet, eta_k, None, max_bounces, seed, batch, path,
            weight, polarisation, axis, retreat, bounces, status, absorbed,
        )  # fmt: skip
        for lane in range(PACKET_WIDTH):
            x, y, z = packet[DIR_X, lane], packet[DIR_Y, lane], packet[DIR_Z, lane]
            sin2, cosine = coordinates(float(x), float(y), float(z), (begun[lane, 2], begun[lane, 3]))
            # a facet parallel to the macroscopic plane leaves these two untouched, to the bit
            delta = x == begun[lane, 0] and y == begun[lane, 1]
            count_exit(
                to_channels, bins, sums, cell_of(bins, sin2, cosine), status[lane], bounces[lane], delta, False,
                weight[lane],
            )  # fmt: skip
    for sample in range(absorbed.shape[0]):
        sums.ledger[ABSORBED_COLUMN] += bins.share[sample] * absorbed[sample]


@kernel(allocates=False)
def _scramble(point, key):
    """Owen's scrambling of 32 binary digits: each is flipped by a hash of those before it and the key."""
    x = _reversed(np.uint64(point))
    x ^= (x * _LK[0]) & _LOW
    x = (x + key) & _LOW
    x = (x * ((key >> np.uint64(16)) | np.uint64(1))) & _LOW
    x ^= (x * _LK[1]) & _LOW
    x ^= (x * _LK[2]) & _LOW
    return _reversed(x)


@kernel(inline=True, allocates=False)
def _reversed(x):
    """32 binary digits in reverse order."""
    x = ((x & _LOW) << np.uint64(16) | x >> np.uint64(16)) & _LOW
    x = ((x & _BYTES) << np.uint64(8)) | ((x >> np.uint64(8)) & _BYTES)
    x = ((x & _NIBBLES) << np.uint64(4)) | ((x >> np.uint64(4)) & _NIBBLES)
    x = ((x & _PAIRS) << np.uint64(2)) | ((x >> np.uint64(2)) & _PAIRS)
    return ((x & _ODD) << np.uint64(1)) | ((x >> np.uint64(1)) & _ODD)
