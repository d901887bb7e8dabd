"""Checks of a table against physics and against its own error bars.

Each check passes, fails, or only informs where a verdict is impossible (no error bars, or rows that do not
pair up). Verdicts by error bars use z-scores with one level for all comparisons of a check.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gonio.table.table import Table
from gonio.validation import FALSE_ALARM, sidak

Array = NDArray[np.float64]

MIN_HITS = 20
"""Paths expected on each side of a comparison; cells with fewer are merged with their neighbours."""

# Error bars come from a finite number of batches and the noise of neighbouring cells is correlated, so a
# chi^2 somewhat above 1 is no proof of asymmetry however many cells there are.
_CHI2_LIMIT = {"cells": 1.25, "rings": 1.5}
_ENERGY = 0.99  # share of a row's reflectance whose cells count for the noise


@dataclass(frozen=True)
class Check:
    """One check.

    Parameters
    ----------
    name : str
    passed : bool or None
        None: for information, there is nothing to judge by.
    detail : str
        The finding in words.
    numbers : mapping of str to float
        The finding in numbers.
    """

    name: str
    passed: bool | None
    detail: str
    numbers: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class CheckReport:
    """What `check` found."""

    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """Whether no check failed."""
        return all(check.passed is not False for check in self.checks)

    def to_json(self) -> dict[str, Any]:
        """JSON-ready: ``passed``, and under ``checks`` per check its name, verdict, detail and numbers."""
        checks = {
            c.name: {"passed": c.passed, "detail": c.detail, **{k: float(v) for k, v in c.numbers.items()}}
            for c in self.checks
        }
        return {"passed": self.passed, "checks": checks}

    def lines(self) -> list[str]:
        """One readable line a check."""
        marks = {True: "ok  ", False: "FAIL", None: "info"}
        return [f"{marks[c.passed]} {c.name}: {c.detail}" for c in self.checks]


def check(table: Table) -> CheckReport:
    """Run all checks on a table, whatever its origin.

    Parameters
    ----------
    table : Table

    Returns
    -------
    CheckReport
        Of reciprocity, energy, albedo against cells, positivity, noise and ledger.
    """
    return CheckReport(
        (
            *_reciprocity(table),
            _energy(table),
            _consistency(table),
            _positivity(table),
            _noise(table),
            _ledger(table),
        )
    )


def _reciprocity(table: Table) -> list[Check]:
    paired = (
        table.theta_i_edges is not None
        and len(table.theta_i_edges) == len(table.theta_r_edges)
        and np.allclose(table.theta_i_edges, table.theta_r_edges, rtol=0, atol=1e-9)
    )
    if not paired:
        return [_asymmetry(*_interpolated_pairs(table), "rows are not the rings' cells: values interpolated")]
    rows, rings = np.triu_indices(len(table.theta_i), 1)
    if len(rows) == 0:
        return [Check("reciprocity", None, "a single row has no pairs to compare")]
    first, second = table.values[rows, rings], table.values[rings, rows]  # (pairs, P, C)
    if table.gaps is not None:
        known = ~(table.gaps[rows, rings] | table.gaps[rings, rows])[..., None]
        first, second = first * known, second * known
    areas = np.diff(np.sin(table.theta_r_edges) ** 2)
    weight = (areas[rows] * areas[rings])[:, None, None] * np.diff(table.delta_phi_edges)[:, None]
    size = _asymmetry(first, second, weight, "over all pairs of cells")
    if table.std_error is None:
        return [size]
    error = table.std_error
    if table.gaps is not None:
        error = np.where(table.gaps[..., None], 0.0, error)
    # sums over blocks of sectors: f times width of the sector
    width = np.diff(table.delta_phi_edges)[:, None]
    sums = (first * width, second * width)
    variances = tuple(
        np.where(f > 0, (e * width) ** 2, 0.0)
        for f, e in zip((first, second), (error[rows, rings], error[rings, rows]), strict=True)
    )
    # hits on either side are in proportion to the ring's projected solid angle
    share = np.minimum(areas[rows], areas[rings]) / (areas[rows] + areas[rings])
    batches = table.provenance.get("batches")
    freedom = float(batches) - 1 if isinstance(batches, (int, float)) and batches > 1 else np.inf
    found = [_compare(name, sums, variances, share, freedom) for name in ("cells", "rings")]
    level, n_channels = sidak(FALSE_ALARM, len(found)), len(table.channels)
    checks = []
    for name, chi2, expected, dof in found:
        # channels of one path are correlated, in the worst case copies of each other
        p = float(stats.chi2.sf(chi2 / expected / n_channels, dof / n_channels)) if dof else 1.0
        ratio = chi2 / (expected * dof) if dof else 0.0
        failed = p < level and ratio > _CHI2_LIMIT[name]
        checks.append(
            Check(
                f"reciprocity of {name}",
                None if dof == 0 else not failed,
                f"chi^2 per degree of freedom {ratio:.3f} of {dof} comparisons, p = {p:.2g}; "
                f"allowed {_CHI2_LIMIT[name]}",
                {"chi2_per_dof": ratio, "dof": dof, "p_value": p},
            )
        )
    return [*checks, size]


def _compare(
    name: str, sums: tuple[Array, ...], variances: tuple[Array, ...], share: Array, freedom: float
) -> tuple[str, float, float, int]:
    """Chi^2 of f(i, o) - f(o, i), what it is expected to be per comparison, and how many there are.

    Counts n1, n2 with exposures e1, e2 (f = n/e, variance n/e^2, hence e = f/variance, exact for unit
    weights however few the counts) are compared by z = (f1 - f2)/sqrt(f (1/e1 + 1/e2)) with f the pooled
    value: given n1 + n2 the split is binomial and E z^2 = 1 exactly, where error bars of the single counts
    would be too large or small by 1/n. Sectors are merged until MIN_HITS are expected on the poorer side;
    the rule looks at n1 + n2 only, which says nothing about their difference, so it adds no bias.
    """
    n_pairs, n_sectors, n_channels = sums[0].shape
    # effective hits, both sides together: (sum f)^2 / sum variance of each cell
    hits = np.zeros_like(sums[0])
    for f, v in zip(sums, variances, strict=True):
        hits += np.divide(f**2, v, out=np.zeros_like(f), where=v > 0)
    block = np.zeros((n_pairs, n_sectors, n_channels), np.int64)  # all sectors, unless cells are compared
    if name == "cells":
        needed = (MIN_HITS / share)[:, None]
        gathered, current = np.zeros((n_pairs, n_channels)), np.zeros((n_pairs, n_channels), int)
        for sector in range(n_sectors):
            block[:, sector] = current
            gathered += hits[:, sector]
            full = gathered >= needed
            current += full
            gathered[full] = 0.0
    lines = np.arange(n_pairs)[:, None, None] * n_channels + np.arange(n_channels)
    keys: NDArray = (lines * (n_sectors + 1) + block).ravel()
    merged: list[NDArray] = [
        np.bincount(keys, a.ravel()) for a in (*sums, *variances, hits, np.ones_like(hits))
    ]
    f1, f2, v1, v2, hits, cells = merged
    enough = np.repeat(np.repeat(MIN_HITS / share, n_channels), n_sectors + 1)[: len(hits)]
    # The last block of a line may be short of hits: the stopping rule drops it without looking at f1 - f2
    used = (hits >= enough) & (v1 > 0) & (v2 > 0)
    f1, f2, v1, v2, cells = f1[used], f2[used], v1[used], v2[used], cells[used]
    e1, e2 = f1 / v1, f2 / v2
    pooled = (e1 * f1 + e2 * f2) / (e1 + e2)
    z2 = (f1 - f2) ** 2 / (pooled * (1 / e1 + 1 / e2))
    # Variances estimated from few batches scatter: Student's t has the variance nu/(nu - 2)
    nu = 2.0 * freedom * cells
    scatter = nu / np.maximum(nu - 2.0, 0.5) if np.isfinite(freedom) else np.ones(len(cells))
    expected = float(scatter.mean()) if len(scatter) else 1.0
    return name, float(z2.sum()), expected, len(z2)


def _interpolated_pairs(table: Table) -> tuple[Array, Array, Array]:
    """Values of each row at the other rows' angles, linear in sin^2 theta_r: (pairs, P, C) both ways."""
    edges = np.sin(table.theta_r_edges) ** 2
    centres = 0.5 * (edges[1:] + edges[:-1])
    u_i = np.sin(table.theta_i) ** 2
    at = np.clip(np.interp(u_i, centres, np.arange(len(centres))), 0, len(centres) - 1)
    low = np.minimum(at.astype(int), max(0, len(centres) - 2))
    high = np.minimum(low + 1, len(centres) - 1)
    x = (at - low)[None, :, None, None]
    square = (1 - x) * table.values[:, low] + x * table.values[:, high]  # (I, I, P, C)
    rows, others = np.triu_indices(len(u_i), 1)
    weight = np.broadcast_to(np.diff(table.delta_phi_edges)[:, None], square.shape[2:])
    return square[rows, others], square[others, rows], np.broadcast_to(weight, (len(rows), *weight.shape))


