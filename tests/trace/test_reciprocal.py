"""Binned tables averaged with light and detector exchanged: values, errors, what stays as it was counted."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.core.directions import projected_solid_angles
from gonio.table.checks.reciprocity import check_reciprocity
from gonio.table.table import Table
from gonio.trace.estimators import ANALOG, NEXT_EVENT
from gonio.trace.measure import measure
from gonio.trace.measurement import Measurement
from gonio.trace.reciprocal import reciprocal
from microgeometry.specimen import parse_specimen
from tests.trace import test_next_event

METAL = {"kind": "conductor", "eta": 1.0, "k": 2.0}
SURFACE = {
    "kind": "gaussian",
    "alpha": 0.7,
    "samples": 32,
    "size": 8,
}  # smoother ones have a peak of their own


def specimen(surface=SURFACE, material=METAL, **grid):
    keys = {"theta_step_deg": 10, "phi_step_deg": 15, **grid}
    return parse_specimen({"surface": surface, "material": material, "grid": keys})


def traced(spec, rays, seed=0, estimator=ANALOG):
    measurement = Measurement(spec, rays, seed, estimator=estimator)
    while not measurement.schedule.over:
        measurement.add_batch()
    table = measurement.table()
    return table, reciprocal(table, measurement.tally.rows.paths)


def made(first, second, hits, paths):
    """A table of two rows and rings whose off-diagonal cells hold these numbers of paths, and Poisson's errors."""
    edges = np.radians([0.0, 45.0, 90.0])
    phi = np.radians(np.linspace(0, 180, 401))
    counts = np.full((2, 2, 400), hits)
    counts[0, 1], counts[1, 0] = first, second
    areas = projected_solid_angles(edges, phi)
    exposure = np.asarray(paths)[:, None, None] * areas
    values = counts / exposure
    errors = np.where(counts > 0, np.sqrt(counts), 3) / exposure
    return Table(
        values=values[..., None], std_error=errors[..., None], hits=counts,
        theta_i=0.5 * (edges[1:] + edges[:-1]), theta_i_edges=edges, theta_r_edges=edges, delta_phi_edges=phi,
        channels=("grey",), row_albedo=np.einsum("irp,rp->i", values, areas)[:, None],
        albedo_std_error=np.full((2, 1), 1e-3), specular=np.zeros((2, 1)), specular_std_error=np.zeros((2, 1)),
        provenance={"batches": 1000},
    )  # fmt: skip


def test_sums_of_both_over_exposures_of_both():
    rng = np.random.default_rng(4)
    first, second = rng.poisson(30, 400), rng.poisson(90, 400)
    table = made(first, second, 50, [1000, 3000])
    found = reciprocal(table, np.array([1000, 3000]))
    share = found.values[0, 1, :, 0] / table.values[0, 1].mean()
    # rows are scaled to their albedo, so compare the shape
    expected = (first + second) / 4 / 30
    assert share / share.mean() == pytest.approx(expected / expected.mean(), rel=1e-9)
    assert found.values[1, 0] / found.values[1, 0].mean() == pytest.approx(
        found.values[0, 1] / found.values[0, 1].mean()
    )
    relative = found.std_error[0, 1, :, 0] / found.values[0, 1, :, 0]
    assert relative == pytest.approx(1 / np.sqrt(first + second), rel=0.05)
    assert np.array_equal(found.hits[0, 1], first + second)
    assert np.array_equal(found.row_albedo, table.row_albedo)
    assert np.array_equal(found.albedo_std_error, table.albedo_std_error)
    light = np.einsum("irpc,rp->ic", found.values, found.projected_solid_angles)
    assert light == pytest.approx(found.row_albedo, rel=1e-12)
    assert "averaged" in found.provenance["reciprocity"]
    # what is the same light twice is not judged again
    assert [c.passed for c in check_reciprocity(table)[:2]] == [True, True]
    assert [c.passed for c in check_reciprocity(found)] == [None, None]


def test_empty_cells_keep_a_bound_and_lone_paths_an_error():
    first, second = np.random.default_rng(1).poisson(40, (2, 400))
    first[0] = second[0] = first[1] = 0
    second[1] = 4
    table = made(first, second, 50, [1000, 1000])
    found = reciprocal(table, np.array([1000, 1000]))
    one = found.values[0, 1, 2, 0] / (first[2] + second[2])  # a path, of both rows
    assert found.values[0, 1, 0, 0] == 0
    assert found.std_error[0, 1, 0, 0] == pytest.approx(3 * one, rel=0.01)
    # its error is that of four paths; the empty partner's is taken to be the same, not its bound of three paths
    assert found.std_error[0, 1, 1, 0] == pytest.approx(np.sqrt(4 + 4) * one, rel=0.08)


