"""From a table with a peak to two functions: what stands above the level around the highlight, and the rest.

Where facets of slope s are, is asked of the highlight's light at s for every direction it leaves in. So what is
interpolated in slopes is not the energy g, which ends at the plane, but

    q = 4 f w,    w = `gonio.core.masking.masked_cosines`,

in which F(theta_d) D(s) is left, smooth over the plane's horizon and from row to row. Light is drawn in proportion
to g interpolated, which is f cos(theta_o) but for the cells that the horizon cuts: a weight f cos/pdf is 1.002 of its
mean at most up to theta_i = 75 degrees, 1.3 at 82 and 1.6 at 86 (the narrowest measured highlight, alpha 0.01).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.table.peak import Peak, reached, visible_points

if TYPE_CHECKING:
    from gonio.table.table import Table

Array = NDArray[np.float64]

_SEEN = 0.05  # of a cell's area that must be visible for its light to say what its facets reflect


class Highlight(NamedTuple):
    """A peak as it is interpolated."""

    peak: Peak
    energy: Array
    """(I, C) in it, of each row's."""
    drawn: Array
    """(I, S, Q, C) g, without the level."""
    shape: Array
    """(I, S, Q, C) q, without the level."""


def split(table: Table, peak: Peak) -> tuple[Array, Highlight]:
    """The table's values without its highlight, and this.

    The highlight is what stands above the level of f at the rim of its disc of slopes; the table's own cells in that
    disc are cut down to this level, so that their sum is continuous at the rim. Where the disc ends is then as
    good as anywhere in the smooth light, and the energy of what was cut is the peak's, which is known by itself.
    """
    values, drawn = table.values.copy(), np.zeros_like(peak.values)
    shape = np.full_like(drawn, np.nan)
    edges = table.theta_i_edges
    low, high = (table.theta_i, table.theta_i) if edges is None else (edges[:-1], edges[1:])
    areas = peak.areas
    for row in range(len(values)):
        between = low[row], high[row]
        seen = peak.visible(between)
        whole = seen.projected_solid_angles.sum(axis=1) > 0
        last = int(np.flatnonzero(whole)[-1])
        energy = peak.values[row] * areas[..., None]
        rim = np.maximum(energy[last].sum(axis=0), 0.0) / seen.projected_solid_angles[last].sum()
        light = np.maximum(energy - rim * seen.projected_solid_angles[..., None], 0.0)
        drawn[row] = light / areas[..., None]
        known = seen.area > _SEEN * areas
        shape[row, known] = light[known] / seen.light[known][:, None]
        inside = reached(between, table.theta_r_edges, table.delta_phi_edges, peak.extent)
        values[row, inside] = np.minimum(values[row, inside], rim)
    _fill(shape)
    taken = np.minimum(np.einsum("isqc,sq->ic", drawn, areas), table.row_albedo - table.specular)
    return values, Highlight(peak, taken, drawn, shape)


def _fill(shape: Array) -> None:
    """Cells below the plane: as beside them, nearer to the light; else as in the next row; else as the ring within."""
    rows, rings, sectors, _ = shape.shape
    for sector in range(1, sectors):
        lacking = np.isnan(shape[:, :, sector, 0])
        shape[:, :, sector][lacking] = shape[:, :, sector - 1][lacking]
    for row in range(rows - 2, -1, -1):
        lacking = np.isnan(shape[row, ..., 0])
        shape[row, lacking] = shape[row + 1, lacking]
    for ring in range(1, rings):
        lacking = np.isnan(shape[:, ring, :, 0])
        shape[:, ring][lacking] = shape[:, ring - 1][lacking]


def shape_energy(nodes: Array, u: Array, psi: Array, theta_i: float, peak: Peak) -> Array:
    """Energy that q, bilinear between its nodes, is reflected with at an angle.

    Parameters
    ----------
    nodes : ndarray, shape (U, P, C)
    u, psi : ndarray, shapes (U,) and (P,)
        Where they stand: u = (slope / extent)^2, and radians.
    theta_i : float
        Radians.
    peak : Peak

    Returns
    -------
    ndarray, shape (C,)
    """
    points = visible_points(theta_i, peak.extent * np.sqrt(u), psi)
    weight = points.weight * points.measure / points.masked_cosines(peak.alpha)
    x = (points.slope**2 / peak.extent**2 - u[:-1, None, None, None]) / np.diff(u)[:, None, None, None]
    y = (points.psi - psi[:-1, None]) / np.diff(psi)[:, None]
    total = np.zeros(nodes.shape[2])
    for along, to_u in ((slice(None, -1), 1.0 - x), (slice(1, None), x)):
        for around, to_psi in ((slice(None, -1), 1.0 - y), (slice(1, None), y)):
            share = (weight * to_u * to_psi).sum(axis=(1, 3))
            total += np.einsum("up,upc->c", share, nodes[along, around])
    return total


def bends_between(nodes: Array, u: Array, psi: Array, rows: Array, peak: Peak) -> Array:
    """How the energy of q, linear between rows in v = sin^2 theta_i, leaves a straight line.

    Parameters
    ----------
    nodes : ndarray, shape (I, U, P, C)
    u, psi : ndarray
        As `shape_energy`.
    rows : ndarray, shape (I,)
        Their v.
    peak : Peak

    Returns
    -------
    ndarray, shape (I - 1, 2, C)
        p and q of x (1 - x) (p + q x), x the fraction w from a row to the next. To grazing incidence x is that in
        cos theta_i, 1 - sqrt(1 - w): there the energy is smooth in the cosine, not in v.
    """

    def energy(v: float, q: Array) -> Array:
        return shape_energy(q, u, psi, float(np.arcsin(np.sqrt(v))), peak)

    ends = np.stack([energy(v, q) for v, q in zip(rows, nodes, strict=True)])
    bends = np.empty((len(rows) - 1, 2, nodes.shape[3]))
    for a in range(len(bends)):
        thirds = np.array([1.0 / 3.0, 2.0 / 3.0])
        third, two_thirds = (
            energy((1.0 - w) * rows[a] + w * rows[a + 1], (1.0 - w) * nodes[a] + w * nodes[a + 1])
            - ((1.0 - w) * ends[a] + w * ends[a + 1])
            for w in (thirds if rows[a + 1] < 1.0 else 1.0 - (1.0 - thirds) ** 2)
        )
        slope = 13.5 * (two_thirds - third)
        bends[a] = 4.5 * third - slope / 3.0, slope
    return bends
