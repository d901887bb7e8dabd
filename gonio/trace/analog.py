"""The analog estimator: every path is binned in the cell it leaves through.

It assumes nothing; every other estimator is proven against it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gonio.core.embree import DIR_X, DIR_Y, DIR_Z, HIT_U, HIT_V, PACKET_WIDTH, new_packet, new_ray
from gonio.core.jit import kernel
from gonio.core.philox import uniforms
from gonio.trace.binning import (
    ABSORBED_COLUMN,
    LEDGER_COLUMNS,
    RAYS,
    add_sums,
    cell_of,
    coordinates,
    count_exit,
    count_peak,
    exits,
    exits_by_tilt,
    own_sums,
    tilts_of,
)
from gonio.trace.interface import SCRATCH_ROWS
from gonio.trace.layered import trace_path
from gonio.trace.stack import UNIT, WIDTH_X, WIDTH_Y
from gonio.trace.stack_looks import (
    AZIMUTH_X,
    AZIMUTH_Y,
    SHIFT_AZIMUTH,
    SHIFT_RING,
    STATES,
    Eye,
)
from gonio.trace.start import start_packet
from gonio.trace.transport import REFLECTED, trace_packet

_SHIFT = 1 << 16  # dimension of the random numbers that no path uses
_PERIODS = 1 << 20  # so many tiles of the first layer a path may start over, against those of other periods


class Beam(NamedTuple):
    """Incident light of one row: directions uniform in sin^2 theta_i, that is in projected solid angle."""

    row: int
    """Part of the random numbers' counter."""
    sin2_lower: float
    sin2_upper: float
    """Equal bounds are one angle exactly."""
    azimuth: float = math.nan
    """Of all paths, radians; NaN: drawn for each, the specimen is turned at random."""


class Part(NamedTuple):
    """Which of a row's packets to trace: a stratum of the tile each, 16 paths in 4 x 4 strata of it."""

    strata_x: int
    strata_y: int
    """Powers of two with strata_y = strata_x or 2 strata_x (Morton order)."""
    first: int
    last: int
    """Strata first ... last - 1."""


@kernel
def trace_surface(
    embree, box, horizon, coherent, eta_k, albedo, to_channels, bins, beam, part, seed, batch, max_bounces, sums
):  # fmt: skip
    """Trace packets over one opaque surface and bin them by where they leave.

    Parameters
    ----------
    embree : Handle
    box : Box
    horizon : Horizon
    coherent : bool
        As in `trace_packet`.
    eta_k, albedo : ndarray or None
        As in `gonio.trace.scene.Optics`.
    to_channels : ndarray or None, shape (C, S)
        From the samples traced to the table's channels; None where they are the same.
    bins : Bins
    beam : Beam
    part : Part
    seed, batch, max_bounces : int
    sums : Sums
        Added to.
    """
    samples = bins.share.shape[0]
    weight = np.empty((PACKET_WIDTH, samples))
    polarisation = None if eta_k is None else np.empty((PACKET_WIDTH, samples, 3))
    axis = None if eta_k is None else np.empty((PACKET_WIDTH, 3))
    retreat = np.empty((3, PACKET_WIDTH), np.float32)
    bounces = np.zeros(PACKET_WIDTH, np.int64)
    status = np.zeros(PACKET_WIDTH, np.int64)
    absorbed = np.zeros(samples)
    own = own_sums(sums)
    _trace_packets(
        embree, box, horizon, coherent, eta_k, albedo, to_channels, bins, beam, part, seed, batch, max_bounces, own,
        new_packet(), weight, polarisation, axis, retreat, bounces, status, absorbed,
    )  # fmt: skip
    add_sums(own, sums)


