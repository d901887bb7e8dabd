"""The measure that compression is held to: errors of rows, of albedo, and their noise."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.table.compress import cosine_weights, row_bounds, row_errors, row_noise
from gonio.table.compress.metric import albedo_errors, excess
from gonio.validation import seed_from
from tests.table.tables import ggx, grid, lambert, make
from tests.table.test_checks import poisson

pytestmark = pytest.mark.compiled

EDGES = grid(30, 30, 45)


def test_noise_is_measured_in_the_error_measure():
    """The table's scatter about the truth is what its error bars say, row by row."""
    rng = np.random.default_rng(seed_from("row noise"))
    truth = make(ggx(0.5, 0.9), EDGES, tint=(1.0,), cell_points=2)
    table = poisson(ggx(0.5, 0.9), rng, 3e6, EDGES)
    ratio = row_errors(table, truth.values) / row_noise(table)
    # 1350 cells a row, but a few bright ones can dominate: 10 % a row, less on average
    assert np.median(ratio) == pytest.approx(1, abs=0.05)


def test_excess_is_the_larger_of_brdf_and_albedo():
    """A veil under a peak: 1 % of the peak's norm, but several of its albedo."""
    table = make(ggx(0.05, 0.9), EDGES, tint=(1.0,), cell_points=2)
    bounds = np.full(table.row_albedo.shape, 0.01)
    veiled = table.values + 0.05
    assert np.all(albedo_errors(table, veiled)[:10] > 1.5 * row_errors(table, veiled)[:10])
    np.testing.assert_allclose(excess(table, veiled, bounds)[:10], 100 * albedo_errors(table, veiled)[:10])
    sign = np.where(np.arange(45) % 2, 1.0, -1.0)[:44, None]
    balanced = table.values.copy()
    balanced[:, :, :44] *= 1 + 0.02 * sign
    np.testing.assert_allclose(
        excess(table, balanced, bounds)[:10], 100 * row_errors(table, balanced)[:10], rtol=1e-12
    )


def test_albedo_errors_are_relative_and_see_cancellation():
    table = make(ggx(0.4, 0.9), EDGES, tint=(1.0, -0.5))
    np.testing.assert_allclose(albedo_errors(table, 1.02 * table.values), 0.02)
    # two halves of opposite sign: nothing in total, so a change is measured against what is there
    sign = np.where(np.arange(45) % 2, 1.0, -1.0)
    mixed = make(lambert, grid(4, 4, 44), tint=(1.0,))
    values = mixed.values * sign[:44, None]
    mixed = mixed.replace(values=values)
    changed = values + 0.001 * np.abs(values)
    np.testing.assert_allclose(albedo_errors(mixed, changed), 0.01)


def test_bounds_follow_the_noise():
    """Poisson noise of n like cells: the sum of squares scatters by sqrt(2/n), twice with error bars' own."""
    table = make(lambert, EDGES, tint=(1.0,))
    noisy = table.replace(std_error=0.2 * table.values)
    areas = table.projected_solid_angles
    cells = areas.sum() ** 2 / np.sum(areas**2)
    expected = 0.2 * np.sqrt(1 + 3 * np.sqrt(4 / cells))
    np.testing.assert_allclose(row_bounds(noisy, 0.01), expected)
    np.testing.assert_array_equal(row_bounds(noisy, 0.3), 0.3)
    np.testing.assert_array_equal(row_bounds(table, 0.01), 0.01)


def test_a_dark_channel_is_measured_against_a_tenth_of_the_brightest():
    """Red of a deep blue may be the small difference of large numbers."""
    table = make(ggx(0.4, 0.9), EDGES, tint=(1.0, 0.5, 0.01))
    np.testing.assert_allclose(row_errors(table, 1.02 * table.values), [[0.02, 0.02, 0.002]] * 30)
    np.testing.assert_allclose(albedo_errors(table, 1.02 * table.values), [[0.02, 0.02, 0.002]] * 30)


def test_metric_of_a_constant():
    """For f = 1 the squared norm is the projected solid angle of the hemisphere, pi."""
    weights = cosine_weights(EDGES[1], EDGES[2])
    assert np.sum(weights**2) == pytest.approx(np.pi)
