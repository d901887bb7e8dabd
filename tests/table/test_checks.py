"""Checks: quiet on good tables however noisy, loud on the faults they are for."""

from __future__ import annotations

import json

import numpy as np
import pytest

from gonio.table.checks import check, map_noise, noise_lines
from gonio.table.parts import extract
from gonio.trace.error_bars import cell_errors
from gonio.validation import seed_from
from tests.table.tables import asymmetric, ggx, grid, lambert, make, with_parts


def poisson(brdf, rng, paths, edges, asymmetry=0.0, batches=None, tint=(1.0,)):
    """A table as a tracer of unit weights leaves it; `asymmetry` brightens cells with theta_r > theta_i."""
    truth = make(brdf, edges, tint=tint, cell_points=2)
    values = truth.values.copy()
    paired = np.sqrt(values * values.transpose(1, 0, 2, 3))  # reciprocal to the last digit
    steeper = np.arange(len(edges[1]) - 1) > np.arange(len(edges[0]) - 1)[:, None]
    paired *= 1 + asymmetry * steeper[:, :, None, None]
    exposure = paths / len(truth.theta_i) * truth.projected_solid_angles[:, :, None]
    counts = rng.poisson(paired * exposure)
    if batches is None:
        error = np.sqrt(np.maximum(counts, 9)) / exposure
        error = np.where(counts > 0, np.sqrt(counts) / exposure, error)
    else:  # from the scatter of batches
        parts = rng.poisson(np.broadcast_to(paired * exposure / batches, (batches, *counts.shape)))
        counts = parts.sum(axis=0)
        error = np.where(counts > 0, parts.std(axis=0, ddof=1) * np.sqrt(batches), 3) / exposure
    values = counts / exposure
    albedo = np.einsum("irpc,rp->ic", values, truth.projected_solid_angles)
    return truth.replace(
        values=values,
        std_error=error,
        row_albedo=albedo,
        hits=counts[..., 0],
        albedo_std_error=np.sqrt(albedo / (paths / len(truth.theta_i))),
        provenance={} if batches is None else {"batches": batches},
    )


def named(report, name):
    return next(c for c in report.checks if c.name == name)


@pytest.mark.parametrize("paths", [3e4, 1e6, 3e7])
def test_reciprocal_poisson_tables_pass(paths):
    """From 1 hit in ten cells to 1000 a cell: chi^2 per degree of freedom is 1, not near 1."""
    rng = np.random.default_rng(seed_from(f"poisson {paths}"))
    for _ in range(5):
        report = check(poisson(ggx(0.5, 0.9), rng, paths, grid(20, 20, 40)))
        for scale in ("cells", "rings"):
            found = named(report, f"reciprocity of {scale}")
            assert found.passed in (True, None)
            if found.numbers["dof"] > 0:
                sigma = np.sqrt(2 / found.numbers["dof"])
                assert abs(found.numbers["chi2_per_dof"] - 1) < 4.5 * sigma + 0.01
        assert report.passed, report.lines()


def test_few_hits_do_not_bias_chi_squared():
    """Mean over many tables whose comparisons rest on 20 hits a side: 1 to better than 1 %.

    Comparing by the two cells' own error bars gives 1.013.
    """
    rng = np.random.default_rng(seed_from("bias"))
    chi2, dof = 0.0, 0.0
    for _ in range(150):
        numbers = named(
            check(poisson(ggx(0.5, 0.9), rng, 3e5, grid(12, 12, 30))), "reciprocity of cells"
        ).numbers
        chi2 += numbers["chi2_per_dof"] * numbers["dof"]
        dof += numbers["dof"]
    assert abs(chi2 / dof - 1) < 4 * np.sqrt(2 / dof)
    assert 4 * np.sqrt(2 / dof) < 0.02


def test_error_bars_from_few_batches():
    rng = np.random.default_rng(seed_from("batches"))
    report = check(poisson(ggx(0.5, 0.9), rng, 2e6, grid(20, 20, 40), batches=8))
    assert report.passed, report.lines()
    assert named(report, "reciprocity of cells").numbers["chi2_per_dof"] == pytest.approx(1, abs=0.12)


@pytest.mark.parametrize("paths", [3e4, 1e5, 1e6])
def test_error_bars_of_few_paths_are_no_asymmetry(paths):
    """A tracer's error of a cell of one path is that of how many its neighbours expect, less than one."""
    rng = np.random.default_rng(seed_from(f"few {paths}"))
    edges = grid(30, 30, 60)
    table = poisson(ggx(0.5, 0.9), rng, paths, edges)
    areas, per_row = table.projected_solid_angles, int(paths / 30)
    error = np.empty_like(table.values)
    for row, hits in enumerate(table.hits):
        energy = hits[..., None] / per_row
        error[row] = cell_errors(energy, energy / per_row, hits, areas, per_row) / areas[..., None]
    for scale in ("cells", "rings"):
        found = named(check(table.replace(std_error=error)), f"reciprocity of {scale}")
        assert found.passed, found.detail
        dof = found.numbers["dof"]
        assert found.numbers["chi2_per_dof"] == pytest.approx(1, abs=4 * np.sqrt(2 / dof) + 0.1)


