"""Cells that exits are told apart by, and sums that paths are added to where they end."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.core.embree import DIR_X, DIR_Y, DIR_Z, HIT_U, HIT_V, PACKET_WIDTH
from gonio.core.jit import kernel
from gonio.core.lookup import Axis, find
from gonio.table.tilts import to_tilts
from gonio.trace.transport import REFLECTED, TRANSMITTED

# Columns of a ledger row, in units of incident energy (mean over channels); RAYS counts Embree's rays. Then,
# for stacks of layers, what is absorbed at each layer's surface and in the medium below it. A path that
# ended with status s belongs to column s - 1.
LEDGER = ("reflected", "transmitted", "absorbed", "killed", "lost")
ABSORBED_COLUMN = LEDGER.index("absorbed")
RAYS = len(LEDGER)
LEDGER_COLUMNS = RAYS + 1


class Bins(NamedTuple):
    """How exits are told apart."""

    theta: Axis
    """Edges of sin^2 theta_r."""
    phi: Axis
    """Edges of -cos(delta phi)."""
    slope: Axis
    """Edges of the peak's half-vector slopes, where it has a grid of its own; see `gonio.table.peak`."""
    psi: Axis
    """Edges of -cos(psi)."""
    peak: int
    """First of the peak's cells, behind the others; -1: it has none."""
    orders: int
    """Numbers of bounces told apart; the last collects all beyond."""
    share: NDArray[np.float64]
    """(S,) weights that turn the energies of the samples into the mean over the table's channels."""
    widths: tuple[float, float]
    """Of an anisotropic table, whose `theta` and `phi` are edges of tilts (`gonio.table.tilts`): of slopes; else 0."""


class Sums(NamedTuple):
    """Where a unit of work adds its exits; see `gonio.trace.tally`."""

    cells: NDArray[np.float64]
    """(sheets, R * P + S * Q, C + 1): the sum of weights in each channel, and the number of paths, of each cell."""
    specular: NDArray[np.float64]
    """(sheets, C): energy in exactly the mirror direction, or straight through."""
    energy: NDArray[np.float64]
    """(sheets, C): all energy, the above included."""
    ledger: NDArray[np.float64]
    """(LEDGER_COLUMNS + ...,)"""


@kernel
def own_sums(sums):
    """Sums for one thread; the short ones apart, for threads that write to one cache line wait for each other."""
    return Sums(
        sums.cells, np.zeros_like(sums.specular), np.zeros_like(sums.energy), np.zeros_like(sums.ledger)
    )


@kernel(allocates=False)
def add_sums(own, sums):
    """Add what was summed apart."""
    # Number by number: numpy's sum of whole arrays takes 2 s more to compile, for its error message.
    for sheet in range(own.energy.shape[0]):
        for channel in range(own.energy.shape[1]):
            sums.specular[sheet, channel] += own.specular[sheet, channel]
            sums.energy[sheet, channel] += own.energy[sheet, channel]
    for column in range(own.ledger.shape[0]):
        sums.ledger[column] += own.ledger[column]


@kernel(allocates=False)
def coordinates(x, y, z, azimuth):
    """sin^2 theta_r and cos(delta phi) of a direction.

    `azimuth` is that of incidence, as (cos, sin); at normal incidence, where none is better, the one drawn.
    """
    across2 = x * x + y * y
    cosine = (azimuth[0] * x + azimuth[1] * y) / math.sqrt(across2) if across2 > 0.0 else 1.0
    return across2 / (across2 + z * z), cosine


@kernel(allocates=False)
def exits(packet, azimuth):
    """`coordinates` of all 16 paths at once, in the rows HIT_U and HIT_V."""
    if packet.shape[1] != PACKET_WIDTH:
        return
    azimuth = np.float32(azimuth[0]), np.float32(azimuth[1])
    for lane in range(PACKET_WIDTH):
        sin2, cosine = coordinates(packet[DIR_X, lane], packet[DIR_Y, lane], packet[DIR_Z, lane], azimuth)
        packet[HIT_U, lane] = sin2
        packet[HIT_V, lane] = cosine


