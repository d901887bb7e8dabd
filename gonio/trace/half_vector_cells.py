"""Averages of the half-vector estimate over the cells of a table: kernels of `gonio.trace.half_vector`.

The visibility is a smooth correction rho to Smith's height-correlated masking and shadowing of a Beckmann
surface (Heitz 2014, "Understanding the masking-shadowing function in microfacet-based BRDFs", eq. 99):
V = rho / (1 + Lambda_i + Lambda_r). With P = (1 + Lambda) cos theta the estimate at a pair of directions is

    f1 = F D(theta_h) rho / (4 (P_i cos theta_r + P_r cos theta_i - cos theta_i cos theta_r)),

which is finite at the horizon. Only rho is interpolated.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.core.jit import kernel
from gonio.core.lookup import Axis, find
from gonio.core.masking import projected_area

Array = NDArray[np.float64]


class Model(NamedTuple):
    """What the estimate is made of."""

    step: float
    """Width of the bins of tilt, radians."""
    width: int
    """Of the average D in bins."""
    density: Array
    """(N,) D about each bin of tilt, averaged over `width` bins, 1/sr."""
    floor: Array
    """(N,) D that is likely not exceeded where no facet was met, 1/sr."""
    fresnel: Array
    """(M, C) reflectance at theta_d = m pi/2 / (M - 1) in each channel."""
    tilt: Axis
    opening: Axis
    turn: Axis
    """Nodes of theta_h, theta_d over its largest, phi_d; radians."""
    rho: Array
    """(A, B, P)"""
    batches: Array
    """(G,) in each group of them."""
    density_change: Array
    """(L, N, G) relative deviation of D over 2^level bins about each bin, from its mean, in each group."""
    rho_change: Array
    """(A, B, P, G) the same of rho."""


class Rule(NamedTuple):
    """Points and weights, which add up to 1, of a quadrature over each interval of an axis; shape (n, q)."""

    cosine: Array
    sine: Array
    projected: Array
    """P; unused for an azimuth."""
    weight: Array


def point_rule(theta: Array, alpha: float) -> Rule:
    """Exactly these angles."""
    return _rule(theta[:, None], np.ones((len(theta), 1)), alpha)


def polar_rule(edges: Array, points: int, alpha: float) -> Rule:
    """Averages over projected solid angle, sin theta cos theta d theta, between edges."""
    theta, weight = _gauss(edges, points)
    weight = weight * np.sin(2.0 * theta)
    return _rule(theta, weight / weight.sum(1, keepdims=True), alpha)


def azimuth_rule(edges: Array, points: int) -> Rule:
    """Averages over delta phi between edges."""
    phi, weight = _gauss(edges, points)
    return Rule(np.cos(phi), np.sin(phi), np.zeros(phi.shape), weight)


def _gauss(edges: Array, points: int) -> tuple[Array, Array]:
    """Gauss-Legendre points and weights, of sum 1, on each interval; shape (n, points) each."""
    x, w = np.polynomial.legendre.leggauss(points)
    half = 0.5 * np.diff(edges)[:, None]
    return edges[:-1, None] + half * (1.0 + x), np.tile(0.5 * w, (len(half), 1))


def _rule(theta: Array, weight: Array, alpha: float) -> Rule:
    cosine, sine = np.cos(theta), np.sin(theta)
    projected = [projected_area(alpha, c, s) for c, s in zip(cosine.flat, sine.flat, strict=True)]
    return Rule(cosine, sine, np.reshape(projected, theta.shape), weight)


@kernel(allocates=False)
def row_cells(model, row, fast, fine, spread, values, std_error):
    """Cell averages of one row.

    Parameters
    ----------
    model : Model
    row : int
    fast, fine : tuple of Rule
        For theta_i, theta_r and delta phi; `fine` is for cells over which theta_h varies by more than
        `spread`, near the horizon around the mirror direction.
    spread : float
        Radians.
    values : ndarray, shape (R * P, C)
        Set to the cell averages, 1/sr.
    std_error : ndarray, shape (R * P, C)
        Set to their standard errors; where no facet of such a tilt was ever met, to an upper bound.
    """
    rings, sectors = fast[1].cosine.shape[0], fast[2].cosine.shape[0]
    for ring in range(rings):
        for sector in range(sectors):
            cell = ring * sectors + sector
            average = _average(model, row, ring, sector, fast, values[cell], std_error[cell])
            if average[1] - average[0] > spread:
                average = _average(model, row, ring, sector, fine, values[cell], std_error[cell])
            _error(model, average, values[cell], std_error[cell])


@kernel(allocates=False)
def _average(model, row, ring, sector, rules, value, bound):
    """Average over one cell.

    Returns
    -------
    low, high : float
        Range of theta_h met.
    tilt : float
        Their mean, weighted by light.
    a, b, p, x, y, z
        Where among the nodes the last point lies.
    """
    incident, exitant, azimuth = rules
    value[:] = 0.0
    bound[:] = 0.0
    low, high = math.pi, 0.0
    total = tilt_sum = 0.0
    a = b = p = 0
    x = y = z = 0.0
    for q in range(incident.cosine.shape[1]):
        ci, si, pi = incident.cosine[row, q], incident.sine[row, q], incident.projected[row, q]
        for r in range(exitant.cosine.shape[1]):
            co, so, po = exitant.cosine[ring, r], exitant.sine[ring, r], exitant.projected[ring, r]
            shape = incident.weight[row, q] * exitant.weight[ring, r] / (4.0 * (pi * co + po * ci - ci * co))
            for s in range(azimuth.cosine.shape[1]):
                # |i + o| = 2 cos theta_d
                cos_d = math.sqrt(max(0.0, 0.5 * (1.0 + ci * co + si * so * azimuth.cosine[sector, s])))
                cos_h = min(1.0, 0.5 * (ci + co) / cos_d) if cos_d > 0.0 else 1.0
                tilt, theta_d = math.acos(cos_h), math.acos(min(1.0, cos_d))
                low, high = min(low, tilt), max(high, tilt)
                a, b, p, x, y, z = _locate(model, tilt, cos_h, theta_d, cos_d, abs(ci - co))
                weight = shape * azimuth.weight[sector, s] * _interpolate(model.rho, a, b, p, x, y, z)
                k, density = _density(model, tilt)
                total += weight * density
                tilt_sum += weight * density * tilt
                _reflect(model, theta_d, weight, density, model.floor[k], value, bound)
    tilt = tilt_sum / total if total > 0.0 else 0.5 * (low + high)
    return low, high, tilt, a, b, p, x, y, z


@kernel
def row_slopes(model, points, share, values, std_error):
    """Add to the energies of one row in the cells of a peak; a fresh row is 0.

    Parameters
    ----------
    model : Model
    points : tuple of ndarray
        Of `gonio.table.peak.Points` with tilts: tilt, cos_d, cos_o, cos_h, shape (S, n, Q, m), each point's energy
        where F D rho is 1, the same shape, and cos theta_i.
    share : float
        Of the row that this angle of incidence is.
    values, std_error : ndarray, shape (S * Q, C)
        Added to: energies in the cells, and their errors, or upper bounds where no facet was ever met.
    """
    tilts, cos_d, cos_o, cos_h, weights, cos_i = points
    rings, along, sectors, around = tilts.shape
    channels = values.shape[1]
    for ring in range(rings):
        for sector in range(sectors):
            cell = ring * sectors + sector
            value, bound = np.zeros(channels), np.zeros(channels)
            low, high = math.pi, 0.0
            total = tilt_sum = 0.0
            a = b = p = 0
            x = y = z = 0.0
            for n in range(along):
                for m in range(around):
                    at = ring, n, sector, m
                    if weights[at] <= 0.0:
                        continue
                    tilt, theta_d = tilts[at], math.acos(min(1.0, cos_d[at]))
                    low, high = min(low, tilt), max(high, tilt)
                    a, b, p, x, y, z = _locate(
                        model, tilt, cos_h[at], theta_d, cos_d[at], abs(cos_i - cos_o[at])
                    )
                    weight = share * weights[at] * _interpolate(model.rho, a, b, p, x, y, z)
                    k, density = _density(model, tilt)
                    total += weight * density
                    tilt_sum += weight * density * tilt
                    _reflect(model, theta_d, weight, density, model.floor[k], value, bound)
            if high < low:
                continue  # below the horizon
            tilt = tilt_sum / total if total > 0.0 else 0.5 * (low + high)
            _error(model, (low, high, tilt, a, b, p, x, y, z), value, bound)
            for c in range(channels):
                values[cell, c] += value[c]
                std_error[cell, c] += bound[c]


@kernel(allocates=False)
def _density(model, tilt):
    """The bin of tilt below, and D."""
    position = max(0.0, tilt / model.step - 0.5)
    k = min(int(position), model.density.shape[0] - 2)
    fraction = min(1.0, position - k)
    return k, model.density[k] + fraction * (model.density[k + 1] - model.density[k])


@kernel(allocates=False)
def _reflect(model, theta_d, weight, density, floor, value, bound):
    """Add light that is reflected at theta_d to `value`, and with the density `floor` to `bound`; shape (C,)."""
    position = theta_d * ((model.fresnel.shape[0] - 1) / (0.5 * math.pi))
    m = min(int(position), model.fresnel.shape[0] - 2)
    fraction = position - m
    for c in range(value.shape[0]):
        f = model.fresnel[m, c] + fraction * (model.fresnel[m + 1, c] - model.fresnel[m, c])
        value[c] += weight * density * f
        bound[c] += weight * floor * f


@kernel(allocates=False)
def _error(model, average, value, bound):
    """Put the standard error of `value` into `bound`, shape (C,), where a facet was met; `average` of `_average`."""
    low, high, tilt, a, b, p, x, y, z = average
    k = min(int(tilt / model.step), model.density.shape[0] - 1)
    level = int(math.log2(model.width + (high - low) / model.step))
    level = min(level, model.density_change.shape[0] - 1)
    variance = _variance(model, level, k, a, b, p, x, y, z)
    for c in range(value.shape[0]):
        if value[c] != 0.0:
            bound[c] = abs(value[c]) * math.sqrt(variance)


@kernel(allocates=False)
def _locate(model, tilt, cos_h, theta_d, cos_d, difference):
    """Cell of the nodes and place in it; `difference` is |cos theta_i - cos theta_r|."""
    sine_sine = math.sqrt(max(0.0, (1.0 - cos_h * cos_h) * (1.0 - cos_d * cos_d)))
    cos_turn = min(1.0, 0.5 * difference / sine_sine) if sine_sine > 0.0 else 0.0
    widest = math.atan2(cos_h, math.sqrt(1.0 - cos_h * cos_h) * cos_turn)
    a, x = _place(model.tilt, tilt)
    b, y = _place(model.opening, theta_d / widest)
    p, z = _place(model.turn, math.acos(cos_turn))
    return a, b, p, x, y, z


@kernel(allocates=False)
def _place(axis, value):
    """Interval of an axis and the place in it, 0 to 1; what lies beyond the axis is at its end."""
    i = find(axis, value)
    return i, min(1.0, max(0.0, (value - axis.edges[i]) / (axis.edges[i + 1] - axis.edges[i])))


@kernel(allocates=False)
def _interpolate(f, a, b, p, x, y, z):
    """Trilinear interpolation."""
    near = (1.0 - y) * ((1.0 - z) * f[a, b, p] + z * f[a, b, p + 1]) + y * (
        (1.0 - z) * f[a, b + 1, p] + z * f[a, b + 1, p + 1]
    )
    far = (1.0 - y) * ((1.0 - z) * f[a + 1, b, p] + z * f[a + 1, b, p + 1]) + y * (
        (1.0 - z) * f[a + 1, b + 1, p] + z * f[a + 1, b + 1, p + 1]
    )
    return (1.0 - x) * near + x * far


@kernel(allocates=False)
def _variance(model, level, k, a, b, p, x, y, z):
    """Relative variance of a cell's mean over all batches, from what each group of batches makes of D times rho."""
    total = squares = 0.0
    groups = model.batches.shape[0]
    for g in range(groups):
        change = model.density_change[level, k, g] + _interpolate(model.rho_change[..., g], a, b, p, x, y, z)
        total += model.batches[g]
        squares += model.batches[g] * change * change
    return squares / (max(groups - 1, 1) * total)