def test_what_is_too_dark_to_compare_is_not_ok():
    table = make(lambert, grid(20, 20, 30), tint=(0.0,))
    report = check(table.replace(std_error=np.full_like(table.values, 1e-3)))
    for scale in ("cells", "rings"):
        found = named(report, f"reciprocity of {scale}")
        assert found.passed is None
        assert found.numbers["dof"] == 0
        assert "enough paths" in found.detail


@pytest.mark.parametrize("asymmetry", [0.03, -0.03])
def test_three_percent_asymmetry_is_found(asymmetry):
    """20 M paths over 45 rows: 220 hits a cell, 3 % is hidden in each and plain in the rings."""
    rng = np.random.default_rng(seed_from("asymmetry"))
    report = check(poisson(ggx(0.5, 0.9), rng, 2e7, grid(45, 45, 45), asymmetry))
    assert not report.passed
    assert named(report, "reciprocity of rings").passed is False


def test_exact_rows_and_tables_without_errors_only_inform():
    bare = check(make(ggx(0.5, 0.9), grid(20, 20, 30), tint=(0.5,)))
    assert bare.passed, bare.lines()
    assert named(bare, "asymmetry").passed is None
    assert named(bare, "asymmetry").numbers["relative_rms"] < 1e-9
    rows = make(ggx(0.5, 0.9), grid(20, 90, 30), theta_i=np.radians([10.0, 40.0, 70.0]), tint=(0.5,))
    assert named(check(rows), "asymmetry").numbers["relative_rms"] < 0.01
    skewed = make(asymmetric, grid(20, 90, 30), theta_i=np.radians([10.0, 40.0, 70.0]))
    assert named(check(skewed), "asymmetry").numbers["relative_rms"] > 0.1


def test_gaps_are_no_asymmetry():
    rows = make(ggx(0.5, 0.9), grid(20, 90, 30), theta_i=np.radians([10.0, 40.0, 70.0]), tint=(0.5,))
    gaps = np.zeros(rows.values.shape[:3], bool)
    gaps[1, 60:, :20] = True  # of the pair of 40 and 70 degrees, 20 of 30 sectors one way
    values = np.where(gaps[..., None], 0.0, rows.values)
    assert named(check(rows.replace(values=values)), "asymmetry").numbers["relative_rms"] > 0.1
    found = named(check(rows.replace(values=values, gaps=gaps)), "asymmetry")
    assert found.numbers["relative_rms"] < 0.01
    nothing = named(check(rows.replace(values=np.zeros_like(values), gaps=np.ones_like(gaps))), "asymmetry")
    assert nothing.detail == "no two rows see each other's direction"


def test_energy():
    rng = np.random.default_rng(seed_from("energy"))
    table = poisson(ggx(0.5, 0.9), rng, 1e6, grid(20, 20, 30))
    sigma = table.albedo_std_error
    bright = table.replace(row_albedo=np.where(np.arange(20)[:, None] == 7, 1 + 3 * sigma, table.row_albedo))
    assert named(check(bright), "energy").passed
    bright = table.replace(row_albedo=np.where(np.arange(20)[:, None] == 7, 1 + 6 * sigma, table.row_albedo))
    assert named(check(bright), "energy").passed is False
    assert named(check(bright), "albedo is the sum over cells").passed is False


def test_energy_is_told_for_every_angle():
    table = make(ggx(0.5, 0.5), grid(6, 6, 6))
    found = check(table).to_json()["checks"]["energy"]
    np.testing.assert_allclose(found["theta_i_deg"], np.degrees(table.theta_i))
    np.testing.assert_allclose(found["energy"], table.row_albedo)
    np.testing.assert_allclose(found["allowed"], 1.000001)
    assert found["energy_channels"] == ["R", "G", "B"]


def test_negative_albedo_is_compared_by_its_size():
    """A colour outside the gamut: -0.02 within 1 % of itself passes, 2 % off fails."""
    table = make(ggx(0.5, 0.5), grid(6, 6, 6), tint=(1.0, 0.5, -0.02))
    for factor, passed in ((1.005, True), (0.995, True), (1.02, False), (0.98, False)):
        albedo = table.row_albedo * np.array([1.0, 1.0, factor])
        found = named(check(table.replace(row_albedo=albedo)), "albedo is the sum over cells")
        assert found.passed is passed, factor


