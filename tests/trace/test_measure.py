"""The measurement: furnace, cells, error bars, delta term, determinism, refusals."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from gonio.core.optics import fresnel_conductor
from gonio.trace.errors import TraceError
from gonio.trace.estimators import ANALOG
from gonio.trace.measure import measure
from gonio.trace.measurement import Measurement
from microgeometry.errors import InputError
from microgeometry.specimen import parse_specimen

COARSE = {"theta_step_deg": 15, "phi_step_deg": 30}


def specimen(surface, material, **grid):
    return parse_specimen({"surface": surface, "material": material, "grid": grid})


def gaussian(alpha, samples=128, size=16):
    return {"kind": "gaussian", "alpha": alpha, "samples": samples, "size": size}


MIRROR = {"kind": "mirror"}


def test_flat_lambert_in_every_cell_pole_and_horizon():
    """Hits of every cell follow the binomial law of an albedo spread over the projected solid angle."""
    table = measure(
        specimen({"kind": "flat"}, {"kind": "lambert", "albedo": 0.6}, theta_step_deg=5, phi_step_deg=5),
        rays=1_000_000,
        estimator=ANALOG,
    )
    paths = table.ledger["paths"] / len(table.theta_i)
    share = table.projected_solid_angles / math.pi
    # every path leaves, with weight 0.6
    p = stats.binom.cdf(table.hits, paths, share), stats.binom.sf(table.hits - 1, paths, share)
    smallest = 2 * np.minimum(*p).min()
    assert smallest > 1e-3 / table.hits.size
    expected = table.hits * 0.6 / (paths * table.projected_solid_angles)
    assert table.values[..., 0] == pytest.approx(expected, rel=1e-9)
    assert table.row_albedo == pytest.approx(0.6, abs=1e-12)


def test_error_bars_are_the_scatter_in_every_ring():
    """Over the cells of a ring, squared deviations from rho/pi have the mean that the error bars say."""
    table = measure(
        specimen({"kind": "flat"}, {"kind": "lambert", "albedo": 1.0}, theta_step_deg=5, phi_step_deg=5),
        rays=1_000_000,
        estimator=ANALOG,
    )
    deviation = table.values[..., 0] - 1 / math.pi
    for ring in range(len(table.theta_r)):
        squares = deviation[:, ring].ravel() ** 2
        claimed = np.mean(table.std_error[:, ring] ** 2)
        error = squares.std(ddof=1) / math.sqrt(squares.size)
        # 18 rings; empty cells claim a bound above their scatter, so the pole may only be too careful
        if np.any(table.hits[:, ring] == 0):
            assert squares.mean() < claimed + 4 * error
        else:
            assert abs(squares.mean() - claimed) < 4 * error


@pytest.mark.parametrize("alpha", [0.1, 0.5, 1.0])
def test_white_furnace_of_mirrors(alpha):
    angles = [0, 15, 30, 45, 60, 75, 85, 89]
    spec = specimen(gaussian(alpha), MIRROR, theta_i_deg=angles, **COARSE)
    table = measure(spec, rays=500_000, estimator=ANALOG)
    assert table.ledger["lost"] == 0
    assert table.ledger["killed"] == 0
    assert table.ledger["reflected"] == table.ledger["paths"]
    assert table.row_albedo == pytest.approx(np.ones((len(angles), 1)), abs=1e-9)
    assert table.hits.sum() == table.ledger["paths"]


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.parametrize("alpha", [0.1, 0.5, 1.0])
def test_white_furnace_of_ten_million_paths(alpha):
    surface = {"kind": "gaussian", "alpha": alpha}
    table = measure(specimen(surface, MIRROR, theta_i_deg=list(range(0, 90))), rays=10_000_000)
    paths = table.ledger["paths"]
    assert table.ledger["lost"] <= 1e-6 * paths
    assert table.ledger["reflected"] + table.ledger["lost"] + table.ledger["killed"] == paths
    reflected = table.row_albedo.mean() * paths
    assert reflected == pytest.approx(paths - table.ledger["lost"] - table.ledger["killed"], abs=1e-9 * paths)


def test_cells_and_delta_term_make_up_the_albedo():
    table = measure(specimen(gaussian(0.4), {"kind": "conductor", "name": "Au"}, **COARSE), rays=100_000)
    cells = np.einsum("irpc,rp->ic", table.values, table.projected_solid_angles)
    assert cells + table.specular == pytest.approx(table.row_albedo, rel=1e-12)
    assert np.all(table.specular == 0)
    ledger = table.ledger
    ends = sum(ledger[name] for name in ("reflected", "transmitted", "absorbed", "killed", "lost"))
    assert ends == pytest.approx(ledger["paths"], rel=1e-12)
    assert np.mean(table.row_albedo) == pytest.approx(ledger["reflected"] / ledger["paths"], rel=1e-12)


def test_flat_mirror_is_a_delta_term():
    angles = [0, 30, 60, 85]
    material = {"kind": "conductor", "eta": [0.2, 1.4], "k": [3.9, 1.9]}
    table = measure(
        specimen({"kind": "flat"}, material, theta_i_deg=angles, wavelengths_nm=[600, 450], **COARSE),
        rays=20_000,
    )
    assert np.all(table.values == 0)
    for row, angle in enumerate(angles):
        for channel, (eta, k) in enumerate([(0.2, 3.9), (1.4, 1.9)]):
            expected = sum(fresnel_conductor(math.cos(math.radians(angle)), eta, k)) / 2
            # the tracer's directions are single precision
            assert table.specular[row, channel] == pytest.approx(expected, rel=1e-6)
    assert table.row_albedo == pytest.approx(table.specular)


def test_delta_phi_is_pi_on_the_mirror_side():
    """A nearly smooth mirror sends light to theta_r = theta_i, delta phi = pi."""
    table = measure(
        specimen(gaussian(0.02), MIRROR, theta_i_deg=[40], theta_step_deg=10, phi_step_deg=20), rays=20_000
    )
    row = (table.values[0, :, :, 0] * table.projected_solid_angles) / table.row_albedo[0]
    assert row[3:5, -1].sum() > 0.99


def test_groove_seen_from_all_sides_still_turns_light_by_twice_its_slope():
    """Isotropy by turning the specimen: at normal incidence a groove of slope 20 makes a cone of 40 degrees."""
    table = measure(
        specimen(
            {"kind": "v_groove", "slope_deg": 20}, MIRROR, theta_i_deg=[0], theta_step_deg=1, phi_step_deg=180
        ),
        rays=20_000,
    )
    energy = table.values[0, :, 0, 0] * table.projected_solid_angles[:, 0]
    assert energy[39:41].sum() == pytest.approx(1.0)


def test_empty_cells_have_an_upper_bound():
    """3 / (paths x projected solid angle) where paths are independent; up to 16 times that where packets agree."""
    spec = specimen({"kind": "v_groove", "slope_deg": 20}, MIRROR, theta_i_deg=[0], **COARSE)
    table = measure(spec, rays=20_000, estimator=ANALOG)
    empty = table.hits == 0
    assert empty.any()
    bound = 3 / (table.ledger["paths"] * np.broadcast_to(table.projected_solid_angles, empty.shape))
    # all paths of a packet come from one direction, and such a groove sends them to two places
    clump = table.std_error[..., 0][empty] / bound[empty]
    assert 8 < clump.min() <= clump.max() < 16
    assert np.all(table.std_error > 0)


def test_error_bars_hold_the_scatter_of_realisations():
    """Rays without end on few small tiles: what is left of the error is the surfaces', and it is stated."""
    spec = specimen(gaussian(0.5, samples=32, size=8), {"kind": "conductor", "eta": 1.0, "k": 2.0}, theta_i_deg=[60],
                    **COARSE)  # fmt: skip
    tables = [measure(spec, rays=300_000, seed=s) for s in range(12)]
    albedo = np.array([t.row_albedo[0, 0] for t in tables])
    claimed = np.mean([t.albedo_std_error[0, 0] ** 2 for t in tables])
    # 11 degrees of freedom: the ratio is within these bounds but for a chance of 1e-3
    low, high = stats.chi2.ppf([5e-4, 1 - 5e-4], 11) / 11
    assert low < albedo.var(ddof=1) / claimed < high
    # with far fewer rays on each realisation, the rays' share of a batch's variance would grow by as much,
    # the surfaces' share does not
    fewer = measure(spec, rays=30_000, seed=99)
    rays = [t.ledger["paths"] / t.provenance["realisations"] for t in (tables[0], fewer)]
    batch = [v * t.provenance["realisations"] for v, t in ((claimed, tables[0]), (
        fewer.albedo_std_error[0, 0] ** 2, fewer))]  # fmt: skip
    assert rays[0] / rays[1] > 8
    assert batch[1] < 4 * batch[0]


