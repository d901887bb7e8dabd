"""What points of a Lambertian surface see, and light that goes from one to another: kernels of `next_event`.

Points travel 16 to a packet. For each of a set of directions one packet of shadow rays, all parallel, is cast
from them.
"""

from __future__ import annotations

import numpy as np

from gonio.core.directions import cosine_hemisphere, frame
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
    intersect16,
    new_packet,
    occluded16,
)  # fmt: skip
from gonio.core.jit import kernel
from gonio.core.philox import uniforms
from gonio.trace.transport import (
    D_N,
    INSIDE,
    LEAVES,
    MAX_SEGMENTS,
    ROULETTE_BOUNCES,
    arrive,
    cross,
    send_back,
)

_PURPOSE = 1 << 25  # word of the random numbers' counter that no path's bounce reaches
_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_FAR = np.float32(np.inf)


@kernel
def look_around(
    embree, box, coherent, place, normal, albedo, to_basis, orders, to_light, to_detector, azimuth, seed, batch, first,
    lit, seen,
):  # fmt: skip
    """Cast shadow rays from points towards lights, and towards detectors from wherever their light goes.

    Light that arrives at a point leaves it by Lambert's law and goes on from facet to facet; the same random
    walk serves all lights.

    Parameters
    ----------
    embree : Handle
    box : Box
    coherent : bool
        Whether neighbouring points lie within a few facets of each other.
    place, normal : ndarray of float32, shape (N, 3)
        Points just above their facets, and the facets' normals. N is a multiple of 16.
    albedo : ndarray, shape (S,)
    to_basis : ndarray, shape (B, S)
        From the samples' weights to those that are told apart in `seen`.
    orders : int
        Numbers of bounces told apart; the last collects all beyond.
    to_light, to_detector : ndarray of float32, shapes (I, 3) and (O, 3)
    azimuth : ndarray, shape (N / 16, 2)
        (cos, sin) of the angle by which all directions are turned for each packet.
    seed, batch, first : int
        Key of the random numbers, and the number of the first point.
    lit : ndarray of float32, shape (N, I)
        Set to the cosine at the facet over that at the plane where the point sees the light, else 0.
    seen : ndarray of float32, shape (N, orders * B, O)
        The same towards detectors, times the weight of the light: the sum over the bounces of an order.

    Returns
    -------
    int
        Rays cast.
    """
    samples = albedo.shape[0]
    packet = new_packet()
    origin = np.empty((3, PACKET_WIDTH), np.float32)
    across = np.empty((3, PACKET_WIDTH), np.float32)
    retreat = np.empty((3, PACKET_WIDTH), np.float32)
    alive = np.empty(PACKET_WIDTH, np.int32)
    cosine = np.empty(PACKET_WIDTH, np.float32)
    weight = np.empty((PACKET_WIDTH, samples))
    mixed = np.empty((PACKET_WIDTH, to_basis.shape[0]), np.float32)
    bounces = np.empty(PACKET_WIDTH, np.int64)
    return _look_around(
        embree, box, coherent, place, normal, albedo, to_basis, orders, to_light, to_detector, azimuth, seed, batch,
        first, lit, seen, packet, origin, across, retreat, alive, cosine, weight, mixed, bounces,
    )  # fmt: skip