def test_noise_map():
    """Errors of 5 % below 45 degrees and 20 % above: so the map's blocks say, in rows as in rings."""
    table = make(lambert, grid(18, 18, 12), tint=(1.0,))
    steep = table.theta_r > np.pi / 4
    error = np.where(steep[None, :, None, None], 0.2, 0.05) * table.values
    error[9:] *= 2
    noisy = table.replace(std_error=error)
    edges_i, edges_r, noise = map_noise(noisy, 45.0)
    np.testing.assert_allclose(np.degrees(edges_i), [0, 45, 90])
    np.testing.assert_allclose(edges_r, edges_i)
    np.testing.assert_allclose(noise, [[0.05, 0.2], [0.1, 0.4]], rtol=1e-12)
    lines = noise_lines(noisy)
    assert len(lines) == 2 + 9
    # half of what lies between 40 and 50 degrees has 5 %, half 20 %: the root of the mean square is 14.6 %
    assert lines[2].split() == ["0", *["5"] * 4, "14.6", *["20"] * 4]
    in_json = json.loads(json.dumps(check(noisy).to_json()))["checks"]["noise"]
    assert in_json["map"][8][8] == pytest.approx(0.4)


def test_noise_map_where_nothing_is():
    table = make(lambert, grid(18, 18, 12), tint=(1.0,))
    values = table.values.copy()
    values[:, 4:] = 0.0
    gaps = np.zeros(values.shape[:3], bool)
    gaps[:9] = True
    dark = table.replace(values=values, std_error=0.1 * table.values, gaps=gaps)
    noise = map_noise(dark, 45.0)[2]
    assert np.all(np.isnan(noise[0]))
    assert np.isnan(noise[1, 1])
    # light below 20 degrees only: its share of the block is in both means, in the error's under the root
    lit = np.sin(np.radians(20)) ** 2 / np.sin(np.radians(45)) ** 2
    assert noise[1, 0] == pytest.approx(0.1 / np.sqrt(lit))
    assert check(dark).to_json()["checks"]["noise"]["map"][0][0] is None
    assert noise_lines(dark)[2].split()[:3] == ["40", "10", "10"]


def test_energy_counts_what_is_transmitted():
    """Errors of reflected and transmitted light add up: however they are correlated, no false alarm."""
    rng = np.random.default_rng(seed_from("energy below"))
    table = with_parts(poisson(ggx(0.5, 0.9), rng, 1e6, grid(20, 20, 30)), transmittance=0.1)
    below = table.parts["transmission"].replace(albedo_std_error=2 * table.albedo_std_error)
    sigma = table.albedo_std_error + below.albedo_std_error
    for excess, passed in ((3, True), (6, False)):
        bright = np.where(
            np.arange(20)[:, None] == 7, 1 + excess * sigma - table.row_albedo, below.row_albedo
        )
        report = check(table.replace(parts={"transmission": below.replace(row_albedo=bright, parts={})}))
        found = named(report, "energy")
        assert found.passed is passed
        assert found.numbers["energy_max"] == pytest.approx(1 + excess * sigma[7, 0])
        assert "albedo with transmittance" in found.detail
    assert named(report, "transmittance is the sum over cells").passed is False
    assert named(report, "albedo is the sum over cells").passed


