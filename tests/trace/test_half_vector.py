"""The half-vector estimator against analog binning, cell by cell; its error bars; its limits."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.core.directions import projected_solid_angles
from gonio.trace.estimators import ANALOG, FEW_FACETS, HALF_VECTOR, NEXT_EVENT, choose
from gonio.trace.facets import BINS, STEP, measure_facets
from gonio.trace.half_vector import HalfVector
from gonio.trace.measurement import Measurement
from gonio.trace.peak_grid import PeakGrid
from gonio.trace.scene import TraceScene, pack_optics
from gonio.trace.tracer import _realisation_seed
from gonio.trace.visibility import Relief, measure_tilts
from microgeometry.errors import InputError
from microgeometry.specimen import parse_specimen

MIRROR = {"kind": "mirror"}
METAL = {"kind": "conductor", "eta": 0.2, "k": 3.9}
PATHS = 50_000  # a batch
COARSE = {"theta_step_deg": 15, "phi_step_deg": 30}


def specimen(alpha, material=METAL, kind="gaussian", samples=128, size=16, **grid):
    surface = {"kind": kind, "alpha": alpha, "samples": samples, "size": size}
    return parse_specimen(
        {"surface": surface, "material": material, "grid": {"channels": "grey", "orders": 2, **grid}}
    )


def estimate(spec, alpha, batches, seed=0, threads=None):
    estimator = HalfVector(pack_optics(spec.layers[0]), None, 1, alpha)
    for batch in range(batches):
        tile = spec.surface.realise(_realisation_seed(seed, batch, 0))
        estimator.add(measure_facets(tile, TraceScene([tile]), alpha, PATHS, seed, batch, threads))
    return estimator


def cells(estimator, table, threads=None):
    return estimator.cells(
        table.theta_i, table.theta_i_edges, table.theta_r_edges, table.delta_phi_edges, threads
    )


def analog(spec, rays):
    measurement = Measurement(spec, rays=rays, estimator=ANALOG)
    while not measurement.schedule.over:
        measurement.add_batch()
    return measurement.table().parts["L1"], measurement.tally.batches


CASES = [
    (0.1, {"theta_i_deg": [10, 45, 70, 85, 89.9], "theta_step_deg": 1, "phi_step_deg": 4}),
    (0.5, {"theta_step_deg": 5, "phi_step_deg": 10}),
    (1.0, {"theta_i_deg": [5, 40, 60, 80, 89], "theta_step_deg": 3, "phi_step_deg": 6}),
]


@pytest.mark.compiled
@pytest.mark.parametrize(("alpha", "grid"), CASES)
def test_chi2_of_all_cells_against_analog_binning(alpha, grid):
    one = compare(specimen(alpha, MIRROR, samples=256, size=32, **grid), alpha, rays=1_000_000)
    assert (one.peak is None) == (alpha > 0.45)


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.parametrize("rows", ["exact", "cells"])
@pytest.mark.parametrize("alpha", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("kind", ["gaussian", "exponential"])
def test_chi2_against_long_analog_runs(kind, alpha, rows):
    grid = {"theta_step_deg": 3, "phi_step_deg": 6}
    if rows == "exact":
        grid["theta_i_deg"] = [10, 30, 50, 70, 80, 88]
    compare(specimen(alpha, MIRROR, kind, samples=1024, size=128, **grid), alpha, rays=20_000_000)


def compare(spec, alpha, rays):
    """Counts by chi^2 in all cells, over the same surfaces.

    Mirrors: a path counts 1, and analog counts on given surfaces scatter like Poisson's where a cell gets light
    from many facets: near the horizon that takes large surfaces and not too many paths.
    """
    one, batches = analog(spec, rays)
    estimator = estimate(spec, alpha, batches)
    paths = one.hits.sum((1, 2)) / one.row_albedo[:, 0]
    agree(one.hits, *cells(estimator, one), one.projected_solid_angles, paths)
    if one.peak is not None:
        hits = one.peak.values[..., 0] * one.peak.areas * paths[:, None, None]
        grid = PeakGrid(one.peak.slope_edges, one.peak.psi_edges)
        agree(hits, *estimator.slopes(one.theta_i, one.theta_i_edges, grid), grid.areas, paths)
    return one


def agree(hits, values, std_error, areas, paths):
    hits = hits.reshape(len(paths), -1)
    values, std_error = values.reshape(hits.shape), std_error.reshape(hits.shape)
    counts = values * areas.ravel() * paths[:, None]
    relative = std_error / np.where(values > 0, values, np.inf)
    variance = counts + relative**2 * counts**2
    z2 = (hits - counts) ** 2 / np.maximum(variance, 1e-300)
    # enough paths for chi^2; and most of the noise theirs, for the cells of the estimate share its noise
    many = (counts >= 20) & (variance < 1.25 * counts)
    n = np.count_nonzero(many)
    assert n > 200
    assert 0.8 < np.mean(z2[many]) < 1 + 5 * np.sqrt(2 / n)
    # where no path fell there is no more light than that allows
    assert np.all(counts[hits < 0.5] < 15)


@pytest.mark.compiled
def test_furnace_every_row_holds_the_analog_albedo_of_one_bounce():
    spec = specimen(0.5, MIRROR, theta_i_deg=[0, 20, 40, 60, 75, 85], **COARSE)
    one, _ = analog(spec, 1_000_000)
    omega = one.projected_solid_angles.ravel()
    runs = np.array([omega @ cells(estimate(spec, 0.5, 8, seed), one)[0][..., 0].T for seed in range(8)])
    error = runs.std(0, ddof=1) / np.sqrt(8)
    t = (runs.mean(0) - one.row_albedo[:, 0]) / np.hypot(error, one.albedo_std_error[:, 0])
    assert np.all(np.abs(t) < 7)  # Student's, of 7 degrees of freedom: one in a thousand runs
    assert np.all(error[:5] < 0.03)


@pytest.mark.compiled
def test_furnace_smooth_mirrors_hold_all_light_in_one_bounce():
    """The average of D over tilts loses none, however many bins it takes."""
    spec = specimen(0.1, MIRROR, samples=256, size=32)
    estimator = estimate(spec, 0.1, 2)
    for step in (1, 2, 3, 6):
        theta, phi = np.radians(np.arange(0, 91, step)), np.radians(np.arange(0, 181, 2 * step))
        omega = projected_solid_angles(theta, phi).ravel()
        values, _ = estimator.cells(np.radians([1, 10, 30]), None, theta, phi)
        assert values[..., 0] @ omega == pytest.approx(1.0, abs=1e-3)


@pytest.fixture(scope="module")
def small():
    spec = specimen(0.3, samples=64, size=8, **COARSE)
    return spec, estimate(spec, 0.3, 6)


def grid_of(spec):
    theta = np.radians(np.linspace(0, 90, round(90 / spec.grid.theta_step_deg) + 1))
    phi = np.radians(np.linspace(0, 180, round(180 / spec.grid.phi_step_deg) + 1))
    return theta, phi


@pytest.mark.compiled
def test_cells_are_exactly_reciprocal(small):
    spec, estimator = small
    theta, phi = grid_of(spec)
    values, _ = estimator.cells(0.5 * (theta[1:] + theta[:-1]), theta, theta, phi)
    values = values.reshape(6, 6, 6)
    assert values == pytest.approx(values.swapaxes(0, 1), rel=1e-9)


@pytest.mark.compiled
def test_at_normal_incidence_all_azimuths_are_alike_and_at_grazing_all_is_finite(small):
    spec, estimator = small
    theta, phi = grid_of(spec)
    values, error = estimator.cells(np.radians([0, 89.9]), None, theta, phi)
    rings = values[0].reshape(6, 6)
    assert rings == pytest.approx(np.repeat(rings[:, :1], 6, axis=1), rel=1e-9)
    assert np.all(np.isfinite(values) & np.isfinite(error))
    assert np.all(error > 0)


@pytest.mark.compiled
def test_the_same_bits_for_any_number_of_threads(small):
    spec, _ = small
    theta, phi = grid_of(spec)
    one, two = (estimate(spec, 0.3, 3, threads=n).cells(theta[:-1], None, theta, phi, n) for n in (1, 2))
    for a, b in zip(one, two, strict=True):
        assert np.array_equal(a, b)


@pytest.mark.compiled
def test_groups_merge_without_losing_a_batch():
    spec = specimen(0.3, samples=32, size=8, **COARSE)
    theta, phi = grid_of(spec)
    estimator = estimate(spec, 0.3, 70)
    count = estimator._groups()[0]
    assert len(count) == 35
    assert count.sum() == 70
    # every facet of every realisation: the projected areas add up to the plane's
    tilt = STEP * (np.arange(BINS) + 0.5)
    assert np.sum(estimator._groups()[1] * np.cos(tilt)) / 70 == pytest.approx(1, rel=1e-4)
    values, error = estimator.cells(np.array([0.5]), None, theta, phi)
    brightest = values[0, :, 0].argmax()
    assert 0 < error[0, brightest, 0] < 0.1 * values[0, brightest, 0]


@pytest.mark.slow
@pytest.mark.compiled
def test_error_bars_are_the_scatter_of_independent_runs():
    spec = specimen(0.5, samples=64, size=8, **COARSE)
    theta, phi = grid_of(spec)
    angles = np.radians([10, 40, 60, 80])
    runs = [estimate(spec, 0.5, 16, seed).cells(angles, None, theta, phi) for seed in range(1, 41)]
    means = np.array([values for values, _ in runs])
    claimed = np.mean([error**2 for _, error in runs], axis=0)
    bright = means.mean(0) > 1e-3 * means.mean(0).max()
    ratio = means.var(0, ddof=1)[bright] / claimed[bright]
    assert 0.7 < np.median(ratio) < 1.4


def test_area_by_tilt_is_that_of_the_facets():
    tile = specimen(0.7, samples=32, size=8).surface.realise(1)
    normals, areas = tile.facets()
    nx, ny = tile.heights.shape
    relief = Relief(tile.heights, tile.size[0] / nx, tile.size[1] / ny, 0.0, 1.0)
    area, window_area = np.zeros(BINS), np.zeros(1)
    members = np.zeros(1, np.int64)
    tilts = np.empty((nx * ny, 2), np.float32)
    low, high = np.array([0.2]), np.array([0.4])
    measure_tilts(relief, 0, len(relief.heights), STEP, tilts, area, low, high, members, window_area)
    tilt = np.arccos(normals[:, 2])
    share = areas / (tile.size[0] * tile.size[1]) * 2 * nx * ny
    # a facet on the edge of a bin may fall on either side: compare sums up to each edge
    expected = np.cumsum(np.histogram(tilt, STEP * np.arange(BINS + 1), weights=share)[0])
    assert np.cumsum(area) == pytest.approx(expected, abs=3)
    assert area.sum() == pytest.approx(share.sum(), rel=1e-9)
    inside = (tilt >= 0.2) & (tilt < 0.4)
    assert abs(members[0] - np.count_nonzero(inside)) <= 1
    assert window_area[0] == pytest.approx(share[inside].sum(), abs=3)


def test_chosen_for_random_metal_that_is_not_too_smooth():
    lambert = specimen(0.5, {"kind": "lambert", "albedo": 0.5})
    smooth = specimen(0.01)
    groove = parse_specimen({"surface": {"kind": "v_groove", "slope_deg": 20}, "material": MIRROR})
    assert choose(specimen(0.5), 0) == HALF_VECTOR
    assert choose(specimen(0.5, MIRROR), 0) == HALF_VECTOR
    assert choose(specimen(0.5), 0, ANALOG) == ANALOG
    for spec, reason in ((lambert, "mirror or conductor"), (smooth, "alpha is 0.0"), (groove, "gaussian")):
        assert choose(spec, 0) == {id(lambert): NEXT_EVENT, id(groove): FEW_FACETS}.get(id(spec), ANALOG)
        with pytest.raises(InputError, match=reason):
            choose(spec, 0, HALF_VECTOR)
    with pytest.raises(InputError, match="one of analog, half-vector"):
        choose(lambert, 0, "guess")