@kernel(allocates=False)
def _look_around(
    embree, box, coherent, place, normal, albedo, to_basis, orders, to_light, to_detector, azimuth, seed, batch,
    first, lit, seen, packet, origin, across, retreat, alive, cosine, weight, mixed, bounces,
):  # fmt: skip
    n_basis = to_basis.shape[0]
    survival = 0.0
    for s in range(albedo.shape[0]):
        survival = max(survival, albedo[s])
    seen[:, :, :] = _ZERO
    rays = 0
    for point in range(0, place.shape[0], PACKET_WIDTH):
        for lane in range(PACKET_WIDTH):
            alive[lane] = -1
            for axis in range(3):
                origin[axis, lane] = place[point + lane, axis]
                across[axis, lane] = normal[point + lane, axis]
        turned = azimuth[point // PACKET_WIDTH]
        for d in range(to_light.shape[0]):
            w = _turn(to_light[d], turned)
            rays += _see(embree, box, coherent, packet, origin, across, alive, w, cosine)
            for lane in range(PACKET_WIDTH):
                lit[point + lane, d] = cosine[lane] / to_light[d, 2]
        weight[:, :] = 1.0
        bounce = 0
        left = PACKET_WIDTH
        while left > 0:
            bounce += 1
            order = (min(bounce, orders) - 1) * n_basis
            for lane in range(PACKET_WIDTH):
                for s in range(albedo.shape[0]):
                    weight[lane, s] *= albedo[s]
                for b in range(n_basis):
                    total = 0.0
                    for s in range(albedo.shape[0]):
                        total += to_basis[b, s] * weight[lane, s]
                    mixed[lane, b] = total
            for d in range(to_detector.shape[0]):
                w = _turn(to_detector[d], turned)
                rays += _see(embree, box, coherent, packet, origin, across, alive, w, cosine)
                for lane in range(PACKET_WIDTH):
                    if cosine[lane] > _ZERO:
                        share = cosine[lane] / to_detector[d, 2]
                        for b in range(n_basis):
                            seen[point + lane, order + b, d] += share * mixed[lane, b]
            for lane in range(PACKET_WIDTH):
                if alive[lane] == 0:
                    continue
                number = first + point + lane
                u, v, w, _ = uniforms(number, number >> 32, bounce, _PURPOSE, seed, batch)
                if bounce >= ROULETTE_BOUNCES:
                    if w >= survival:
                        alive[lane] = 0
                        left -= 1
                        continue
                    for s in range(albedo.shape[0]):
                        weight[lane, s] /= survival
                n = float(across[0, lane]), float(across[1, lane]), float(across[2, lane])
                s, t = frame(n)
                x, y, z = cosine_hemisphere(u, v)
                packet[DIR_X, lane] = x * s[0] + y * t[0] + z * n[0]
                packet[DIR_Y, lane] = x * s[1] + y * t[1] + z * n[1]
                packet[DIR_Z, lane] = x * s[2] + y * t[2] + z * n[2]
            if left > 0:
                rays += _go_on(embree, box, packet, origin, across, retreat, alive, bounces)
                left = 0
                for lane in range(PACKET_WIDTH):
                    left -= alive[lane]
    return rays


@kernel(allocates=False)
def _turn(w, azimuth):
    """A direction turned about the macroscopic normal."""
    return w[0] * azimuth[0] - w[1] * azimuth[1], w[0] * azimuth[1] + w[1] * azimuth[0], w[2]


@kernel(allocates=False)
def _see(embree, box, coherent, packet, origin, across, alive, w, cosine):
    """Cosine at the facet of each lane that sees the direction `w`, else 0; returns the rays cast."""
    if packet.shape[1] != PACKET_WIDTH:  # tells the compiler
        return 0
    ints = packet.view(np.int32)
    waiting = 0
    x, y, z = w[0], w[1], w[2]
    for lane in range(PACKET_WIDTH):
        c = across[0, lane] * x + across[1, lane] * y + across[2, lane] * z
        valid = (alive[lane] != 0) & (c > _ZERO)
        cosine[lane] = c if valid else _ZERO
        ints[VALID, lane] = -1 if valid else 0
        waiting += valid
        packet[ORG_X, lane] = origin[0, lane]
        packet[ORG_Y, lane] = origin[1, lane]
        packet[ORG_Z, lane] = origin[2, lane]
        packet[DIR_X, lane] = x
        packet[DIR_Y, lane] = y
        packet[DIR_Z, lane] = z
        packet[T_NEAR, lane] = _ZERO
        packet[T_FAR, lane] = _FAR
    rays = 0
    while waiting > 0:
        rays += waiting
        occluded16(embree, packet, coherent)
        waiting = 0
        for lane in range(PACKET_WIDTH):
            if ints[VALID, lane] == 0:
                continue
            if packet[T_FAR, lane] < _ZERO:
                cosine[lane] = _ZERO
                ints[VALID, lane] = 0
            elif cross(box, packet, lane) != 0:
                ints[VALID, lane] = 0
            else:
                packet[T_FAR, lane] = _FAR
                waiting += 1
    return rays


@kernel(allocates=False)
def _go_on(embree, box, packet, origin, across, retreat, alive, bounces):
    """Take every lane along its direction to the facet it meets next; those that meet none are no more alive."""
    ints = packet.view(np.int32)
    waiting = 0
    for lane in range(PACKET_WIDTH):
        ints[VALID, lane] = alive[lane]
        waiting -= alive[lane]
        packet[ORG_X, lane] = origin[0, lane]
        packet[ORG_Y, lane] = origin[1, lane]
        packet[ORG_Z, lane] = origin[2, lane]
        packet[T_NEAR, lane] = _ZERO
        packet[T_FAR, lane] = _FAR
        ints[GEOM_ID, lane] = MISS
        ints[INST_ID, lane] = MISS
        ints[INST_PRIM_ID, lane] = MISS
    retreat[:, :] = np.nan
    rays = 0
    segments = 0
    while waiting > 0:
        intersect16(embree, packet, False)
        rays += waiting
        segments += 1
        arrive(box, packet, False, retreat, bounces)
        for lane in range(PACKET_WIDTH):
            if ints[VALID, lane] == 0:
                continue
            ends = False
            if ints[GEOM_ID, lane] == MISS:
                ends = packet[LEAVES, lane] == _ONE or cross(box, packet, lane) != 0
                if ends:
                    alive[lane] = 0
            elif packet[D_N, lane] >= _ZERO:
                # a facet's back: the step off the last facet ended behind it, or this one did
                if packet[T_FAR, lane] >= INSIDE * box.lift:
                    send_back(packet, lane, retreat)
            else:
                ends = True
                origin[0, lane], across[0, lane] = packet[ORG_X, lane], packet[NORMAL_X, lane]
                origin[1, lane], across[1, lane] = packet[ORG_Y, lane], packet[NORMAL_Y, lane]
                origin[2, lane], across[2, lane] = packet[ORG_Z, lane], packet[NORMAL_Z, lane]
            if not ends and segments >= MAX_SEGMENTS:
                ends = True
                alive[lane] = 0
            if ends:
                ints[VALID, lane] = 0
                waiting -= 1
            packet[T_FAR, lane] = _FAR
            ints[GEOM_ID, lane] = MISS
    return rays


@kernel
def pair(lit, seen, lattice, turn, sectors, by_row, by_ring, mix, rows, slots, cells):
    """Join all that points are lit by to all that they are seen by, in the cells of some rows.

    Parameters
    ----------
    lit : ndarray of float32, shape (G, P, rows * turns)
        From `look_around`, of G groups of P points; lights of a row stand together, a `turn` apart in azimuth.
    seen : ndarray of float32, shape (G, P, orders * B, rings * K)
        Detectors of a ring stand together, a sector apart.
    lattice : ndarray of int64, shape (G,)
        Azimuth of each group's first detector against the first light, in sectors.
    turn : int
        Sectors between lights of a row.
    sectors : int
        Of half the circle.
    by_row : ndarray, shape (rows,)
    by_ring : ndarray, shape (rings,)
        Energy in a cell for a product of the two, in each row and ring.
    mix : ndarray, shape (C, B)
        From the weights told apart in `seen` to the channels.
    rows : ndarray of int64, shape (I,)
        Which to do.
    slots : ndarray of int64, shape (rows,)
        Where a row's cells are.
    cells : ndarray, shape (slots, sheets, rings * sectors, C + 1)
        Added to; the last column counts points.
    """
    sums = np.empty(seen.shape[3], np.float32)
    _pair(lit, seen, lattice, turn, sectors, by_row, by_ring, mix, rows, slots, cells, sums)


@kernel(allocates=False)
def _pair(lit, seen, lattice, turn, sectors, by_row, by_ring, mix, rows, slots, cells, sums):
    groups, points, columns, detectors = seen.shape
    turns = lit.shape[2] // by_row.shape[0]
    rings = by_ring.shape[0]
    beside = detectors // rings
    channels, n_basis = mix.shape
    for g in range(groups):
        for row in rows:
            for j in range(turns):
                light = row * turns + j
                for column in range(columns):
                    order = column // n_basis
                    b = column - order * n_basis
                    sums[:] = _ZERO
                    for p in range(points):
                        a = lit[g, p, light]
                        if a > _ZERO:
                            for d in range(detectors):
                                sums[d] += a * seen[g, p, column, d]
                    for k in range(beside):
                        sector = (lattice[g] + k - j * turn) % (2 * sectors)
                        if sector >= sectors:
                            sector = 2 * sectors - 1 - sector
                        for ring in range(rings):
                            cell = ring * sectors + sector
                            value = sums[ring * beside + k] * by_row[row] * by_ring[ring]
                            for c in range(channels):
                                cells[slots[row], order, cell, c] += mix[c, b] * value
                            if b == 0:
                                cells[slots[row], order, cell, channels] += points