THREADS = """
import sys, hashlib
from gonio.trace.measure import measure
from microgeometry.specimen import parse_specimen
s = parse_specimen({"surface": {"kind": "gaussian", "alpha": 0.5, "samples": 64, "size": 8},
                    "material": {"kind": "conductor", "name": "Au"},
                    "grid": {"theta_step_deg": 10, "phi_step_deg": 20}})
digest = hashlib.sha256()
for estimator in ("analog", "half-vector"):
    t = measure(s, rays=100_000, seed=5, threads=int(sys.argv[1]), estimator=estimator)
    for a in (t.values, t.std_error, t.row_albedo):
        digest.update(a.tobytes())
print(digest.hexdigest())
"""


@pytest.mark.compiled
def test_same_bits_for_any_number_of_threads():
    digests = {
        subprocess.run(
            [sys.executable, "-c", THREADS, str(n)],
            capture_output=True,
            text=True,
            check=True,
            env=dict(os.environ),
        ).stdout
        for n in (1, 2, 8)
    }
    assert len(digests) == 1


def test_seed_changes_the_numbers_and_nothing_else():
    spec = specimen(gaussian(0.5, samples=32, size=8), MIRROR, **COARSE)
    a, b, c = (measure(spec, rays=20_000, seed=s) for s in (1, 1, 2))
    assert np.array_equal(a.values, b.values)
    assert not np.array_equal(a.values, c.values)
    assert c.row_albedo == pytest.approx(a.row_albedo)