def _asymmetry(first: Array, second: Array, weight: Array, how: str) -> Check:
    """Size of the difference, whatever the error bars."""
    scale = float(np.sum(weight * (0.5 * (first + second)) ** 2))
    difference = float(np.sum(weight * (first - second) ** 2))
    relative = float(np.sqrt(difference / scale)) if scale > 0 else 0.0
    detail = f"relative RMS difference of f(i, o) and f(o, i) {relative:.3g}, noise included ({how})"
    return Check("asymmetry", None, detail, {"relative_rms": relative})


def _limit(n: int) -> float:
    """Standard deviations allowed one-sided over n comparisons, never fewer than 4."""
    return max(4.0, float(stats.norm.isf(sidak(FALSE_ALARM, n))))


def _energy(table: Table) -> Check:
    allowed = 1.0 + _limit(table.row_albedo.size) * table.albedo_std_error + 1e-6
    worst = np.unravel_index(np.argmax(table.row_albedo - allowed), table.row_albedo.shape)
    passed = bool(np.all(table.row_albedo <= allowed))
    detail = (
        f"largest albedo {table.row_albedo.max():.6f}; closest to its limit {allowed[worst]:.6f} is "
        f"{table.row_albedo[worst]:.6f} at theta_i = {np.degrees(table.theta_i[worst[0]]):.4g} deg, "
        f"channel {table.channels[worst[1]]}"
    )
    return Check("energy", passed, detail, {"albedo_max": table.row_albedo.max()})


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


def _positivity(table: Table) -> Check:
    error = np.zeros(()) if table.std_error is None else table.std_error
    negative = table.values < -_limit(table.values.size) * error
    count = int(np.count_nonzero(negative)) + int(np.count_nonzero(table.specular < 0))
    detail = f"{count} of {table.values.size} values are negative beyond their error"
    return Check("positivity", count == 0, detail, {"negative": count, "lowest": table.values.min()})


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
    passed = abs(total - paths) <= 1e-9 * max(1.0, paths) and lost <= 1e-6 * paths
    detail = f"{total:.12g} of {paths:.12g} paths accounted for, lost {lost:.3g}, allowed {1e-6 * paths:.3g}"
    return Check("ledger", passed, detail, {"sum": total, "paths": paths, "lost": lost})
