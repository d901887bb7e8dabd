"""The analog estimator: every path is binned in the cell it leaves through.

It assumes nothing; every other estimator is proven against it.
"""

from __future__ import annotations

import math

import numpy as np

from gonio.core.directions import cos_delta_phi
from gonio.core.embree import DIR_X, DIR_Y, DIR_Z, PACKET_WIDTH, new_packet
from gonio.core.jit import kernel
from gonio.core.lookup import find
from gonio.core.philox import uniforms
from gonio.trace.transport import KILLED, LOST, REFLECTED, start_packet, trace_packet

# Columns of a ledger row, in units of incident energy (mean over channels); RAYS counts Embree's rays.
LEDGER = ("reflected", "transmitted", "absorbed", "killed", "lost")
LEDGER_REFLECTED, LEDGER_TRANSMITTED, LEDGER_ABSORBED, LEDGER_KILLED, LEDGER_LOST, RAYS = range(6)
LEDGER_COLUMNS = 6


@kernel
def trace_unit(
    embree, box, coherent, eta_k, albedo, row, sin2_lower, sin2_upper, theta_axis, phi_axis, strata_x, strata_y,
    first, last, seed, batch, max_bounces, cells, specular, reflected, ledger,
):  # fmt: skip
    """Trace packets first ... last - 1 of the strata_x x strata_y of one row, binned by where they leave.

    Parameters
    ----------
    embree : Handle
    box : Box
    coherent : bool
        As in `trace_packet`.
    eta_k, albedo : ndarray or None
        As in `gonio.trace.scene.Optics`.
    row : int
        Index of the row: part of the random numbers' counter.
    sin2_lower, sin2_upper : float
        The row's range of sin^2 theta_i; directions are drawn uniformly in it, that is in proportion to
        projected solid angle. Equal bounds are one angle exactly.
    theta_axis, phi_axis : Axis
        Edges of sin^2 theta_r and of -cos(delta phi), both increasing.
    strata_x, strata_y : int
        Packets over the tile, powers of two with strata_y = strata_x or 2 strata_x (Morton order).
    first, last : int
        Which of them.
    seed, batch, max_bounces : int
    cells : ndarray, shape (R * P, C + 1)
        Added to: the sum of weights in each channel, and the number of paths, of each cell.
    specular, reflected : ndarray, shape (C,)
        Added to: energy in exactly the mirror direction; all energy reflected.
    ledger : ndarray, shape (LEDGER_COLUMNS,)
        Added to.
    """
    channels = specular.shape[0]
    sectors = phi_axis.edges.shape[0] - 1
    packets = strata_x * strata_y
    dx = box.width_x / (4 * strata_x)
    dy = box.width_y / (4 * strata_y)
    packet = new_packet()
    weight = np.empty((PACKET_WIDTH, channels))
    absorbed = np.zeros(channels)
    bounces = np.zeros(PACKET_WIDTH, np.int64)
    status = np.zeros(PACKET_WIDTH, np.int64)
    for k in range(first, last):
        path = (row * packets + k) * PACKET_WIDTH
        u, v, _, _ = uniforms(path, path >> 32, 0, 1, seed, batch)
        sin2_i = sin2_lower + u * (sin2_upper - sin2_lower)
        sin_i = math.sqrt(sin2_i)
        phi_i = 2.0 * math.pi * v
        wi = (sin_i * math.cos(phi_i), sin_i * math.sin(phi_i), math.sqrt(1.0 - sin2_i))
        i, j = _morton(k)
        start_packet(packet, wi, box.top, 4 * i * dx, 4 * j * dy, dx, dy, seed, batch, path)
        mirror_x, mirror_y = packet[DIR_X, 0], packet[DIR_Y, 0]
        ledger[RAYS] += trace_packet(
            embree, box, coherent, packet, eta_k, albedo, max_bounces, seed, batch, path,
            weight, bounces, status, absorbed,
        )  # fmt: skip
        for lane in range(PACKET_WIDTH):
            energy = weight[lane].sum() / channels
            if status[lane] == KILLED:
                ledger[LEDGER_KILLED] += energy
            elif status[lane] == LOST:
                ledger[LEDGER_LOST] += energy
            elif status[lane] == REFLECTED:
                ledger[LEDGER_REFLECTED] += energy
                x, y, z = packet[DIR_X, lane], packet[DIR_Y, lane], packet[DIR_Z, lane]
                for channel in range(channels):
                    reflected[channel] += weight[lane, channel]
                # a facet parallel to the macroscopic plane leaves these two components untouched, to
                # the bit; no other path ends so but by a chance of 1e-14
                if albedo is None and x == mirror_x and y == mirror_y:
                    for channel in range(channels):
                        specular[channel] += weight[lane, channel]
                    continue
                wo = (float(x), float(y), float(z))
                sin2_r = (wo[0] * wo[0] + wo[1] * wo[1]) / (wo[0] * wo[0] + wo[1] * wo[1] + wo[2] * wo[2])
                ring = find(theta_axis, sin2_r)
                cell = ring * sectors + find(phi_axis, -cos_delta_phi(wi, wo))
                for channel in range(channels):
                    cells[cell, channel] += weight[lane, channel]
                cells[cell, channels] += 1.0
    ledger[LEDGER_ABSORBED] += absorbed.sum() / channels


@kernel
def _morton(k):
    """Place of packet k: x from its odd bits, y from its even ones."""
    i = 0
    j = 0
    for bit in range(16):
        j |= ((k >> (2 * bit)) & 1) << bit
        i |= ((k >> (2 * bit + 1)) & 1) << bit
    return i, j
