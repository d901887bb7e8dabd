"""Reciprocity: f(i, o) = f(o, i), against the error bars of both.

A table of exact rows, or one without error bars, is only told how asymmetric it is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gonio.table.checks.report import Check
from gonio.table.parts import TRANSMISSION
from gonio.table.table import Table
from gonio.validation import FALSE_ALARM, sidak

Array = NDArray[np.float64]

MIN_HITS = 20
"""Paths expected on each side of a comparison; cells with fewer are merged with their neighbours."""

AVERAGED = "reciprocity"
"""Key in the provenance of a table averaged by reciprocity, which says how it passed the test before."""

# Error bars come from a finite number of batches and the noise of neighbouring cells is correlated, so a
# chi^2 somewhat above 1 is no proof of asymmetry however many cells there are.
_CHI2_LIMIT = {"cells": 1.25, "rings": 1.5}


def check_reciprocity(table: Table) -> list[Check]:
    """Chi^2 of cells and of rings where rows pair up with rings, and the size of the asymmetry."""
    if TRANSMISSION in str(table.provenance.get("part", "")).split("/"):
        return [Check("reciprocity", None, "of transmission, it would compare with light from below")]
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
    if AVERAGED in table.provenance:
        return [Check("reciprocity", None, str(table.provenance[AVERAGED])), size]
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
    # The error of a cell of few paths is that of as many as its neighbours expect, and a cell without any is left out
    # here: in sums each cell of few is to err by the paths it has
    counted = variances
    if table.hits is not None:
        counted = tuple(
            np.where(hits < MIN_HITS, (f * width) ** 2 / np.maximum(hits, 1), v)
            for f, v, hits in zip(
                (first, second),
                variances,
                (table.hits[rows, rings, :, None], table.hits[rings, rows, :, None]),
                strict=True,
            )
        )
    # hits on either side are in proportion to the ring's projected solid angle
    share = np.minimum(areas[rows], areas[rings]) / (areas[rows] + areas[rings])
    batches = table.provenance.get("batches")
    freedom = float(batches) - 1 if isinstance(batches, (int, float)) and batches > 1 else np.inf
    found = [_compare(name, sums, variances, counted, share, freedom) for name in ("cells", "rings")]
    level, n_channels = sidak(FALSE_ALARM, len(found)), len(table.channels)
    checks = []
    for name, chi2, expected, dof in found:
        if dof == 0:
            detail = f"no pair of {name} holds enough paths to compare"
            checks.append(Check(f"reciprocity of {name}", None, detail, {"dof": 0}))
            continue
        ratio = chi2 / (expected * dof)
        # Channels of one path are correlated, in the worst case copies of each other; and where paths are not
        # counted but estimates shared, so are all cells of a row
        independent = dof / n_channels
        if table.hits is None:
            independent = min(independent, len(table.theta_i))
        p = float(stats.chi2.sf(ratio * independent, independent))
        failed = p < level and ratio > _CHI2_LIMIT[name]
        checks.append(
            Check(
                f"reciprocity of {name}",
                not failed,
                f"chi^2 per degree of freedom {ratio:.3f} of {dof} comparisons, p = {p:.2g}; "
                f"allowed {_CHI2_LIMIT[name]}",
                {"chi2_per_dof": ratio, "dof": dof, "p_value": p},
            )
        )
    return [*checks, size]


def _compare(
    name: str,
    sums: tuple[Array, ...],
    variances: tuple[Array, ...],
    counted: tuple[Array, ...],
    share: Array,
    freedom: float,
) -> tuple[str, float, float, int]:
    """Chi^2 of f(i, o) - f(o, i), what it is expected to be per comparison, and how many there are.

    Counts n1, n2 with exposures e1, e2 (f = n/e, variance n/e^2, hence e = f/variance, exact for unit
    weights however few the counts) are compared by z = (f1 - f2)/sqrt(f (1/e1 + 1/e2)) with f the pooled
    value: given n1 + n2 the split is binomial and E z^2 = 1 exactly, where error bars of the single counts
    would be too large or small by 1/n. Sectors are merged until MIN_HITS are expected on the poorer side;
    the rule looks at n1 + n2 only, which says nothing about their difference, so it adds no bias.
    A block's variance is the sum of `variances`, or of `counted` if that is larger.
    """
    n_pairs, n_sectors, n_channels = sums[0].shape
    # effective hits, both sides together: (sum f)^2 / sum variance of each cell
    hits = np.zeros_like(sums[0])
    for f, v, least in zip(sums, variances, counted, strict=True):
        hits += np.divide(f**2, np.maximum(v, least), out=np.zeros_like(f), where=v > 0)
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
        np.bincount(keys, a.ravel()) for a in (*sums, *variances, *counted, hits, np.ones_like(hits))
    ]
    f1, f2, v1, v2, least1, least2, hits, cells = merged
    v1, v2 = np.maximum(v1, least1), np.maximum(v2, least2)
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
    """Values of each row at the other rows' angles, linear in sin^2 theta_r, and weights: (pairs, P, C) both ways.

    The weight is 0 where either value is in a gap, or beside one.
    """
    edges = np.sin(table.theta_r_edges) ** 2
    centres = 0.5 * (edges[1:] + edges[:-1])
    u_i = np.sin(table.theta_i) ** 2
    at = np.clip(np.interp(u_i, centres, np.arange(len(centres))), 0, len(centres) - 1)
    low = np.minimum(at.astype(int), max(0, len(centres) - 2))
    high = np.minimum(low + 1, len(centres) - 1)
    x = (at - low)[None, :, None, None]
    square = (1 - x) * table.values[:, low] + x * table.values[:, high]  # (I, I, P, C)
    gaps = np.zeros(table.values.shape[:3], bool) if table.gaps is None else table.gaps
    known = ~(gaps[:, low] & (x[..., 0] < 1) | gaps[:, high] & (x[..., 0] > 0))
    rows, others = np.triu_indices(len(u_i), 1)
    weight = (known[rows, others] & known[others, rows]) * np.diff(table.delta_phi_edges)
    return square[rows, others], square[others, rows], weight[..., None]


def _asymmetry(first: Array, second: Array, weight: Array, how: str) -> Check:
    """Size of the difference, whatever the error bars."""
    if not np.any(weight > 0):
        return Check("asymmetry", None, "no two rows see each other's direction")
    scale = float(np.sum(weight * (0.5 * (first + second)) ** 2))
    difference = float(np.sum(weight * (first - second) ** 2))
    relative = float(np.sqrt(difference / scale)) if scale > 0 else 0.0
    detail = f"relative RMS difference of f(i, o) and f(o, i) {relative:.3g}, noise included ({how})"
    return Check("asymmetry", None, detail, {"relative_rms": relative})