# apart from its caller, so that numba counts no references to arrays in the loop
@kernel(allocates=False)
def _trace_packets(
    embree, box, horizon, coherent, eta_k, albedo, to_channels, bins, beam, part, seed, batch, max_bounces, sums,
    packet, weight, polarisation, axis, retreat, bounces, status, absorbed,
):  # fmt: skip
    packets = part.strata_x * part.strata_y
    dx = box.width_x / (4 * part.strata_x)
    dy = box.width_y / (4 * part.strata_y)
    ints = packet.view(np.int32)
    for k in range(part.first, part.last):
        path = (beam.row * packets + k) * PACKET_WIDTH
        u, v, _, _ = uniforms(path, path >> 32, 0, 1, seed, batch)
        wi, azimuth = _incident(beam, u, v)
        i, j = morton(k)
        start_packet(packet, wi, box, 4 * i * dx, 4 * j * dy, dx, dy, seed, batch, path)
        mirror_x, mirror_y, mirror_z = packet[DIR_X, 0], packet[DIR_Y, 0], packet[DIR_Z, 0]
        sums.ledger[RAYS] += trace_packet(
            embree, box, horizon, coherent, packet, eta_k, albedo, max_bounces, seed, batch, path,
            weight, polarisation, axis, retreat, bounces, status, absorbed,
        )  # fmt: skip
        if bins.widths[0] > 0.0:
            exits_by_tilt(packet, wi, bins.widths)
        else:
            exits(packet, azimuth)
        for lane in range(PACKET_WIDTH):  # all cells before the first is read: the caches' misses overlap
            ints[HIT_U, lane] = cell_of(bins, packet[HIT_U, lane], packet[HIT_V, lane])
        for lane in range(PACKET_WIDTH):
            x, y = packet[DIR_X, lane], packet[DIR_Y, lane]
            # a facet parallel to the macroscopic plane leaves these two components untouched, to the bit;
            # no other path ends so but by a chance of 1e-14
            delta = albedo is None and x == mirror_x and y == mirror_y
            count_exit(
                to_channels, bins, sums, ints[HIT_U, lane], status[lane], bounces[lane],
                delta, False, weight[lane],
            )  # fmt: skip
            if bins.peak >= 0 and status[lane] == REFLECTED and not delta:
                half = x - mirror_x, y - mirror_y, packet[DIR_Z, lane] - mirror_z
                count_peak(to_channels, bins, sums, half, azimuth, bounces[lane], weight[lane])
    for sample in range(absorbed.shape[0]):
        sums.ledger[ABSORBED_COLUMN] += bins.share[sample] * absorbed[sample]


@kernel
def trace_stack(
    zones, facets, tables, media, polarised, to_channels, looks, clear, bins, beam, part, seed, batch, max_bounces, sums
):  # fmt: skip
    """Trace paths through a stack of layers and bin them by where they leave, or join them to detectors.

    Parameters
    ----------
    zones : Zones
    facets : Facets
    tables : Pool or None
    media : Media
    polarised : bool
        As in `gonio.trace.stack.Stack`.
    looks : int or None
        As in `gonio.trace.stack_looks.Eye`; None: all paths are binned.
    clear : int
        From `gonio.trace.stack_looks.clear_zones`.
    to_channels, bins, beam, part, seed, batch, max_bounces, sums
        As in `trace_surface`.
    """
    samples = bins.share.shape[0]
    own = own_sums(sums)
    eye = None if looks is None else _open_eye(looks, clear, bins, beam, part, seed, batch, sums)
    _trace_paths(
        zones, facets, tables, media, polarised, to_channels, eye, bins, beam, part, seed, batch, max_bounces, own,
        new_ray(), np.empty((samples, 4)), np.empty(samples), np.empty((SCRATCH_ROWS, samples)),
        np.zeros(sums.ledger.shape[0] - LEDGER_COLUMNS),
    )  # fmt: skip
    add_sums(own, sums)


