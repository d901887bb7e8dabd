"""Highlights narrower than three cells are found, noise is not taken for one."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.table.checks import check
from gonio.table.checks.resolution import narrow_rows
from gonio.validation import seed_from
from tests.table.tables import asymmetric, ggx, grid, lambert, make
from tests.table.test_checks import poisson

EDGES = grid(45, 45, 90)  # cells of 2 degrees


@pytest.mark.parametrize(("alpha", "narrow"), [(0.005, True), (0.02, True), (0.2, False), (0.5, False)])
def test_width_of_ggx(alpha, narrow):
    """At normal incidence half the maximum is at tan(theta_h) = 0.64 alpha, theta_r = 2 theta_h.

    The width in theta_r, 2.6 alpha, is less than 6 degrees for alpha below 0.04, and not for 0.2.
    """
    rows = narrow_rows(make(ggx(alpha), EDGES, cell_points=8))
    # near the horizon foreshortening moves and widens the peak
    assert np.all(rows[2:35] == narrow)


def test_not_every_maximum_is_a_highlight():
    assert not narrow_rows(make(lambert, EDGES)).any()
    assert not narrow_rows(make(asymmetric, EDGES)).any()
    assert not narrow_rows(make(lambert, grid(1, 1, 1))).any()
    spike = make(lambert, EDGES)
    values = spike.values.copy()
    values[10, 30, -1] *= 100  # far from the mirror direction
    assert not narrow_rows(spike.replace(values=values)).any()
    values[10, 10, -1] *= 1000
    assert np.flatnonzero(narrow_rows(spike.replace(values=values))).tolist() == [10]


def test_gaps_are_no_highlight():
    """Measured in every third ring, and in two of the three sectors: what is between them is not dark."""
    smooth, sharp = (make(ggx(alpha), EDGES, cell_points=4) for alpha in (0.5, 0.005))
    gaps = np.ones(smooth.values.shape[:3], bool)
    rings = np.arange(45)
    for row in range(45):
        gaps[row, (rings - row) % 3 == 0, -2:] = False
    for table in (smooth, sharp):
        dark = table.replace(values=np.where(gaps[..., None], 0.0, table.values))
        assert narrow_rows(dark)[5:30].all()
        assert not narrow_rows(dark.replace(gaps=gaps)).any()
    gaps[:, :, -2:] = False
    assert narrow_rows(sharp.replace(gaps=gaps))[5:30].all()
    assert not narrow_rows(smooth.replace(gaps=gaps)).any()


@pytest.mark.parametrize("paths", [1e5, 1e7])
def test_noise_is_no_highlight(paths):
    rng = np.random.default_rng(seed_from(f"resolution {paths}"))
    assert not narrow_rows(poisson(ggx(0.3), rng, paths, EDGES)).any()
    assert narrow_rows(poisson(ggx(0.005), rng, 1e7, EDGES))[5:30].mean() > 0.9


def test_check_informs():
    found = next(
        c for c in check(make(ggx(0.01, 0.9), EDGES, cell_points=4)).checks if c.name == "resolution"
    )
    assert found.passed is None
    assert "narrower than 3 cells of 2 deg" in found.detail
    assert found.numbers["narrow_rows"] == len(found.rows["narrow_theta_i_deg"]) > 30
