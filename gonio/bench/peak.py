"""`gonio bench peak`: how well tables represent highlights of any width, their own noise apart.

A rough metal in closed form, f = F D G / (4 cos cos) of Beckmann facets, is averaged over the cells of a table
without any noise: those of one degree, and where alpha is below `WIDEST_ALPHA` those of the grid that a trace
gives to such a highlight. What the table makes of it between its cells is compared with the closed form where the
light is: in directions drawn in proportion to it, of which the farthest percent is left out.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from gonio.core.directions import direction, projected_solid_angles
from gonio.table.peak import Peak, PeakGrid, grid_of, visible_points
from gonio.table.table import Table
from gonio.trace.peak_grid import WIDEST_ALPHA

Array = NDArray[np.float64]

_ALPHAS = 0.005, 0.02, 0.04, 0.07, 0.1, 0.2, 0.4, 0.5
_ANGLES_DEG = 2, 45, 60, 75, 80, 85
_POINTS = 4  # of the quadrature, along each side of a cell
_DIRECTIONS = 100_000


def run(say: Callable[[str], None]) -> dict[str, Any]:
    """Measure; returns by alpha the errors at each angle, with and without a grid of the highlight's own."""
    found: dict[str, Any] = {"theta_i_deg": _ANGLES_DEG, "cells": {}, "grid": {}}
    say("relative RMS error between cells, %, by theta_i in degrees")
    say(f"{'alpha':>8}  {'grid':22}" + "".join(f"{angle:>10}" for angle in _ANGLES_DEG))
    for alpha in _ALPHAS:
        grids: dict[str, PeakGrid | None] = {"cells": None}
        if alpha < WIDEST_ALPHA:
            grids["grid"] = grid_of([alpha], 1.0)
        for name, grid in grids.items():
            errors = [
                relative_error(tabulated(alpha, np.arange(angle - 2, angle + 3), grid), alpha, angle)
                for angle in _ANGLES_DEG
            ]
            found[name][alpha] = errors
            label = "cells of one degree" if grid is None else "a grid of its own"
            say(f"{alpha:8g}  {label:22}" + "".join(f"{100 * error:10.2f}" for error in errors))
    return found


def rough_metal(wi: Array, wo: Array, alpha: float) -> Array:
    """f_r of Beckmann facets with Smith's correlated masking, 1/sr, 0 below the horizon; shape (...)."""
    x, y, z = np.moveaxis(wi + wo, -1, 0)
    length = np.sqrt(x**2 + y**2 + z**2)
    tan2, cos_h, cos_o = (x**2 + y**2) / z**2, z / length, np.maximum(wo[..., 2], 1e-9)
    fresnel = 0.9 + 0.1 * (1.0 - 0.5 * length) ** 5
    density = np.exp(-tan2 / alpha**2) / (np.pi * alpha**2 * cos_h**4)
    masking = 1.0 / (1.0 + _smith(wi[..., 2], alpha) + _smith(cos_o, alpha))
    return np.where(wo[..., 2] > 1e-9, fresnel * density * masking / (4.0 * wi[..., 2] * cos_o), 0.0)


def _smith(cosine: Array, alpha: float) -> Array:
    a = cosine / (alpha * np.sqrt(np.maximum(1.0 - cosine**2, 1e-12)))
    return 0.5 * (np.exp(-(a**2)) / (a * np.sqrt(np.pi)) - erfc(a))


def tabulated(alpha: float, rows_deg: NDArray[np.int64], grid: PeakGrid | None) -> Table:
    """Averages of `rough_metal` over cells of one degree, rows between `rows_deg`, and over a grid's."""
    edges, theta, phi = (np.radians(e) for e in (rows_deg, np.linspace(0, 90, 91), np.linspace(0, 180, 181)))
    values = np.zeros((len(edges) - 1, 90, 180, 1))
    peak = None if grid is None else Peak(np.zeros((len(values), *grid.areas.shape, 1)), *grid)
    sin2_i, weight = _gauss(np.sin(edges) ** 2)
    sin2, azimuth = _gauss(np.sin(theta) ** 2)[0], _gauss(phi)[0]
    wo = direction(np.arcsin(np.sqrt(sin2))[:, :, None, None], azimuth)
    each = "a,b,ranb->rn"
    g = None if peak is None else np.zeros(peak.values.shape)
    for row, squares in enumerate(sin2_i):
        for square, share in zip(squares, weight, strict=True):
            wi = direction(np.arcsin(np.sqrt(square)))
            values[row, ..., 0] += share * np.einsum(each, weight, weight, rough_metal(wi, wo, alpha))
            if peak is not None and g is not None:
                g[row, ..., 0] += share * _energies(wi, peak, alpha)
    if peak is not None and g is not None:
        peak = Peak(g, peak.slope_edges, peak.psi_edges)
        albedo = np.einsum("isqc,sq->ic", peak.values, peak.areas)
    else:
        albedo = np.einsum("irpc,rp->ic", values, projected_solid_angles(theta, phi))
    return Table(
        values=values,
        theta_i=0.5 * (edges[1:] + edges[:-1]),
        theta_i_edges=edges,
        theta_r_edges=theta,
        delta_phi_edges=phi,
        channels=("Y",),
        row_albedo=albedo,
        peak=peak,
    )


def _energies(wi: Array, peak: Peak, alpha: float) -> Array:
    """The mean g over a peak's cells, shape (S, Q)."""
    points = visible_points(float(np.arccos(wi[2])), peak.slope_edges, peak.psi_edges)
    h = direction(np.arctan(points.slope), points.psi)
    wo = 2.0 * points.cos_d[..., None] * h - wi
    g = 4.0 * rough_metal(wi, wo, alpha) * points.measure
    return (points.weight * g).sum(axis=(1, 3)) / peak.areas


def _gauss(edges: Array) -> tuple[Array, Array]:
    """Points on each interval, shape (n, points), and their weights, of sum 1."""
    x, w = np.polynomial.legendre.leggauss(_POINTS)
    return edges[:-1, None] + np.diff(edges)[:, None] * (0.5 + 0.5 * x), 0.5 * w


def relative_error(table: Table, alpha: float, angle_deg: float) -> float:
    """RMS of what the table adds to the closed form, relative, weighted by f cos(theta_o), about an angle."""
    rng = np.random.default_rng(0)
    low, high = np.sin(np.radians([angle_deg - 1.0, angle_deg + 1.0])) ** 2
    wi = direction(np.arcsin(np.sqrt(rng.uniform(low, high, _DIRECTIONS))))
    slope = alpha * np.sqrt(-np.log1p(-0.99 * rng.random(_DIRECTIONS)))
    h = direction(np.arctan(slope), rng.uniform(0.0, 2.0 * np.pi, _DIRECTIONS))
    cos_d = np.sum(wi * h, axis=1)
    wo = 2.0 * cos_d[:, None] * h - wi
    seen = (cos_d > 0) & (wo[:, 2] > 0)
    f = rough_metal(wi[seen], wo[seen], alpha)
    error = table.eval(wi[seen], wo[seen])[:, 0] / f - 1.0
    return float(np.sqrt(np.mean(error**2)))
