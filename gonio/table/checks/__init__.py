"""Checks of a table against physics and against its own error bars.

Each check passes, fails, or only informs where a verdict is impossible (no error bars, or rows that do not
pair up). Verdicts by error bars use z-scores with one level for all comparisons of a check.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gonio.table.checks.reciprocity import check_reciprocity
from gonio.table.checks.report import Check, CheckReport
from gonio.table.checks.resolution import check_resolution
from gonio.table.parts import TRANSMISSION, orders_of
from gonio.table.table import Table
from gonio.validation import FALSE_ALARM, sidak

__all__ = [
    "Check",
    "CheckReport",
    "check",
    "check_ledger",
    "limit",
    "map_noise",
    "noise_lines",
    "relative_noise",
]

Array = NDArray[np.float64]

_ROUNDING = 1e-9  # relative; of sums over the same paths in another order
_COMPRESSED = 1e-6  # the same, of albedos in a compressed file
_ENERGY = 0.99  # share of a row's reflectance whose cells count for the noise


def check(table: Table) -> CheckReport:
    """Run all checks on a table, whatever its origin.

    Parameters
    ----------
    table : Table

    Returns
    -------
    CheckReport
        Of reciprocity, energy, albedo against cells, parts, positivity, noise, resolution and ledger.
    """
    checks = [*check_reciprocity(table), _energy(table), _consistency(table)]
    transmission = table.parts.get(TRANSMISSION)
    if transmission is not None:
        checks.append(replace(_consistency(transmission), name="transmittance is the sum over cells"))
    for name, whole in (("the table", table), (TRANSMISSION, transmission)):
        if whole is not None and orders_of(whole):
            checks.append(_orders(whole, name))
    return CheckReport(
        (*checks, _positivity(table), _noise(table), check_resolution(table), check_ledger(table.ledger))
    )


def limit(n: int) -> float:
    """Standard deviations allowed one-sided over n comparisons, never fewer than 4."""
    return max(4.0, float(stats.norm.isf(sidak(FALSE_ALARM, n))))


def _energy(table: Table) -> Check:
    energy, error = table.row_albedo, table.albedo_std_error
    what = "albedo"
    if (transmission := table.parts.get(TRANSMISSION)) is not None:
        what = "albedo with transmittance"
        energy = energy + transmission.row_albedo
        error = error + transmission.albedo_std_error  # which bounds the sum's however they are correlated
    channels: tuple[str, ...] = table.channels
    if table.luminance is not None:  # red of gold is above 1, its luminance is not
        channels = ("luminance",)
        energy, error = (energy @ table.luminance)[:, None], (error @ np.abs(table.luminance))[:, None]
    allowed = 1.0 + limit(energy.size) * error + 1e-6
    worst = np.unravel_index(np.argmax(energy - allowed), energy.shape)
    passed = bool(np.all(energy <= allowed))
    detail = (
        f"largest {what} {energy.max():.6f}; closest to its limit {allowed[worst]:.6f} is "
        f"{energy[worst]:.6f} at theta_i = {np.degrees(table.theta_i[worst[0]]):.4g} deg, "
        f"channel {channels[worst[1]]}"
    )
    numbers = {"albedo_max": table.row_albedo.max(), "energy_max": energy.max()}
    rows = {
        "theta_i_deg": np.degrees(table.theta_i).tolist(),
        "energy_channels": list(channels),
        "energy": energy.tolist(),
        "allowed": allowed.tolist(),
    }
    return Check("energy", passed, detail, numbers, rows)


def _consistency(table: Table) -> Check:
    """Stored albedo against the sum over cells and the delta term."""
    areas = table.projected_solid_angles
    total = np.einsum("irpc,rp->ic", table.values, areas) + table.specular
    variance = table.albedo_std_error**2 + table.specular_std_error**2
    if table.std_error is not None:
        variance = variance + np.einsum("irpc,rp->ic", table.std_error**2, areas**2)
    # without error bars the albedo may come from elsewhere (a TIS line, a compressed file's rounding)
    allowed = limit(total.size) * np.sqrt(variance) + (
        1e-6 if table.std_error is not None else 1e-2
    ) * np.abs(total)
    rows = np.ones(len(table.theta_i), bool) if table.gaps is None else ~table.gaps.any(axis=(1, 2))
    difference = np.abs(table.row_albedo - total)
    worst = float(difference[rows].max()) if rows.any() else 0.0
    passed = bool(np.all(difference[rows] <= allowed[rows])) if rows.any() else None
    detail = f"largest difference {worst:.3g} in {np.count_nonzero(rows)} rows without gaps"
    return Check("albedo is the sum over cells", passed, detail, {"largest_difference": worst})


def _orders(table: Table, name: str) -> Check:
    """Light of 1, 2, ... bounces against all of it: cells, rows and hits."""
    orders = orders_of(table)
    worst, compressed = 0.0, "compression" in table.provenance
    allowed = _COMPRESSED if compressed else _ROUNDING
    for quantity in ("values", "row_albedo", "specular", "hits"):
        # each part is compressed on its own, within a bound that is no rounding
        if quantity == "values" and compressed:
            continue
        if getattr(table, quantity) is None:
            continue
        terms = [getattr(order, quantity) for order in orders.values()]
        if any(term is None for term in (*terms, getattr(table, quantity))):
            continue
        difference = np.abs(sum(terms) - getattr(table, quantity))
        scale = sum(np.abs(term) for term in terms) + np.abs(getattr(table, quantity))
        worst = max(worst, float(np.max(difference / np.where(scale > 0, scale, 1.0))))
    detail = f"{' + '.join(orders)}: largest relative difference {worst:.2g}, allowed {allowed:g}"
    return Check(f"orders add up to {name}", worst <= allowed, detail, {"largest_difference": worst})


def _positivity(table: Table) -> Check:
    values, specular = table.values, table.specular
    error = np.zeros_like(values) if table.std_error is None else table.std_error
    if table.luminance is not None:
        values, specular, error = (
            values @ table.luminance,
            specular @ table.luminance,
            error @ abs(table.luminance),
        )
    negative = values < -limit(values.size) * error - _ROUNDING * np.abs(table.values).max()
    count = int(np.count_nonzero(negative)) + int(np.count_nonzero(specular < -_ROUNDING))
    detail = f"{count} of {values.size} values are negative beyond their error"
    return Check("positivity", count == 0, detail, {"negative": count, "lowest": values.min()})


def _noise(table: Table) -> Check:
    if table.std_error is None:
        return Check("noise", None, "no error bars")
    noise = relative_noise(table)
    detail = (
        f"median relative standard error {np.median(noise):.3g} of the cells that hold 99 % of the energy, "
        f"worst row {noise.max():.3g}"
    )
    numbers = {"median": float(np.median(noise)), "worst_row": float(noise.max())}
    edges_i, edges_r, noise_map = map_noise(table)
    rows = {
        "map_theta_i_deg": np.degrees(edges_i).tolist(),
        "map_theta_r_deg": np.degrees(edges_r).tolist(),
        # JSON knows no NaN: where nothing was reflected stands null
        "map": [[None if np.isnan(n) else float(n) for n in line] for line in noise_map],
    }
    return Check("noise", None, detail, numbers, rows)


def map_noise(table: Table, width_deg: float = 10.0) -> tuple[Array, Array, Array]:
    """Where the table is how uncertain: relative standard error by blocks of theta_i and theta_r.

    Of a block, the root of the mean variance over the mean value, both weighted by projected solid angle, of
    all cells and of the mean over the channels' values: what a cell that holds its share of the energy has.

    Parameters
    ----------
    table : Table
        With error bars.
    width_deg : float
        Of a block, degrees, at least a ring or row of the table.

    Returns
    -------
    theta_i_edges, theta_r_edges : ndarray
        Of the blocks, radians.
    noise : ndarray, shape (blocks in theta_i, blocks in theta_r)
        NaN where nothing is reflected, or where no row lies.
    """
    if table.std_error is None:
        raise ValueError("map_noise: the table has no error bars")
    edges = np.radians(np.linspace(0.0, 90.0, max(1, round(90.0 / width_deg)) + 1))
    row = np.clip(np.searchsorted(edges, table.theta_i, side="right") - 1, 0, len(edges) - 2)
    ring = np.clip(np.searchsorted(edges, table.theta_r, side="right") - 1, 0, len(edges) - 2)
    areas = table.projected_solid_angles
    known = np.ones(table.values.shape[:3]) if table.gaps is None else ~table.gaps
    weight = known * areas
    # cells without hits carry an upper bound, not an error
    variance = np.where(table.values > 0, table.std_error, 0.0) ** 2
    sums = np.zeros((3, len(edges) - 1, len(edges) - 1))
    for k, quantity in enumerate((np.abs(table.values.mean(axis=3)), variance.mean(axis=3), known)):
        per_ring = np.einsum("irp,irp->ir", weight, quantity)
        np.add.at(sums[k], (row[:, None], ring[None, :]), per_ring)
    value, square = (np.divide(s, sums[2], out=np.zeros_like(s), where=sums[2] > 0) for s in sums[:2])
    return edges, edges, np.where(value > 0, np.sqrt(square) / np.where(value > 0, value, 1.0), np.nan)


def noise_lines(table: Table) -> list[str]:
    """The map of `map_noise` as lines of text: percent, a row a block of theta_i."""
    edges_i, edges_r, noise = map_noise(table)
    starts_i, starts_r = (np.degrees(edges[:-1]) for edges in (edges_i, edges_r))
    lines = ["relative standard error of a cell, %: theta_i down, theta_r across, from the angles given"]
    lines.append(" " * 6 + "".join(f"{start:6.0f}" for start in starts_r))
    for start, line in zip(starts_i, noise, strict=True):
        if np.any(np.isfinite(line)):
            lines.append(
                f"{start:6.0f}" + "".join(f"{100 * n:6.3g}" if np.isfinite(n) else "     -" for n in line)
            )
    return lines


def relative_noise(table: Table) -> Array:
    """Median relative standard error per row and channel over the cells that hold 99 % of its energy.

    Where a highlight has cells of its own, they count beside the table's.

    Returns
    -------
    ndarray, shape (I, C)
        0 for rows that reflect nothing.
    """
    if table.std_error is None:
        raise ValueError("relative_noise: the table has no error bars")
    n_rows, _, _, n_channels = table.values.shape
    out = np.zeros((n_rows, n_channels))
    areas = table.projected_solid_angles.ravel()
    fine = table.peak if table.peak is not None and table.peak.std_error is not None else None
    if fine is not None:
        areas = np.append(areas, fine.areas)
    for row in range(n_rows):
        values = table.values[row].reshape(-1, n_channels)
        error = table.std_error[row].reshape(-1, n_channels)
        if fine is not None and fine.std_error is not None:
            values = np.concatenate([values, fine.values[row].reshape(-1, n_channels)])
            error = np.concatenate([error, fine.std_error[row].reshape(-1, n_channels)])
        for c in range(n_channels):
            energy = values[:, c] * areas
            order = np.argsort(energy)[::-1]
            held = order[: np.searchsorted(np.cumsum(energy[order]), _ENERGY * energy.sum()) + 1]
            held = held[values[held, c] > 0]
            if len(held):
                out[row, c] = np.median(error[held, c] / values[held, c])
    return out


def check_ledger(ledger: Mapping[str, float]) -> Check:
    """Whether every path is accounted for, and hardly any lost."""
    if "paths" not in ledger:
        return Check("ledger", None, "the table has none: it was not traced")
    paths = float(ledger["paths"])
    ends = ("reflected", "transmitted", "absorbed", "killed", "lost")
    total = sum(float(ledger.get(end, 0.0)) for end in ends)
    lost = float(ledger.get("lost", 0.0))
    rounding = _ROUNDING * max(1.0, paths)
    passed = abs(total - paths) <= rounding and lost <= 1e-6 * paths
    detail = f"{total:.12g} of {paths:.12g} paths accounted for, lost {lost:.3g}, allowed {1e-6 * paths:.3g}"
    numbers = {"sum": total, "paths": paths, "lost": lost}
    absorbers = [float(energy) for name, energy in ledger.items() if name.startswith("absorbed: ")]
    if absorbers:
        numbers["absorbed_in_layers"] = sum(absorbers)
        passed = passed and abs(sum(absorbers) - float(ledger.get("absorbed", 0.0))) <= rounding
        detail += f"; {sum(absorbers):.12g} of {ledger.get('absorbed', 0.0):.12g} absorbed in layers"
    return Check("ledger", passed, detail, numbers)
