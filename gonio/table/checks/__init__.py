"""Checks of a table against physics and against its own error bars.

Each check passes, fails, or only informs where a verdict is impossible (no error bars, or rows that do not
pair up). Verdicts by error bars use z-scores with one level for all comparisons of a check.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gonio.table.checks.reciprocity import check_reciprocity
from gonio.table.checks.report import Check, CheckReport
from gonio.table.parts import TRANSMISSION, orders_of
from gonio.table.table import Table
from gonio.validation import FALSE_ALARM, sidak

__all__ = ["Check", "CheckReport", "check", "relative_noise"]

Array = NDArray[np.float64]

_ROUNDING = 1e-9  # relative; of sums over the same paths in another order
_ENERGY = 0.99  # share of a row's reflectance whose cells count for the noise


def check(table: Table) -> CheckReport:
    """Run all checks on a table, whatever its origin.

    Parameters
    ----------
    table : Table

    Returns
    -------
    CheckReport
        Of reciprocity, energy, albedo against cells, parts, positivity, noise and ledger.
    """
    checks = [*check_reciprocity(table), _energy(table), _consistency(table)]
    transmission = table.parts.get(TRANSMISSION)
    if transmission is not None:
        checks.append(replace(_consistency(transmission), name="transmittance is the sum over cells"))
    for name, whole in (("the table", table), (TRANSMISSION, transmission)):
        if whole is not None and orders_of(whole):
            checks.append(_orders(whole, name))
    return CheckReport((*checks, _positivity(table), _noise(table), _ledger(table)))


def _limit(n: int) -> float:
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
    allowed = 1.0 + _limit(energy.size) * error + 1e-6
    worst = np.unravel_index(np.argmax(energy - allowed), energy.shape)
    passed = bool(np.all(energy <= allowed))
    detail = (
        f"largest {what} {energy.max():.6f}; closest to its limit {allowed[worst]:.6f} is "
        f"{energy[worst]:.6f} at theta_i = {np.degrees(table.theta_i[worst[0]]):.4g} deg, "
        f"channel {channels[worst[1]]}"
    )
    return Check("energy", passed, detail, {"albedo_max": table.row_albedo.max(), "energy_max": energy.max()})


def _consistency(table: Table) -> Check:
    """Stored albedo against the sum over cells and the delta term."""
    areas = table.projected_solid_angles
    total = np.einsum("irpc,rp->ic", table.values, areas) + table.specular
    variance = table.albedo_std_error**2 + table.specular_std_error**2
    if table.std_error is not None:
        variance = variance + np.einsum("irpc,rp->ic", table.std_error**2, areas**2)
    # without error bars the albedo may come from elsewhere (a TIS line, a compressed file's rounding)
    allowed = _limit(total.size) * np.sqrt(variance) + (1e-6 if table.std_error is not None else 1e-2) * total
    rows = np.ones(len(table.theta_i), bool) if table.gaps is None else ~table.gaps.any(axis=(1, 2))
    difference = np.abs(table.row_albedo - total)
    worst = float(difference[rows].max()) if rows.any() else 0.0
    passed = bool(np.all(difference[rows] <= allowed[rows])) if rows.any() else None
    detail = f"largest difference {worst:.3g} in {np.count_nonzero(rows)} rows without gaps"
    return Check("albedo is the sum over cells", passed, detail, {"largest_difference": worst})


def _orders(table: Table, name: str) -> Check:
    """Light of 1, 2, ... bounces against all of it: cells, rows and hits."""
    orders = orders_of(table)
    worst = 0.0
    for quantity in ("values", "row_albedo", "specular", "hits"):
        # each part is compressed on its own, within a bound that is no rounding
        if quantity == "values" and "compression" in table.provenance:
            continue
        if getattr(table, quantity) is None:
            continue
        terms = [getattr(order, quantity) for order in orders.values()]
        if any(term is None for term in (*terms, getattr(table, quantity))):
            continue
        difference = np.abs(sum(terms) - getattr(table, quantity))
        scale = sum(np.abs(term) for term in terms) + np.abs(getattr(table, quantity))
        worst = max(worst, float(np.max(difference / np.where(scale > 0, scale, 1.0))))
    detail = f"{' + '.join(orders)}: largest relative difference {worst:.2g}, allowed {_ROUNDING:g}"
    return Check(f"orders add up to {name}", worst <= _ROUNDING, detail, {"largest_difference": worst})


def _positivity(table: Table) -> Check:
    values, specular = table.values, table.specular
    error = np.zeros_like(values) if table.std_error is None else table.std_error
    if table.luminance is not None:
        values, specular, error = (
            values @ table.luminance,
            specular @ table.luminance,
            error @ abs(table.luminance),
        )
    negative = values < -_limit(values.size) * error - _ROUNDING * np.abs(table.values).max()
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
    return Check("noise", None, detail, {"median": float(np.median(noise)), "worst_row": float(noise.max())})


def relative_noise(table: Table) -> Array:
    """Median relative standard error per row and channel over the cells that hold 99 % of its energy.

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
    for row in range(n_rows):
        values = table.values[row].reshape(-1, n_channels)
        error = table.std_error[row].reshape(-1, n_channels)
        for c in range(n_channels):
            energy = values[:, c] * areas
            order = np.argsort(energy)[::-1]
            held = order[: np.searchsorted(np.cumsum(energy[order]), _ENERGY * energy.sum()) + 1]
            held = held[values[held, c] > 0]
            if len(held):
                out[row, c] = np.median(error[held, c] / values[held, c])
    return out


def _ledger(table: Table) -> Check:
    ledger = table.ledger
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
