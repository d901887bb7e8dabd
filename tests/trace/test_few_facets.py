"""Paths on a net over facets that look in few directions: against analog binning, closed forms, their own scatter."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.core.philox import philox4x32, unit
from gonio.trace.estimators import ANALOG, FEW_FACETS, choose
from gonio.trace.few_facets import _scramble, directions, net
from gonio.trace.measure import measure
from gonio.trace.measurement import Measurement
from microgeometry.errors import InputError
from microgeometry.specimen import parse_specimen

METAL = {"kind": "conductor", "eta": [0.2, 1.0], "k": [3.9, 2.0]}
GROOVE = {"kind": "v_groove", "slope_deg": 40}
CASES = {
    "grooves": GROOVE,
    "pyramids": {"kind": "pyramids", "slope_deg": 54.74},
    "random pyramids": {"kind": "pyramids", "slope_deg": 35, "arrangement": "random"},
    "slopes": {"kind": "v_groove", "distribution": "beckmann", "alpha": 0.4},
}


def specimen(surface, material=METAL, **grid):
    keys = {"wavelengths_nm": [500, 600], "theta_step_deg": 6, "phi_step_deg": 12, **grid}
    return parse_specimen({"surface": surface, "material": material, "grid": keys})


def scrambled(points, *counter):
    key = philox4x32(*counter)
    return np.array([[unit(_scramble(x, k)) for x, k in zip(point, key, strict=True)] for point in points])


@pytest.mark.parametrize("paths", [256, 512])
def test_points_fill_every_part_of_place_and_direction_alike(paths):
    points = net(paths)
    x = scrambled(points, 1, 2, 3, 4, 5, 6)
    assert np.all((x > 0) & (x < 1))
    for columns in range(paths.bit_length()):  # of any width, place meets every box of area 1 / paths once
        boxes = np.floor(x[:, :2] * (2**columns, paths >> columns)).astype(int)
        assert len(np.unique(boxes, axis=0)) == paths
    for axis in range(4):
        assert np.array_equal(np.sort(np.floor(x[:, axis] * paths)), np.arange(paths))
    # sixteen in a packet lie together
    packet = x[:, :2].reshape(-1, 16, 2)
    assert np.ptp(packet, axis=1).max() <= 2 / np.sqrt(paths / 16)


def test_scrambling_makes_every_point_uniform():
    points = net(16)[:3]
    x = np.array([scrambled(points, row, 0, 0, 7, 8, 9) for row in range(400)])
    assert np.all(np.abs(x.mean(0) - 0.5) < 4 / np.sqrt(12 * 400))
    assert np.all(np.abs(x.var(0) * 12 - 1) < 4 * np.sqrt(0.8 / 400))
    together = np.einsum("nij,nkl->ijkl", x - 0.5, x - 0.5)[0, 0, 0, 1:] / 400 * 12
    assert np.all(np.abs(together) < 4 / np.sqrt(400))


@pytest.mark.compiled
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("grid", [{}, {"theta_i_deg": [0, 25, 50, 85]}])
def test_chi2_of_all_cells_against_long_analog_runs(name, grid):
    spec = specimen(CASES[name], orders=2, **grid)
    table = measure(spec, rays=500_000, seed=1, estimator=FEW_FACETS)
    paths = measure(spec, rays=2_000_000, seed=2, estimator=ANALOG)
    assert table.provenance["estimator"] == FEW_FACETS
    for part, of_paths in ((table, paths), *zip(table.parts.values(), paths.parts.values(), strict=True)):
        many = of_paths.hits >= 100
        z = (part.values - of_paths.values) / np.hypot(part.std_error, of_paths.std_error)
        assert np.count_nonzero(many) > 30
        assert 0.6 < np.mean(z[many] ** 2) < 1.3
        assert np.abs(z[many]).max() < 5.5
        assert not np.any(part.hits[of_paths.hits == 0] > 20)
    error = np.hypot(table.albedo_std_error, paths.albedo_std_error)
    assert np.all(np.abs(table.row_albedo - paths.row_albedo) < 4.5 * error + 1e-12)
    total = np.einsum("irpc,rp->ic", table.values, table.projected_solid_angles) + table.specular
    assert total == pytest.approx(table.row_albedo, rel=1e-9)
    ledger = table.ledger
    ends = ("reflected", "transmitted", "absorbed", "killed", "lost")
    assert sum(ledger[end] for end in ends) == pytest.approx(ledger["paths"], rel=1e-12)


@pytest.mark.compiled
def test_energies_of_a_groove_in_closed_form():
    """Slope b = 30, light from above: all of it leaves after one bounce, 60 degrees from the normal."""
    grid = {"wavelengths_nm": [500], "theta_i_deg": [0], "orders": 2}
    spec = specimen({"kind": "v_groove", "slope_deg": 30}, {"kind": "mirror"}, **grid)
    table = measure(spec, rays=50_000)
    one = table.parts["L1"]
    energy = np.einsum("rp,rp->r", one.values[0, ..., 0], one.projected_solid_angles)
    assert energy[9:11].sum() == pytest.approx(1, abs=1e-9)
    # slope 35: one bounce to 70 degrees, 2 cos 70; two to 40
    spec = specimen({"kind": "v_groove", "slope_deg": 35}, {"kind": "mirror"}, **grid)
    one = measure(spec, rays=50_000).parts["L1"]
    error = one.albedo_std_error[0, 0]
    assert one.row_albedo[0, 0] == pytest.approx(2 * np.cos(np.radians(70)), abs=4 * error)
    assert error < 2e-4  # of as many paths at random, 0.002


@pytest.mark.compiled
def test_flat_tops_give_the_delta_term():
    surface = {"kind": "pits", "cover": 0.4, "depth": 1.0, "arrangement": "square"}
    spec = specimen(surface, {"kind": "mirror"}, wavelengths_nm=[500], theta_i_deg=[20])
    table = measure(spec, rays=100_000, estimator=FEW_FACETS)
    assert table.specular[0, 0] == pytest.approx(0.6, abs=0.01)
    assert table.row_albedo[0, 0] == pytest.approx(1, abs=1e-6)


@pytest.mark.compiled
def test_less_noise_than_binning_at_equal_paths():
    spec = specimen(GROOVE, theta_i_deg=[20, 70])
    noise = []
    for estimator in (FEW_FACETS, ANALOG):
        runs = [measure(spec, rays=60_000, seed=seed, estimator=estimator) for seed in range(8)]
        values = np.array([run.values for run in runs])
        bright = values.mean(0) > 0.1 * values.mean(0).max()
        noise.append(np.median(values.var(0, ddof=1)[bright]))
    # 0.013 on the net, 0.09 with random points in its place
    assert noise[0] < 0.04 * noise[1]


@pytest.mark.compiled
def test_the_same_bits_for_any_threads():
    spec = specimen(GROOVE, theta_i_deg=[20, 70])
    one, two = (measure(spec, rays=50_000, threads=n) for n in (1, 3))
    assert np.array_equal(one.values, two.values)
    assert np.array_equal(one.std_error, two.std_error)


def coverage(surface, rays, runs, target=None):
    """How often intervals of 1.96 errors hold the mean of all runs, of cells that paths reach in most runs."""
    spec = specimen(surface, wavelengths_nm=[500], material={"kind": "mirror"}, theta_i_deg=[5, 30, 60, 85])
    tables = [
        measure(spec, rays=rays, seed=seed, target_error=target, estimator=FEW_FACETS) for seed in range(runs)
    ]
    truth = np.mean([table.values for table in tables], axis=0)
    reached = np.mean([table.hits for table in tables], axis=0) >= 3
    allowed = 1.96 * np.sqrt(1.0 - 1.0 / runs)
    # a cell that light fills or leaves altogether has no noise but rounding
    share = [
        np.mean((np.abs(t.values - truth) <= allowed * t.std_error + 1e-9 * truth)[reached]) for t in tables
    ]
    return float(np.mean(share)), float(np.std(share, ddof=1) / np.sqrt(runs))


@pytest.mark.compiled
@pytest.mark.parametrize(("name", "target"), [(name, None) for name in CASES] + [("grooves", 0.05)])
def test_intervals_cover(name, target):
    mean, error = coverage(CASES[name], 10_000, 30, target)
    print(name, target, f"{mean:.3f} +- {error:.3f}")
    assert mean + 3 * error > 0.93
    assert mean - 3 * error < 0.97


def test_chosen_for_metal_facets_of_few_directions():
    for surface in CASES.values():
        assert choose(specimen(surface), 0) == FEW_FACETS
        assert choose(specimen(surface), 0, ANALOG) == ANALOG
    flat = specimen({"kind": "flat"}, {"kind": "mirror"})
    low = specimen({"kind": "v_groove", "slope_deg": 1}, {"kind": "mirror"})
    many = specimen({"kind": "pits", "cover": 0.4, "depth": 0.4, "arrangement": "random"}, {"kind": "mirror"})
    lambert = specimen(GROOVE, {"kind": "lambert", "albedo": 0.5})
    cases = (
        (flat, "in 0 directions"),
        (low, "alpha is 0.0"),
        (many, "directions but up"),
        (lambert, "mirror"),
    )
    for spec, reason in cases:
        assert choose(spec, 0) != FEW_FACETS
        with pytest.raises(InputError, match=f"few-facets does not do here: .*{reason}"):
            choose(spec, 0, FEW_FACETS)
    assert directions(specimen(GROOVE).layers[0].surface.realise(0)) == 2
    assert Measurement(specimen(GROOVE)).job.estimator == FEW_FACETS