def test_mesh_with_a_hole_is_refused_with_advice(tmp_path):
    (tmp_path / "hole.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv .5 .5 0\nf 1 2 5\nf 2 3 5\nf 3 4 5\n"  # a quarter is missing
    )
    spec = parse_specimen({"surface": {"kind": "mesh", "file": "hole.obj"}, "material": MIRROR}, tmp_path)
    with pytest.raises(TraceError, match=r"lost.*holes.*close it"):
        measure(spec, rays=10_000)


def test_budget_and_seed_are_checked():
    spec = specimen({"kind": "flat"}, MIRROR, **COARSE)
    for arguments, words in [
        ({"rays": 0}, "rays: 0"),
        ({"rays": 5, "seconds": 1.0}, "both"),
        ({"seconds": -1.0}, "time: -1"),
        ({"seconds": math.nan}, "time: nan"),
        ({"seed": -1}, "seed: -1"),
        ({"threads": 0}, "threads: 0"),
    ]:
        with pytest.raises(InputError, match=words):
            measure(spec, **arguments)


def test_a_time_is_kept():
    measurement_seconds = 0.3
    table = measure(specimen({"kind": "flat"}, MIRROR, **COARSE), seconds=measurement_seconds)
    assert table.provenance["batches"] >= 2
    assert table.provenance["seconds"] >= measurement_seconds


def test_table_before_the_first_batch():
    with pytest.raises(TraceError, match="no batch"):
        Measurement(specimen({"kind": "flat"}, MIRROR)).table()


MEMORY = """
import json
import sys
from pathlib import Path
from gonio.trace.measure import measure
from microgeometry.specimen import parse_specimen
layers, step, rays, out = json.loads(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]), sys.argv[4]
s = parse_specimen({**layers, "grid": {"theta_step_deg": step, "phi_step_deg": step}})
measure(s, rays=rays, checkpoint=out, every=5.0).save(out)
peak = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
print(int(peak.split()[1]) * 1024)
"""
COLOURED = {"kind": "lambert", "albedo": [0.7, 0.5, 0.3]}
GLAZE = {"kind": "dielectric", "eta": 1.5}
SCATTERING = {"sigma_a": 0.2, "sigma_s": 0.8, "thickness": 2.0, "units": "um"}
BY_ESTIMATOR = {
    "half-vector": {"surface": gaussian(0.5), "material": {"kind": "conductor", "name": "Au"}},
    "next-event": {"surface": {"kind": "v_groove", "slope_deg": 40}, "material": COLOURED},
    "next-event in a stack": {
        "layer": [
            {"surface": {"kind": "flat"}, "material": GLAZE, "medium": SCATTERING},
            {"surface": {"kind": "flat"}, "material": COLOURED},
        ]
    },
}


def peak_memory(name, step, rays, out):
    """Bytes that a process needs at most to trace an RGB table, with checkpoints, and to save it.

    As Linux tells it; ru_maxrss of a child starts at the memory of its parent, the whole test run.
    """
    command = [sys.executable, "-c", MEMORY, json.dumps(BY_ESTIMATOR[name]), str(step), str(rays), str(out)]
    return int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


needs_proc = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="Linux tells peak memory")


by_estimator = pytest.mark.parametrize(
    "name", ["half-vector", *(pytest.param(n, marks=pytest.mark.slow) for n in list(BY_ESTIMATOR)[1:])]
)


@needs_proc
@pytest.mark.compiled
@by_estimator
def test_memory_of_a_one_degree_table_is_flat_in_rays(name, tmp_path):
    few, many = (peak_memory(name, 1, rays, tmp_path / "t.h5") for rays in (100_000, 4_000_000))
    assert many < 2**30
    assert many < 1.1 * few


@needs_proc
@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.parametrize("name", BY_ESTIMATOR)
def test_a_half_degree_table_fits_in_four_gigabytes(name, tmp_path):
    """11.7 million cells, each of three channels, with checkpoints."""
    assert peak_memory(name, 0.5, 100_000, tmp_path / "t.h5") < 4 * 2**30
