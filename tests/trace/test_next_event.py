"""Next-event estimates against analog binning and closed forms, cell by cell; their error bars; where they apply."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from gonio.table.table import Table
from gonio.trace.batch import BatchTracer, Job
from gonio.trace.cluster import trace_batch
from gonio.trace.estimators import ANALOG, FEW_FACETS, NEXT_EVENT, choose
from gonio.trace.measure import measure
from gonio.trace.measurement import Measurement
from microgeometry.errors import InputError
from microgeometry.specimen import parse_specimen
from tests.oracles import fresnel, half_space

FLAT = {"kind": "flat"}
WHITE = {"kind": "lambert", "albedo": 0.7}
GLASS = {"surface": FLAT, "material": {"kind": "dielectric", "eta": 1.5}}
OPEN = {"surface": FLAT, "material": {"kind": "none"}}
GROOVE = {"surface": {"kind": "v_groove", "slope_deg": 40}, "material": WHITE}
GRID = {"theta_step_deg": 10, "phi_step_deg": 20, "theta_i_deg": [5, 40, 80]}


def medium(**keys):
    return {"sigma_a": 0.2, "sigma_s": 0.8, "thickness": float("inf"), "units": "um", **keys}


def specimen(*layers, folder=".", **grid):
    keys = {name: value for name, value in {**GRID, **grid}.items() if value is not None}
    return parse_specimen({"layer": list(layers), "grid": keys}, folder)


RAYLEIGH_SLAB = (
    {**GLASS, "medium": medium(thickness=2.0, phase="rayleigh")},
    {"surface": FLAT, "material": {"kind": "dielectric", "eta": 1.0}},
)
PIGMENT = (
    {**GLASS, "medium": {"thickness": 100.0, "units": "um"}},
    {"surface": {"kind": "spheres", "cover": 0.6}, "material": WHITE},
)
CASES = {
    "grooves": (GROOVE,),
    "gaussian": (
        {"surface": {"kind": "gaussian", "alpha": 0.7, "samples": 64, "size": 16}, "material": WHITE},
    ),
    "overhangs": ({"surface": {"kind": "spheres", "cover": 0.6}, "material": WHITE},),
    "pits in a mirror": (
        {
            "surface": {"kind": "pits", "cover": 0.5, "depth": 1.0, "plane": {"kind": "mirror"}},
            "material": WHITE,
        },
    ),
    "pigment": PIGMENT,
    "rayleigh": RAYLEIGH_SLAB,
    "forward": ({**OPEN, "medium": medium(phase="hg", g=0.4)},),
    "rough glass below": (
        {**OPEN, "medium": medium(thickness=3.0)},
        {
            "surface": {"kind": "gaussian", "alpha": 0.3, "samples": 64, "size": 16},
            "material": {"kind": "dielectric", "eta": 1.5},
            "medium": medium(),
        },
    ),
}


def agree(table, paths, many):
    """Of two tables: no more scatter than their error bars allow, in all cells and in the albedo."""
    z = (table.values - paths.values) / np.hypot(table.std_error, paths.std_error)
    # next-event cells share points, so they scatter together
    assert 0.6 < np.mean(z[many] ** 2) < 1.4
    assert np.abs(z[many]).max() < 5
    error = np.hypot(table.albedo_std_error, paths.albedo_std_error)
    assert np.all(np.abs(table.row_albedo - paths.row_albedo) < 4 * error + 1e-9)


@pytest.mark.compiled
@pytest.mark.parametrize("name", CASES)
def test_cells_agree_with_binned_paths_within_their_error_bars(name):
    spec = specimen(*CASES[name], orders=2)
    table = measure(spec, rays=60_000, seed=1, estimator=NEXT_EVENT)
    paths = measure(spec, rays=240_000, seed=2, estimator=ANALOG)
    assert table.provenance["estimator"] == NEXT_EVENT
    assert set(table.parts) == set(paths.parts)
    agree(table, paths, paths.hits >= 25)
    for part, of_paths in zip(table.parts.values(), paths.parts.values(), strict=True):
        if np.any(of_paths.hits >= 25):
            agree(part, of_paths, of_paths.hits >= 25)
    total = np.einsum("irpc,rp->ic", table.values, table.projected_solid_angles) + table.specular
    assert total == pytest.approx(table.row_albedo, rel=1e-9)
    assert sum(table.parts[n].values for n in ("L1", "L2+")) == pytest.approx(table.values, rel=1e-9)
    assert table.hits is None


@pytest.mark.compiled
@pytest.mark.parametrize("name", CASES)
def test_every_path_is_counted_once(name):
    """Before it is scaled to it, what was joined and binned adds up to the energy of the paths, batch by batch."""
    measurement = Measurement(specimen(*CASES[name]), 300_000, seed=6, estimator=NEXT_EVENT)
    sheet = measurement.tally.totals[0]
    upto = [np.zeros(3)]
    for number in range(1, measurement.planned_batches + 1):
        measurement.add_batch()
        energy = sheet.spread_energies()[0]
        upto.append(number * (sheet._sum_mean - energy)[:, 0])
    excess = np.diff(upto, axis=0) / energy[:, 0]  # what joins light and what counts it share paths
    together = excess.mean(axis=1, keepdims=True)
    for found in (excess, together):
        error = found.std(axis=0, ddof=1) / np.sqrt(len(found))
        assert np.all(np.abs(found.mean(axis=0)) < 4 * error)
    assert error < 0.008  # 5 % would be seen


def centres(table):
    """Cosines of rows and of rings, the latter the mean over projected solid angle."""
    edges = table.theta_r_edges
    mean = 2 / 3 * -np.diff(np.cos(edges) ** 3) / np.diff(np.sin(edges) ** 2)
    return np.cos(table.theta_i)[:, None], mean[None, :]


@pytest.mark.compiled
def test_half_space_in_closed_form():
    table = measure(specimen({**OPEN, "medium": medium()}, theta_step_deg=5), rays=400_000)
    mu_i, mu_o = centres(table)
    expected = half_space.half_space(mu_i, mu_o, 0.8)[..., None]
    z = (table.values[..., 0] - expected) / table.std_error[..., 0]
    inner = slice(0, -1)  # over the last ring H is not straight
    assert 0.8 < np.mean(z[:, inner] ** 2) < 1.2
    assert np.median(table.std_error / table.values) < 0.03


@pytest.mark.compiled
def test_white_under_glass_in_closed_form():
    below = {"surface": FLAT, "material": WHITE}
    layers = {**GLASS, "medium": {"thickness": 10.0, "units": "um"}}, below
    measurement = Measurement(specimen(*layers, theta_step_deg=5), rays=200_000)
    for _ in range(measurement.planned_batches):
        measurement.add_batch()
    table = measurement.table()
    mu_i, mu_o = centres(table)
    expected = np.vectorize(fresnel.interfaced_lambert)(mu_i, mu_o, 1.5, 0.7)[..., None]
    albedo = [fresnel.interfaced_lambert_albedo(mu, 1.5, 0.7) for mu in np.cos(table.theta_i)]
    assert np.all(np.abs(table.row_albedo[:, 0] - albedo) < 4 * table.albedo_std_error[:, 0])
    # all cells of a row have the paths' error in common: compare what is left
    light = np.sum(expected * table.projected_solid_angles, axis=(1, 2))
    scale = light / (table.row_albedo - table.specular)[:, 0]
    energy, error = measurement.tally.totals[0].spread_energies()
    common = (error / energy)[:, 0]
    own = np.sqrt(table.std_error**2 - (table.values * common[:, None, None, None]) ** 2)[..., 0]
    z = (table.values[..., 0] * scale[:, None, None] - expected) / own
    inner = slice(0, 14)  # below 70 degrees Fresnel's law is nearly straight over a ring
    assert 0.7 < np.mean(z[:, inner] ** 2) < 1.3
    assert table.specular[0, 0] == pytest.approx(0.04, rel=0.05)


@pytest.mark.compiled
def test_flat_lambert_is_exact_and_grooves_hold_the_radiosity_solution():
    table = measure(specimen({"surface": FLAT, "material": WHITE}), rays=20_000)
    assert table.values == pytest.approx(0.7 / np.pi, rel=1e-5)
    # Fredholm's equation for an infinite V-groove, slope 30 degrees, albedo 0.8, light from above
    grooves = {
        "surface": {"kind": "v_groove", "slope_deg": 30},
        "material": {"kind": "lambert", "albedo": 0.8},
    }
    measurement = Measurement(specimen(grooves, theta_i_deg=[0]), rays=600_000, estimator=NEXT_EVENT)
    for _ in range(measurement.planned_batches):
        measurement.add_batch()
    sheet = measurement.tally.totals[0]  # before it is scaled to the albedo of the paths
    error = np.sqrt(measurement.tally.rows.variance_of_mean(sheet._sum_square))[0, 0]
    assert error < 0.01
    assert sheet._sum_mean[0, 0] == pytest.approx(0.77553, abs=4 * error)


@pytest.mark.compiled
def test_colours_are_carried_apart():
    grey, colours = (
        measure(
            specimen({**GROOVE, "material": {"kind": "lambert", "albedo": a}}, wavelengths_nm=[500, 600]),
            rays=20_000,
        )
        for a in ([0.7, 0.7], [0.7, 0.2])
    )
    assert colours.values[..., 0] == pytest.approx(grey.values[..., 0], rel=0.02)
    assert colours.values[..., 1].max() < 0.5 * grey.values[..., 1].max()


@pytest.mark.slow
@pytest.mark.compiled
def test_a_table_of_facets_scatters_like_what_it_is_a_table_of(tmp_path):
    white = measure(specimen({"surface": FLAT, "material": WHITE}, theta_i_deg=[0, 30, 60, 89]), rays=20_000)
    white.save(tmp_path / "white.h5")
    facets = {"kind": "table", "file": "white.h5"}
    assert isinstance(Table.load(tmp_path / "white.h5"), Table)
    table = measure(specimen({**GROOVE, "material": facets}, folder=tmp_path), rays=40_000, seed=3)
    assert table.provenance["estimator"] == NEXT_EVENT
    lambert = measure(specimen(GROOVE), rays=400_000, seed=4)
    z = (table.values - lambert.values) / np.hypot(table.std_error, lambert.std_error)
    assert 0.6 < np.mean(z**2) < 1.4


@pytest.mark.compiled
@pytest.mark.parametrize("layers", [(GROOVE,), RAYLEIGH_SLAB])
def test_the_same_bits_for_any_threads_worker_or_interruption(layers):
    spec = specimen(*layers)
    runs = [Measurement(spec, 20_000, seed=5, threads=n, estimator=NEXT_EVENT) for n in (1, 3, 2)]
    for measurement in runs[:2]:
        for _ in range(4):
            measurement.add_batch()
    half = Measurement(spec, 20_000, seed=5, estimator=NEXT_EVENT)
    half.add_batch()
    half.add_batch()
    runs[2].restore({name: array.copy() for name, array in half.state().items()})
    runs[2].add_batch()
    runs[2].add_batch()
    one, *others = [measurement.table() for measurement in runs]
    for other in others:
        assert np.array_equal(one.values, other.values)
        assert np.array_equal(one.std_error, other.std_error)
    job = Job(spec, 5, runs[0].job.exponent, NEXT_EVENT)
    tracer = BatchTracer(job)
    sums = tracer.new_accumulators()
    passes = np.ones(3, np.int64)
    tracer.trace(7, passes, sums, 2)
    there = trace_batch(pickle.dumps(job), 7, passes)
    assert np.array_equal(sums[0].reshape(-1, sums[0].shape[-1])[there.places], there.cells)


def test_chosen_where_light_scatters_evenly_in_sight_of_detectors():
    rough = {
        "surface": {"kind": "gaussian", "alpha": 0.3, "samples": 32, "size": 8},
        "material": {"kind": "dielectric", "eta": 1.5},
    }
    refused = {
        "mirror and metal": ({**GROOVE, "material": {"kind": "mirror"}},),
        "nothing scatters": ({**rough, "medium": medium()},),
        "nothing scatters that": ({**OPEN, "medium": medium(sigma_s=0.0)},),
        "layer 1 scatters 45 times": ({**OPEN, "medium": medium(phase="hg", g=0.8)},),
    }
    for layers in CASES.values():
        assert choose(specimen(*layers), 0) == NEXT_EVENT
        assert choose(specimen(*layers), 0, ANALOG) == ANALOG
    for reason, layers in refused.items():
        assert choose(specimen(*layers), 0) == (FEW_FACETS if reason == "mirror and metal" else ANALOG)
        with pytest.raises(InputError, match=f"next-event does not do here: .*{reason}"):
            choose(specimen(*layers), 0, NEXT_EVENT)


@pytest.mark.compiled
@pytest.mark.parametrize(("layers", "target"), [((GROOVE,), 0.05), (RAYLEIGH_SLAB, 0.2)])
def test_a_target_is_met_or_said_not_to_be(layers, target):
    spec = specimen(*layers)
    table = measure(spec, rays=500_000, seed=3, target_error=target, estimator=NEXT_EVENT)
    assert table.provenance["target_met"] is True
    assert table.ledger["paths"] < 400_000
    assert np.all(table.albedo_std_error <= 0.1 * target * table.row_albedo)
    for values, errors in zip(table.values, table.std_error, strict=True):
        assert np.quantile(errors / values, 0.95) < 1.2 * target  # over all cells, also those without light
    short = measure(spec, rays=20_000, seed=3, target_error=0.1 * target, estimator=NEXT_EVENT)
    assert short.provenance["target_met"] is False


def coverage(layers, rays, runs, target=None, **grid):
    """How often intervals of 1.96 errors hold the mean of all runs, and the standard error of that."""
    spec = specimen(*layers, **grid)
    tables = [
        measure(spec, rays=rays, seed=seed, target_error=target, estimator=NEXT_EVENT) for seed in range(runs)
    ]
    truth = np.mean([table.values for table in tables], axis=0)
    # of that mean, so much is the run's own
    allowed = 1.96 * np.sqrt(1.0 - 1.0 / runs)
    share = [np.mean(np.abs(table.values - truth) <= allowed * table.std_error) for table in tables]
    return float(np.mean(share)), float(np.std(share, ddof=1) / np.sqrt(runs))


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["gaussian", "rayleigh"])
def test_intervals_cover(name):
    mean, error = coverage(CASES[name], 5_000, 30)
    assert mean + 3 * error > 0.93
    assert mean - 3 * error < 0.97


@pytest.mark.slow
@pytest.mark.compiled
def test_intervals_cover_where_rows_got_rays_by_their_errors():
    mean, error = coverage(RAYLEIGH_SLAB, 20_000, 30, target=0.3)
    assert mean + 3 * error > 0.93
    assert mean - 3 * error < 0.97


@pytest.mark.compiled
def test_intervals_cover_where_chance_tells_delta_term_from_cells():
    """Most of the light is mirrored: what is left for the cells, here few, varies far more than the albedo."""
    mean, error = coverage(RAYLEIGH_SLAB, 2_000, 60, theta_i_deg=[85], theta_step_deg=30, phi_step_deg=60)
    assert mean + 3 * error > 0.93
    assert mean - 3 * error < 0.97


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.parametrize("name", ["grooves", "gaussian", "overhangs", "pigment", "rayleigh", "forward"])
@pytest.mark.parametrize("rays", [5_000, 50_000])
def test_intervals_cover_in_200_runs(name, rays):
    mean, error = coverage(CASES[name], rays, 200)
    print(name, rays, f"{mean:.3f} +- {error:.3f}")
    assert mean + 3 * error > 0.93
    assert mean - 3 * error < 0.97