def test_a_table_that_is_not_reciprocal_stays():
    table = made(np.full(400, 3000), np.full(400, 1000), 500, [1000, 1000])
    assert reciprocal(table, np.array([1000, 1000])) is table


@pytest.mark.compiled
def test_of_what_the_tracer_picks_and_not_of_what_it_is_told():
    spec = specimen(material={"kind": "dielectric", "eta": 1.5}, orders=2)
    told = measure(spec, rays=50_000, estimator=ANALOG)
    picked = measure(spec, rays=50_000)
    assert picked.provenance["estimator"] == ANALOG
    assert "reciprocity" in picked.provenance
    assert "reciprocity" not in told.provenance
    for quantity in ("row_albedo", "albedo_std_error", "specular", "specular_std_error"):
        assert np.array_equal(getattr(picked, quantity), getattr(told, quantity))
    assert not np.array_equal(picked.values, told.values)
    assert np.array_equal(picked.parts["transmission"].values, told.parts["transmission"].values)
    total = sum(picked.parts[name].values for name in ("L1", "L2+"))
    assert total == pytest.approx(picked.values, rel=1e-9, abs=1e-12)
    exact = measure(specimen({"kind": "v_groove", "slope_deg": 30}, theta_i_deg=[10, 50]), rays=20_000)
    assert "reciprocity" not in exact.provenance


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("surface", "rays"), [(SURFACE, 12_000), (SURFACE, 200_000), ({"kind": "flat"}, 12_000)]
)
def test_half_the_variance_and_intervals_that_cover(surface, rays):
    material = {"kind": "lambert", "albedo": 0.5} if surface["kind"] == "flat" else METAL
    runs = [traced(specimen(surface, material), rays, seed) for seed in range(20)]
    assert all(after is not before for before, after in runs)
    raw = np.array([before.values for before, _ in runs])[..., 0]
    truth = raw.mean(0)
    truth = 0.5 * (truth + truth.swapaxes(0, 1))
    values, errors = (np.array([getattr(t, a) for _, t in runs])[..., 0] for a in ("values", "std_error"))
    hits = np.mean([before.hits for before, _ in runs], axis=0)
    asked = (hits >= 3) & ~np.eye(9, dtype=bool)[..., None]
    square = [((v - truth) ** 2 * runs[0][0].projected_solid_angles)[:, asked].sum() for v in (raw, values)]
    assert 0.35 < square[1] / square[0] < 0.65
    # the pole's small cells gain from the large ones of its row that they are exchanged with, 7 times as large and more
    before, after = (np.mean([t.std_error[3:7, 0] for t in tables]) for tables in zip(*runs, strict=True))
    assert after < 0.6 * before
    assert_covered(values, errors, truth, asked)


def assert_covered(values, errors, truth, asked):
    """Between 93 and 97 % of intervals hold the truth, the mean of all runs; within three errors of that share."""
    runs = len(values)
    allowed = 1.96 * np.sqrt(1 - 1 / runs)
    share = [np.mean((np.abs(v - truth) <= allowed * e)[asked]) for v, e in zip(values, errors, strict=True)]
    mean, error = np.mean(share), np.std(share, ddof=1) / np.sqrt(runs)
    print(f"{mean:.3f} +- {error:.3f}")
    assert mean + 3 * error > 0.93
    assert mean - 3 * error < 0.97


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["gaussian", "forward"])
def test_next_event_estimates_are_weighed_by_their_errors(name):
    """Half the variance but for points that serve both rows, and for the counted energy of the row."""
    spec = test_next_event.specimen(*test_next_event.CASES[name], theta_i_deg=None)
    runs = [traced(spec, 4000, seed, NEXT_EVENT) for seed in range(30)]
    raw, values, errors = (
        np.array([getattr(t[n], a) for t in runs])[..., 0]
        for n, a in ((0, "values"), (1, "values"), (1, "std_error"))
    )
    truth = 0.5 * (raw.mean(0) + raw.mean(0).swapaxes(0, 1))
    asked = np.broadcast_to(~np.eye(len(truth), dtype=bool)[..., None], truth.shape)
    assert np.mean([after is not before for before, after in runs]) > 0.9
    square = [np.median((v.var(0, ddof=1) / truth**2)[asked]) for v in (raw, values)]
    print(f"{name}: {square[1] / square[0]:.3f} of the variance")
    assert square[1] < 0.75 * square[0]
    assert_covered(values, errors, truth, asked)


@pytest.mark.compiled
def test_next_event_estimates_below_a_mirror_stay():
    spec = test_next_event.specimen(*test_next_event.CASES["rayleigh"], theta_i_deg=None)
    before, after = traced(spec, 4000, 0, NEXT_EVENT)
    assert after is before
