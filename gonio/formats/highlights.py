"""Highlights of measured BRDFs that are narrower than cells of a degree, resampled on a finer grid.

As a trace does for rough metals, a reader of a format that can be evaluated anywhere gives such a highlight the
cells of a `gonio.table.peak.Peak`; the table's own cells there are averaged over more points, so that both hold
the same light.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import direction
from gonio.formats.cells import midpoints
from gonio.table.checks.resolution import narrow_rows
from gonio.table.peak import Peak, PeakGrid, grid_of, reached, row_angles, visible_points
from gonio.table.table import Table

Array = NDArray[np.float64]
Brdf = Callable[[float, Array, Array], Array]
"""From theta_i and angles theta_o, delta phi in [-pi, pi], shape (N,) each, radians, to f in 1/sr, shape (N, C)."""

_SLOPES = np.geomspace(1e-4, 1.0, 161)
_AZIMUTHS = (np.arange(8) + 0.5) * (np.pi / 4)
_LEAST_ROWS = 30  # a coarser table is of a file that knows no such highlight
_WIDEST = 0.1  # three cells of 3 degrees are an alpha of 0.05
_ANGLES_DEG = 25.0, 40.0  # where neither the light's own shadow nor the horizon is near
_CHECKED_DEG = 10.0, 30.0, 45.0, 60.0, 75.0, 80.0
_DIRECTIONS = 5000
_HALF = np.sqrt(np.log(2.0))  # a Gaussian exp(-s^2 / alpha^2) is halved there
_FINER = 0.5  # than a trace's grid: measured highlights are lopsided, and lean with theta_i
_INNER = 3  # rings more, each half as wide: some have a spike at the mirror direction
_SECTORS, _CROWDING = 32, 1.25  # across the plane of incidence, where what an instrument blurs is a streak
_WITHIN = 2, 3  # points of a cell of the grid, along the slope and around
_POINTS = 6  # along each side of a cell of the table, in theta_r and delta phi


def resolved(table: Table, brdf: Brdf) -> Table:
    """The table with its highlight on a grid of its own, where that is narrower than three cells in most rows.

    Wider ones are better off without: measured highlights are lopsided, and cells of a degree follow that.

    Parameters
    ----------
    table : Table
        Of rows that are cells of incidence.
    brdf : callable
        What it was sampled from.
    """
    if len(table.theta_i) < _LEAST_ROWS or np.mean(narrow_rows(table)) < 0.5:
        return table
    alpha = highlight_alpha(brdf)
    if alpha > _WIDEST:
        return table
    step = float(np.degrees(np.median(np.diff(table.theta_r_edges))))
    grid = _measured_grid(_FINER * alpha, step)
    assert table.theta_i_edges is not None
    values, g = table.values.copy(), np.zeros((len(table.theta_i), *grid.areas.shape, len(table.channels)))
    areas = table.projected_solid_angles
    for row, between in enumerate(zip(table.theta_i_edges[:-1], table.theta_i_edges[1:], strict=True)):
        inside = reached(between, table.theta_r_edges, table.delta_phi_edges, float(grid.slope_edges[-1]))
        values[row, inside] = 0.0
        for theta_i, share in row_angles(between):
            energy = _energies(brdf, theta_i, grid)
            g[row] += share * energy / grid.areas[..., None]
            within, around = _averages(brdf, theta_i, table, inside, float(grid.slope_edges[-1]))
            # few points find all of a narrow highlight; its own grid does
            found = areas[inside] @ within
            scale = np.divide(energy.sum(axis=(0, 1)), found, out=np.ones_like(found), where=found > 0)
            values[row, inside] += share * (within * scale + around)
    if table.gaps is not None:
        values[table.gaps] = 0.0
    albedo = np.einsum("irpc,rp->ic", values, areas)
    return table.replace(values=values, row_albedo=albedo, peak=Peak(g, *grid))


def _measured_grid(alpha: float, step_deg: float) -> PeakGrid:
    """Cells for a highlight of such facets, and for what measured ones have besides."""
    slopes = grid_of([alpha], step_deg).slope_edges
    inner = slopes[1] * 0.5 ** np.arange(_INNER, 0, -1)
    across = np.linspace(-1.0, 1.0, _SECTORS + 1)
    psi = 0.5 * np.pi * (1.0 + np.sign(across) * np.abs(across) ** _CROWDING)
    return PeakGrid(np.concatenate([[0.0], inner, slopes[1:]]), psi)


def resampling_error(table: Table, brdf: Brdf) -> tuple[float, float, float]:
    """How far a table is from what it was sampled from, between its cells too.

    Returns
    -------
    median, worst : float
        Over angles of incidence from 10 to 80 degrees: relative RMS difference of f cos(theta_o), over solid angle.
    at_deg : float
        Where the worst is.
    """
    rng = np.random.default_rng(0)
    found = []
    for angle in _CHECKED_DEG:
        theta_i = float(np.radians(angle))
        wi = np.broadcast_to(direction(theta_i), (_DIRECTIONS, 3))
        # half where the table has its light, half everywhere
        drawn, density = table.sample(wi, rng.random((_DIRECTIONS, 3)))
        u = rng.random((_DIRECTIONS, 2))
        even = direction(np.arcsin(np.sqrt(u[:, 0])), 2.0 * np.pi * u[:, 1])
        wo = np.concatenate([drawn[density > 0], even])
        cosine = np.maximum(wo[:, 2], 1e-6)
        density = 0.5 * (table.pdf(np.broadcast_to(direction(theta_i), wo.shape), wo) + cosine / np.pi)
        phi = np.arctan2(wo[:, 1], wo[:, 0])
        truth = 0.5 * sum(brdf(theta_i, np.arccos(cosine), side) for side in (phi, -phi))
        weight = (cosine**2 / density)[:, None]
        norm = np.sum(weight * truth**2)
        error = np.sum(weight * (table.eval(direction(theta_i), wo) - truth) ** 2)
        found.append(float(np.sqrt(error / norm)) if norm > 0 else 0.0)
    worst = int(np.argmax(found))
    return float(np.median(found)), found[worst], _CHECKED_DEG[worst]


def highlight_alpha(brdf: Brdf) -> float:
    """Roughness of a Gaussian as wide as the highlight is at half its height."""
    found = []
    for theta_i in np.radians(_ANGLES_DEG):
        h = direction(np.arctan(_SLOPES)[:, None], _AZIMUTHS)
        wi = direction(theta_i)
        cos_d = h @ wi
        wo = 2.0 * cos_d[..., None] * h - wi
        f = _look(brdf, float(theta_i), wo).mean(axis=-1)
        light = np.where(wo[..., 2] > 0.0, f * wo[..., 2] * cos_d * h[..., 2] ** 3, np.nan)
        line = np.nanmean(light, axis=1)
        line = line - np.nanmin(line)
        low = np.flatnonzero(line < 0.5 * line[0])
        found.append(_SLOPES[low[0]] / _HALF if len(low) else _SLOPES[-1])
    return float(min(found))


def _look(brdf: Brdf, theta_i: float, wo: Array) -> Array:
    """BRDF at directions, shape (..., 3), 0 below the horizon; shape (..., C)."""
    flat = wo.reshape(-1, 3)
    theta_o = np.arccos(np.clip(flat[:, 2], 1e-6, 1.0))
    f = brdf(theta_i, theta_o, np.arctan2(flat[:, 1], flat[:, 0]))
    return np.where(flat[:, 2:] > 0.0, f, 0.0).reshape(*wo.shape[:-1], -1)


def _energies(brdf: Brdf, theta_i: float, grid: PeakGrid) -> Array:
    """Energy that is reflected through each cell of slopes, shape (S, Q, C)."""
    points = visible_points(theta_i, *grid, *_WITHIN)
    psi = np.broadcast_to(points.psi, points.slope.shape)
    h = (direction(np.arctan(points.slope), side) for side in (psi, -psi))
    both = [_look(brdf, theta_i, 2.0 * points.cos_d[..., None] * each - direction(theta_i)) for each in h]
    return np.einsum("snqm,snqmc->sqc", 2.0 * points.measure * points.weight, both[0] + both[1])


def _averages(
    brdf: Brdf, theta_i: float, table: Table, cells: NDArray[np.bool_], extent: float
) -> tuple[Array, Array]:
    """Averages over some cells of the light from half-vector slopes up to `extent`, and of the rest; shape (N, C)."""
    rings, sectors = np.nonzero(cells)
    theta = np.arcsin(np.sqrt(midpoints(np.sin(table.theta_r_edges) ** 2, _POINTS)))[rings]
    phi = midpoints(table.delta_phi_edges, _POINTS)[sectors]
    theta, phi = np.broadcast_arrays(theta[:, :, None], phi[:, None, :])
    x, y, z = np.moveaxis(direction(theta_i) + direction(theta, phi), -1, 0)
    inside = (x**2 + y**2 <= (extent * z) ** 2).reshape(len(rings), -1, 1)
    one, other = (brdf(theta_i, theta.ravel(), side.ravel()) for side in (phi, -phi))
    f = (0.5 * (one + other)).reshape(*inside.shape[:2], -1)
    return (f * inside).mean(axis=1), (f * ~inside).mean(axis=1)