def test_orders_add_up():
    """In every quantity, of the table and of its transmission, to rounding."""
    table = with_parts(make(ggx(0.5, 0.5), grid(8, 8, 9), specular=0.05))
    report = check(table)
    assert report.passed, report.lines()
    for whole, name in ((table, "the table"), (table.parts["transmission"], "transmission")):
        assert named(report, f"orders add up to {name}").passed
        for field in ("values", "row_albedo", "specular"):
            second = whole.parts["L2"]
            more = getattr(second, field).copy()
            more[3] *= 1 + 1e-7
            parts = {**whole.parts, "L2": second.replace(**{field: more})}
            wrong = whole.replace(parts=parts)
            if name == "transmission":
                wrong = table.replace(parts={**table.parts, name: wrong})
            report = check(wrong)
            assert named(report, f"orders add up to {name}").passed is False, field
            assert sum(c.passed is False for c in report.checks) == 1
    hits = np.full(table.values.shape[:3], 2)
    halves = {n: p.replace(hits=hits // 2) for n, p in table.parts.items() if n in ("L1", "L2")}
    for last, passed in ((0, True), (1, False)):
        parts = {**table.parts, **halves, "L3+": table.parts["L3+"].replace(hits=hits * 0 + last)}
        report = check(table.replace(hits=hits, parts=parts))
        assert named(report, "orders add up to the table").passed is passed


def test_a_table_of_transmission_owes_no_reciprocity():
    table = with_parts(make(asymmetric, grid(20, 20, 30)))
    for part in ("transmission", "transmission/L1"):
        report = check(extract(table, part))
        assert [c.name for c in report.checks if "symmetry" in c.name] == []
        assert named(report, "reciprocity").passed is None
    assert named(check(extract(table, "L1")), "asymmetry").passed is None
    rng = np.random.default_rng(seed_from("one-way"))
    noisy = with_parts(poisson(ggx(0.5, 0.9), rng, 2e7, grid(45, 45, 45), asymmetry=0.03))
    assert not check(extract(noisy, "L1")).passed
    assert check(extract(noisy, "transmission/L1")).passed


def test_positivity_looks_at_the_error_bars():
    rng = np.random.default_rng(seed_from("positivity"))
    table = poisson(ggx(0.5, 0.9), rng, 1e6, grid(20, 20, 30))
    values = table.values.copy()
    values[3, 4, 5] = -2 * table.std_error[3, 4, 5]
    assert named(check(table.replace(values=values)), "positivity").passed
    values[3, 4, 5] = -9 * table.std_error[3, 4, 5]
    assert named(check(table.replace(values=values)), "positivity").numbers["negative"] == 1
    assert not check(table.replace(values=values)).passed


def test_noise():
    """Every cell with a relative error of 5 %."""
    table = make(ggx(0.5, 0.5), grid(10, 10, 12))
    table = table.replace(std_error=0.05 * table.values)
    assert named(check(table), "noise").numbers["median"] == pytest.approx(0.05)


def test_ledger():
    table = make(ggx(0.5, 0.5), grid(10, 10, 12))
    good = {
        "paths": 1e6,
        "reflected": 7e5,
        "transmitted": 0.0,
        "absorbed": 3e5 - 1,
        "killed": 0.5,
        "lost": 0.5,
    }
    assert named(check(table.replace(ledger=good)), "ledger").passed
    assert named(check(table.replace(ledger={**good, "absorbed": 3e5})), "ledger").passed is False
    layers = {"absorbed: layer 1 surface": 2e5, "absorbed: layer 1 medium": 1e5 - 1}
    assert named(check(table.replace(ledger=good | layers)), "ledger").passed
    layers["absorbed: layer 1 medium"] += 0.01
    assert named(check(table.replace(ledger=good | layers)), "ledger").passed is False
    lossy = {**good, "lost": 2.5, "absorbed": 3e5 - 3}
    assert named(check(table.replace(ledger=lossy)), "ledger").passed is False
    assert named(check(table), "ledger").passed is None


def test_gaps_are_left_out():
    rng = np.random.default_rng(seed_from("gaps"))
    table = poisson(ggx(0.5, 0.9), rng, 1e6, grid(20, 20, 30))
    gaps = np.zeros(table.values.shape[:3], bool)
    gaps[5, 8:12] = True
    values = np.where(gaps[..., None], 0.0, table.values)
    report = check(table.replace(values=values, gaps=gaps))
    assert report.passed, report.lines()
    assert not check(table.replace(values=values)).passed


def test_report_is_json_and_text():
    report = check(make(ggx(0.5, 0.5), grid(6, 6, 6)))
    assert json.loads(json.dumps(report.to_json()))["passed"] is report.passed
    assert len(report.lines()) == len(report.checks)


def test_single_cell_table():
    assert check(make(ggx(0.5, 0.5), grid(1, 1, 1))).passed


def test_colours_outside_the_gamut_are_judged_by_luminance():
    """Gold's linear red is above 1, a deep cyan's is below 0; neither makes or destroys light."""
    weights = (0.2126, 0.7152, 0.0722)
    table = make(ggx(0.5, 0.5), grid(10, 10, 12), tint=(1, 1, 1))
    gold, cyan = (
        table.replace(
            values=table.values * tint, row_albedo=table.row_albedo * tint,
            provenance={**table.provenance, "colour": {"luminance": list(weights)}},
        )
        for tint in (np.array([1.04, 0.73, 0.37]) / table.row_albedo.max(), np.array([-0.1, 0.5, 0.6]))
    )  # fmt: skip
    for colour in (gold, cyan):
        assert named(check(colour), "energy").passed
        assert named(check(colour), "positivity").passed
        assert not check(colour.replace(provenance={})).passed
    white = gold.replace(row_albedo=gold.row_albedo * 1.4)
    assert named(check(white), "energy").passed is False
    assert named(check(cyan.replace(values=-cyan.values)), "positivity").passed is False