@kernel(allocates=False)
def _trace_paths(
    zones, facets, tables, media, polarised, to_channels, eye, bins, beam, part, seed, batch, max_bounces, sums,
    ray, light, weight, scratch, absorbed,
):  # fmt: skip
    packets = part.strata_x * part.strata_y
    # a plane has no period: start anywhere
    first = 0
    while first < zones.scene.shape[0] - 1 and zones.box[first, WIDTH_X] == math.inf:
        first += 1
    plane = zones.box[first, WIDTH_X] == math.inf
    width_x = 1.0 if plane else zones.box[first, WIDTH_X] * zones.box[first, UNIT]
    width_y = 1.0 if plane else zones.box[first, WIDTH_Y] * zones.box[first, UNIT]
    dx = width_x / (4 * part.strata_x)
    dy = width_y / (4 * part.strata_y)
    for k in range(part.first, part.last):
        i, j = morton(k)
        for lane in range(PACKET_WIDTH):
            path = (beam.row * packets + k) * PACKET_WIDTH + lane
            u, v, a, b = uniforms(path, path >> 32, 0, 0, seed, batch)
            x = (4 * i + lane // 4 + u) * dx + width_x * math.floor(a * _PERIODS)
            y = (4 * j + lane % 4 + v) * dy + width_y * math.floor(b * _PERIODS)
            u, v, _, _ = uniforms(path, path >> 32, 0, 1, seed, batch)
            wi, azimuth = _incident(beam, u, v)
            if eye is not None:
                eye.state[AZIMUTH_X], eye.state[AZIMUTH_Y] = azimuth
            status, wo, bounces, straight, joined, rays = trace_path(
                zones, facets, tables, media, bins.share, polarised, to_channels, eye, (-wi[0], -wi[1], -wi[2]), x, y,
                max_bounces, seed, batch, path, ray, light, scratch, absorbed,
            )  # fmt: skip
            sums.ledger[RAYS] += rays
            for s in range(weight.shape[0]):
                weight[s] = light[s, 0]
            if bins.widths[0] > 0.0:
                sin2, cosine = tilts_of(wi, bins.widths, wo[0], wo[1], wo[2])
            else:
                sin2, cosine = coordinates(wo[0], wo[1], wo[2], azimuth)
            joined = joined and status == REFLECTED
            cell = cell_of(bins, sin2, cosine)
            count_exit(to_channels, bins, sums, cell, status, bounces, straight, joined, weight)
            if bins.peak >= 0 and status == REFLECTED and not straight:
                half = wi[0] + wo[0], wi[1] + wo[1], wi[2] + wo[2]
                count_peak(to_channels, bins, sums, half, azimuth, bounces, weight)
    for column in range(absorbed.shape[0]):
        sums.ledger[LEDGER_COLUMNS + column] += absorbed[column]
        sums.ledger[ABSORBED_COLUMN] += absorbed[column]


@kernel
def _open_eye(looks, clear, bins, beam, part, seed, batch, sums):
    """Detectors of a unit of work, their sequence shifted at random."""
    state = np.zeros(STATES)
    packet = beam.row * part.strata_x * part.strata_y + part.first
    shift = uniforms(packet, packet >> 32, 0, _SHIFT, seed, batch)
    state[SHIFT_RING], state[SHIFT_AZIMUTH] = shift[0], shift[1]
    sectors = bins.phi.edges.shape[0] - 1
    light = np.zeros((bins.share.shape[0], 4))
    return Eye(looks, clear, bins.theta, sectors, bins.orders, sums.cells, state, light)


@kernel(allocates=False)
def _incident(beam, u, v):
    """Direction to the light from two uniform numbers, and (cos, sin) of its azimuth, even on the normal."""
    sin2 = beam.sin2_lower + u * (beam.sin2_upper - beam.sin2_lower)
    sine = math.sqrt(sin2)
    if not math.isnan(beam.azimuth):
        v = beam.azimuth / (2.0 * math.pi)
    azimuth = math.cos(2.0 * math.pi * v), math.sin(2.0 * math.pi * v)
    return (sine * azimuth[0], sine * azimuth[1], math.sqrt(1.0 - sin2)), azimuth


@kernel(allocates=False)
def morton(k):
    """Place of packet k: x from its odd bits, y from its even ones."""
    i = 0
    j = 0
    for bit in range(16):
        j |= ((k >> (2 * bit)) & 1) << bit
        i |= ((k >> (2 * bit + 1)) & 1) << bit
    return i, j
