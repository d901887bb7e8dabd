"""Checks of anisotropic tables against physics and against their own error bars."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import direction
from gonio.table.anisotropic import AnisotropicTable
from gonio.table.checks import check_ledger, limit
from gonio.table.checks.report import Check, CheckReport
from gonio.table.parts import TRANSMISSION
from gonio.table.tilts import slope_widths, to_tilts_many

Array = NDArray[np.float64]

_HELD = 0.99  # share of a row's energy whose cells count for the noise
_STEEPEST = np.radians(80.0)
_LIT = 0.02  # of the root mean square over all pairs
_INTERPOLATION = 0.03  # relative; by so much the two sides of a pair may differ because a cell is an average
_FLANKS = 0.005  # of the largest value; the same on the flanks of a narrow peak
_FEWEST = 20


def check_anisotropic(table: AnisotropicTable) -> CheckReport:
    """Run all checks on an anisotropic table.

    Returns
    -------
    CheckReport
        Of reciprocity, energy, albedo against cells, positivity, noise and ledger.
    """
    checks = [_reciprocity(table), _energy(table), _consistency(table), _positivity(table), _noise(table)]
    return CheckReport((*checks, check_ledger(table.ledger)))


def anisotropic_noise(table: AnisotropicTable) -> Array:
    """Median relative standard error per row and channel of the cells that hold 99 % of its energy.

    Returns
    -------
    ndarray, shape (T, P, C)
        0 for rows that reflect nothing.
    """
    if table.std_error is None:
        raise ValueError("anisotropic_noise: the table has no error bars")
    n_theta, n_phi, _, _, n_channels = table.energy.shape
    out = np.zeros((n_theta, n_phi, n_channels))
    for place in np.ndindex(out.shape):
        energy = table.energy[place[0], place[1], :, :, place[2]].ravel().astype(float)
        error = table.std_error[place[0], place[1], :, :, place[2]].ravel()
        order = np.argsort(-energy, kind="stable")
        sums = np.cumsum(energy[order])
        held = order[: np.searchsorted(sums, _HELD * sums[-1]) + 1]
        held = held[energy[held] > 0]
        if len(held):
            out[place] = np.median(error[held] / energy[held])
    return out


def _reciprocity(table: AnisotropicTable) -> Check:
    """f(i, o) = f(o, i) for all pairs of rows i and o, each seen in a cell of the other.

    The channel mean times both cosines, which no cell is too large for but those at the horizon: rows beyond 80
    degrees are left out, and what cells smear elsewhere is allowed for.
    """
    name = "reciprocity"
    if table.std_error is None:
        return Check(name, None, "no error bars")
    theta, phi = np.meshgrid(table.theta_i, table.phi_i, indexing="ij")
    # the normal counts once
    rows = np.flatnonzero((theta < _STEEPEST).ravel() & ((theta > 0).ravel() | (np.arange(theta.size) == 0)))
    wi = direction(theta, phi).reshape(-1, 3)[rows]
    n = len(rows)
    value, variance = np.empty((2, n, n))
    widths = slope_widths(table.tilt_x_edges, table.tilt_y_edges)
    sizes = np.outer(np.diff(table.tilt_x_edges), np.diff(table.tilt_y_edges))
    for k, (a, b) in enumerate(zip(*np.unravel_index(rows, theta.shape), strict=True)):
        there = np.ascontiguousarray(np.broadcast_to(wi[k], wi.shape))
        tilts = np.empty((n, 3))
        to_tilts_many(there, wi, widths, tilts)
        cell = tuple(
            np.clip(np.searchsorted(edges, tilts[:, axis], side="right") - 1, 0, len(edges) - 2)
            for axis, edges in enumerate((table.tilt_x_edges, table.tilt_y_edges))
        )
        value[k] = table.eval(there, wi).mean(axis=1) * wi[:, 2] * wi[k, 2]
        # a cell's energy over its size is a value's, times cos(theta_o) over the density of tilts
        error = table.std_error[a, b].mean(axis=-1)[cell] * tilts[:, 2] * wi[k, 2] / sizes[cell]
        variance[k] = error**2
    upper = np.triu_indices(n, 1)
    first, second = value[upper], value.T[upper]
    # pairs that hold light: elsewhere an error bar is an upper bound
    lit = first + second > 2 * _LIT * np.sqrt(np.mean(value**2))
    pairs = int(np.count_nonzero(lit))
    if pairs < _FEWEST:
        return Check(name, None, f"only {pairs} pairs of rows see each other's light")
    difference, mean = (first - second)[lit], 0.5 * (first + second)[lit]
    allowed = (
        (variance[upper] + variance.T[upper])[lit]
        + (_INTERPOLATION * mean) ** 2
        + (_FLANKS * value.max()) ** 2
    )
    chi2, limit_chi2 = float(np.mean(difference**2 / allowed)), 1.5 + 5.0 * np.sqrt(2.0 / pairs)
    detail = f"chi^2 per pair {chi2:.3f} over {pairs} pairs of rows, allowed {limit_chi2:.3f}"
    return Check(name, bool(chi2 < limit_chi2), detail, {"chi2": chi2, "pairs": float(pairs)})


def _energy(table: AnisotropicTable) -> Check:
    energy, error = table.row_albedo, table.albedo_std_error
    what = "albedo"
    if (transmission := table.parts.get(TRANSMISSION)) is not None:
        what = "albedo with transmittance"
        energy, error = energy + transmission.row_albedo, error + transmission.albedo_std_error
    if table.luminance is not None:  # red of gold is above 1, its luminance is not
        energy, error = (energy @ table.luminance)[..., None], (error @ np.abs(table.luminance))[..., None]
    allowed = 1.0 + limit(energy.size) * error + 1e-6
    a, b, _ = np.unravel_index(np.argmax(energy - allowed), energy.shape)
    detail = (
        f"largest {what} {energy.max():.6f}; closest to its limit at theta_i = "
        f"{np.degrees(table.theta_i[a]):.4g}, phi_i = {np.degrees(table.phi_i[b]):.4g} deg"
    )
    rows = {"theta_i_deg": np.degrees(table.theta_i).tolist(), "energy": energy.tolist()}
    return Check("energy", bool(np.all(energy <= allowed)), detail, {"energy_max": energy.max()}, rows)


def _consistency(table: AnisotropicTable) -> Check:
    total = table.energy.sum(axis=(2, 3), dtype=float) + table.specular
    difference = np.abs(total - table.row_albedo)
    # cells are float32
    passed = bool(np.all(difference <= 1e-5 * np.maximum(np.abs(table.row_albedo), 1e-6)))
    detail = f"largest difference {difference.max():.3g}"
    return Check("albedo is the sum over cells", passed, detail, {"largest_difference": difference.max()})


def _positivity(table: AnisotropicTable) -> Check:
    energy = table.energy.astype(float)
    error = np.zeros_like(energy) if table.std_error is None else table.std_error.astype(float)
    if table.luminance is not None:
        energy, error = energy @ table.luminance, error @ np.abs(table.luminance)
    count = int(np.count_nonzero(energy < -limit(energy.size) * error - 1e-9))
    detail = f"{count} of {energy.size} cells are negative beyond their error"
    return Check("positivity", count == 0, detail, {"negative": count, "lowest": energy.min()})


def _noise(table: AnisotropicTable) -> Check:
    if table.std_error is None:
        return Check("noise", None, "no error bars")
    noise = anisotropic_noise(table)
    detail = (
        f"median relative standard error {np.median(noise):.3g} of the cells that hold 99 % of the energy, "
        f"worst row {noise.max():.3g}"
    )
    return Check("noise", None, detail, {"median": float(np.median(noise)), "worst_row": float(noise.max())})
