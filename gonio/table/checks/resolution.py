"""Resolution: is the highlight wider than the cells it is tabulated in?

A peak narrower than three cells is known by its height and energy only: between the cells' centres its shape
is the interpolation's, and between rows it stands in two places at half the height.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.table.checks.report import Check
from gonio.table.table import Table

Array = NDArray[np.float64]

CELLS = 3.0
"""Full width at half maximum, in cells of theta_r, from which a peak counts as resolved."""

_SECTORS = 3  # about the plane of incidence, whose mean is looked at
_SIGMAS = 4.0
_NEAR = 3  # cells from the mirror direction within which a maximum is the highlight


def check_resolution(table: Table) -> Check:
    """Where the highlight is narrower than three cells; informs, as such a table is still right in its cells."""
    if (peak := table.peak) is not None:
        detail = (
            f"the highlight has {len(peak.slope_edges) - 1} x {len(peak.psi_edges) - 1} cells of its own, of "
            f"half-vector slopes up to {peak.extent:.3g}"
        )
        return Check("resolution", None, detail, {"narrow_rows": 0}, {"narrow_theta_i_deg": []})
    narrow = narrow_rows(table)
    count = int(np.count_nonzero(narrow))
    rows = {"narrow_theta_i_deg": np.degrees(table.theta_i[narrow]).tolist()}
    if count == 0:
        detail = f"no highlight is narrower than {CELLS:g} cells"
    else:
        step = np.degrees(np.median(np.diff(table.theta_r_edges)))
        detail = (
            f"the highlight is narrower than {CELLS:g} cells of {step:.3g} deg in {count} of {len(narrow)} rows, "
            f"from theta_i = {np.degrees(table.theta_i[narrow][0]):.4g} deg; between the cells' centres its shape "
            "is not known: trace it here, which gives it a finer grid, or with a smaller theta_step_deg"
        )
    return Check("resolution", None, detail, {"narrow_rows": count}, rows)


def narrow_rows(table: Table) -> NDArray[np.bool_]:
    """Rows whose highlight is narrower than three cells, beyond their error bars, shape (I,).

    In the plane of incidence, on the mirror side, the mean over three sectors is taken; at the maximum, if it
    stands near the mirror direction, the values two cells to either side are compared with half of it. Cells that
    nobody measured are left out.
    """
    known = np.ones((*table.values.shape[:3], 1)) if table.gaps is None else ~table.gaps[..., None]
    known = known[:, :, -_SECTORS:]
    count = known.sum(axis=(2, 3))
    sectors = np.maximum(count, 1)
    values = (known * table.values[:, :, -_SECTORS:]).mean(axis=3).sum(axis=2) / sectors
    error = np.zeros_like(values)
    if table.std_error is not None:
        # channels of one path are correlated: their errors add up, those of cells do not
        cells = np.where(known, table.std_error[:, :, -_SECTORS:], 0.0).mean(axis=3)
        error = np.sqrt(np.sum(cells**2, axis=2)) / sectors
    rings = values.shape[1]
    mirror = np.clip(np.searchsorted(table.theta_r_edges, table.theta_i, side="right") - 1, 0, rings - 1)
    narrow = np.zeros(len(values), bool)
    for row, (line, sigma) in enumerate(zip(values, error, strict=True)):
        near = np.arange(max(0, mirror[row] - _NEAR), min(rings, mirror[row] + _NEAR + 1))
        peak = int(near[np.argmax(line[near])])
        if line[peak] <= 0:
            continue
        sides = [ring for ring in (peak - 2, peak + 2) if 0 <= ring < rings and count[row, ring] > 0]
        drops = [
            0.5 * line[peak] - line[ring] > _SIGMAS * np.hypot(0.5 * sigma[peak], sigma[ring])
            for ring in sides
        ]
        narrow[row] = bool(sides) and all(drops)
    return narrow