@kernel(allocates=False)
def tilts_of(wi, widths, x, y, z):
    """Tilts x and -y of a direction, turned up at the plane if it leaves below: in place of `coordinates`."""
    scale = 1.0 / math.sqrt(x * x + y * y + z * z)
    tilt_x, tilt_y, _ = to_tilts(wi, (scale * x, scale * y, scale * abs(z)), widths)
    return tilt_x, -tilt_y


@kernel(allocates=False)
def exits_by_tilt(packet, wi, widths):
    """`tilts_of` of all 16 paths at once, in the rows HIT_U and HIT_V."""
    for lane in range(PACKET_WIDTH):
        x, y, z = packet[DIR_X, lane], packet[DIR_Y, lane], packet[DIR_Z, lane]
        packet[HIT_U, lane], packet[HIT_V, lane] = tilts_of(
            wi, widths, np.float64(x), np.float64(y), np.float64(z)
        )


@kernel(allocates=False)
def count_peak(to_channels, bins, sums, half, azimuth, bounces, weight):
    """Add a reflected path to the peak's cell that wi + wo = `half` falls in, if any."""
    x, y, z = half
    across = math.sqrt(x * x + y * y)
    if not across < bins.slope.edges[-1] * z:
        return
    cosine = (azimuth[0] * x + azimuth[1] * y) / across if across > 0.0 else 1.0
    sectors = bins.psi.edges.shape[0] - 1
    cell = bins.peak + find(bins.slope, across / z) * sectors + find(bins.psi, -cosine)
    sheet = max(0, min(bounces, bins.orders) - 1)
    channels = sums.energy.shape[1]
    for channel in range(channels):
        sums.cells[sheet, cell, channel] += _in_channel(to_channels, channel, weight)
    sums.cells[sheet, cell, channels] += 1.0


@kernel(inline=True, allocates=False)
def _in_channel(to_channels, channel, weight):
    """What the energies of the samples are in a channel of the table."""
    if to_channels is None:
        return weight[channel]
    w = 0.0
    for s in range(weight.shape[0]):
        w += to_channels[channel, s] * weight[s]
    return w


@kernel(inline=True, allocates=False)
def count_exit(to_channels, bins, sums, cell, status, bounces, delta, joined, weight):
    """Add what is left of one path (`weight`, shape (S,)) to where it ended, and to the cell it left through.

    In no cell, where it was joined to detectors.
    """
    energy = 0.0
    for s in range(weight.shape[0]):
        energy += bins.share[s] * weight[s]
    sums.ledger[status - 1] += energy
    if status != REFLECTED and status != TRANSMITTED:
        return
    sheet = min(bounces, bins.orders) - 1
    if sheet < 0:  # straight through layers that do nothing
        sheet = 0
    if status == TRANSMITTED:
        sheet += bins.orders
    channels = sums.energy.shape[1]
    if delta:
        _add_weight(to_channels, sums.specular[sheet], channels, weight)
    elif not joined:
        _add_weight(to_channels, sums.cells[sheet, cell], channels, weight)
        sums.cells[sheet, cell, channels] += 1.0
    _add_weight(to_channels, sums.energy[sheet], channels, weight)


@kernel(inline=True, allocates=False)
def _add_weight(to_channels, total, channels, weight):
    """Add the weights of the samples to those of the table's channels; the first apart: it may be alone."""
    total[0] += _in_channel(to_channels, 0, weight)
    for channel in range(1, channels):
        total[channel] += _in_channel(to_channels, channel, weight)


@kernel(inline=True, allocates=False)
def cell_of(bins, sin2, cosine):
    """Number of a cell from `coordinates`."""
    return find(bins.theta, sin2) * (bins.phi.edges.shape[0] - 1) + find(bins.phi, -cosine)
