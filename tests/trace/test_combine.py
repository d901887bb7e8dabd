"""Tables of the half-vector estimator as a whole: single bounces and the rest, against binned paths."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from gonio.trace import combine
from gonio.trace.combine import _anchor
from gonio.trace.error_bars import cell_errors, term_errors
from gonio.trace.estimators import ANALOG, HALF_VECTOR
from gonio.trace.measure import measure
from gonio.trace.measurement import Measurement
from microgeometry.specimen import parse_specimen

METAL = {"kind": "conductor", "eta": [0.2, 1.0], "k": [3.9, 2.0]}


def specimen(**grid):
    surface = {"kind": "gaussian", "alpha": 0.5, "samples": 256, "size": 32}
    keys = {"wavelengths_nm": [500, 600], "theta_step_deg": 5, "phi_step_deg": 10, **grid}
    return parse_specimen({"surface": surface, "material": METAL, "grid": keys})


def total(table):
    return np.einsum("irpc,rp->ic", table.values, table.projected_solid_angles)


@pytest.mark.compiled
def test_orders_add_up_to_the_table_and_the_table_to_the_albedo():
    table = measure(specimen(orders=3), rays=200_000)
    assert table.provenance["estimator"] == HALF_VECTOR
    assert list(table.parts) == ["L1", "L2", "L3+"]
    for quantity in ("values", "row_albedo"):
        terms = sum(getattr(part, quantity) for part in table.parts.values())
        assert terms == pytest.approx(getattr(table, quantity), rel=1e-9)
    for part in (table, *table.parts.values()):
        assert total(part) == pytest.approx(part.row_albedo, rel=1e-9)
        assert part.hits is None
    assert not measure(specimen(), rays=50_000).parts


@pytest.mark.compiled
@pytest.mark.parametrize("grid", [{}, {"theta_step_deg": 3, "phi_step_deg": 6, "theta_i_deg": [10, 50, 80]}])
def test_cells_agree_with_binned_paths_within_their_error_bars(grid):
    spec = specimen(**grid)
    table = measure(spec, rays=500_000, seed=1)
    paths = measure(spec, rays=2_000_000, seed=2, estimator=ANALOG)
    many = paths.hits >= 25
    z2 = (table.values - paths.values) ** 2 / (table.std_error**2 + paths.std_error**2)
    # cells share facets, so their mean scatters more than that of so many independent ones
    assert 0.6 < np.mean(z2[many]) < 1.4
    z = (table.row_albedo - paths.row_albedo) / np.hypot(table.albedo_std_error, paths.albedo_std_error)
    assert np.abs(z).max() < 4
    errors = [np.median(t.std_error[many] / paths.values[many]) for t in (table, paths)]
    assert errors[0] < errors[1]


@pytest.mark.parametrize(
    ("hits", "own", "expected"), [(10_000, 0.5, 2.0), (10_000, 1e-4, 1.0), (1, 1e-3, 1.0)]
)
def test_a_block_follows_its_paths_as_far_as_these_know_it_better(hits, own, expected):
    """Two blocks of two cells; the paths found twice what the half vectors say."""
    areas = np.ones((1, 4))
    values = np.array([1.0, 2.0, 3.0, 4.0]).reshape(1, 1, 4, 1) / 10
    energy = 2 * np.array([0.3, 0.7]).reshape(1, 1, 2, 1)
    counted = SimpleNamespace(
        hits=np.full((1, 2), hits),
        cells=lambda areas: (energy / areas[..., None], energy / np.sqrt(hits) / areas[..., None]),
        energies=lambda: (energy.sum((1, 2)),),
    )
    batches = SimpleNamespace(areas=areas, bin_areas=np.full((1, 2), 2.0))
    found, error = values.copy(), own * values
    _anchor(found, error, counted, batches)
    assert found == pytest.approx(expected * values, rel=0.02)
    assert np.all(error <= 1.01 * own * values)


@pytest.mark.compiled
def test_paths_lessen_the_error_where_few_facets_see_out(monkeypatch):
    """At alpha 1 and 80 degrees to less than half the variance, measured; at alpha 0.5 and 30 degrees hardly at all."""
    surface = {"kind": "gaussian", "alpha": 1.0, "samples": 128, "size": 16}
    grid = {"theta_i_deg": [80], "theta_step_deg": 10, "phi_step_deg": 20}
    spec = parse_specimen(
        {"surface": surface, "material": {"kind": "conductor", "eta": 1.0, "k": 2.0}, "grid": grid}
    )
    values = []
    for seed in range(12):
        measurement = Measurement(spec, rays=100_000, seed=seed, estimator=HALF_VECTOR)
        for _ in range(8):
            measurement.add_batch()
        pair = [measurement.table().values]
        with monkeypatch.context() as patch:
            patch.setattr(combine, "_anchor", lambda *_: None)
            pair.append(measurement.table().values)
        values.append(pair)
    held, alone = np.moveaxis(values, 1, 0)
    bright = alone.mean(0) > 0.1 * alone.mean(0).max()
    ratio = held.var(0, ddof=1)[bright] / alone.var(0, ddof=1)[bright]
    assert np.median(ratio) < 0.7


@pytest.mark.parametrize("expected", [0.1, 1.0, 10.0])
def test_errors_of_a_sum_are_those_of_its_terms(expected):
    """Cells that expect few paths each, most of them none: the squares of their errors add up to the sum's own."""
    areas = np.ones((30, 60))
    rng = np.random.default_rng(3)
    claimed = []
    for _ in range(20):
        batches = rng.poisson(expected / 32, (32, *areas.shape))
        mean, variance = batches.mean(0) / 100, batches.var(0, ddof=1) / 32 / 100**2
        arguments = mean[..., None], variance[..., None], batches.sum(0), areas
        claimed.append(np.sum(term_errors(*arguments) ** 2))
    true = areas.size * expected / 32**2 / 100**2
    # a cell that has a path is given the error of one that expects 0.26 at least
    assert 0.9 < np.mean(claimed) / true < (1.4 if expected < 1 else 1.1)
    if expected < 1:
        assert np.sum(cell_errors(*arguments, 3200) ** 2) > 10 * true
