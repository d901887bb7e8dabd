"""Plots, report and demo: what they show is what the table says."""

from __future__ import annotations

import re

import numpy as np
import pytest

from fitting.result import Fit, FittedLobe
from gonio.trace.estimators import ANALOG
from gonio.trace.measure import measure
from microgeometry.errors import InputError
from microgeometry.specimen import parse_specimen
from renderer import plots
from renderer.demo import Demo, _users_case
from renderer.report import write_report
from tests.renderer.scenes import lambert_table
from tests.renderer.tables import with_parts


def traced():
    return measure(
        parse_specimen(
            {
                "surface": {"kind": "flat"},
                "material": {"kind": "lambert", "albedo": 0.5},
                "grid": {"theta_step_deg": 5, "phi_step_deg": 10},
            }
        ),
        rays=100_000,
        estimator=ANALOG,
    )


@pytest.fixture(scope="module")
def table():
    return traced()


def test_plane_of_incidence_of_a_lambertian_is_flat(table):
    theta, mean, error = plots.plane_of_incidence(table, 9)
    assert np.all(np.diff(theta) > 0)
    assert theta[0] == pytest.approx(-theta[-1])
    z = (mean - 0.5 / np.pi) / error
    # 36 means: none beyond 4.5 standard errors but with a chance of 2e-4
    assert np.abs(z).max() < 4.5
    assert 0.4 < np.sqrt(np.mean(z**2)) < 1.6


def test_plane_of_incidence_tells_the_sides_apart(table):
    """Values that grow with delta phi stand on the mirror side, which is positive."""
    slanted = table.replace(values=np.ones_like(table.values) * table.delta_phi[:, None])
    theta, mean, _ = plots.plane_of_incidence(slanted, 0)
    assert np.all(mean[theta > 0] > 3.0)
    assert np.all(mean[theta < 0] < 0.1)


def test_overlay_is_the_fit():
    fit = Fit("lambert", (FittedLobe("lambert", {}, {"albedo": {"grey": 0.5}}),), ("grey",))
    assert plots.overlay(fit).values == pytest.approx(0.5 / np.pi)


def test_report_holds_everything_in_one_file(small_pictures, table, tmp_path):
    fit = Fit("lambert", (FittedLobe("lambert", {}, {"albedo": {"grey": 0.5}}),), ("grey",))
    fractions = []
    write_report(
        table, tmp_path / "r.html", {"a <fit>": fit}, [("More", "<p>words</p>")], title="A & B",
        progress=lambda fraction, words: fractions.append(fraction),
    )  # fmt: skip
    page = (tmp_path / "r.html").read_text()
    assert page.count("data:image/png;base64,") == 4
    assert page.count("Picture of the surface: flat, Lambertian of albedo 0.5") == 1
    assert fractions == sorted(fractions)
    assert fractions[0] == 0.0
    assert "A &amp; B" in page
    assert "a &lt;fit&gt;" in page
    assert "http" not in page  # nothing is loaded from elsewhere
    assert "all passed" in page


def test_report_of_a_table_without_error_bars(tmp_path):
    write_report(lambert_table(0.5), tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text()
    assert page.count("data:image/png;base64,") == 3
    for heading in ("Surface", "Where the light went", "By number of bounces", "Fits", "Specimen"):
        assert f"<h2>{heading}</h2>" not in page


def test_report_of_a_table_with_parts(tmp_path):
    ledger = {
        "paths": 200.0, "reflected": 70.0, "transmitted": 66.0, "absorbed": 64.0, "killed": 0.0, "lost": 0.0,
        "absorbed: layer 1 <medium>": 48.0, "absorbed: layer 1 surface": 0.0,
        "absorbed: layer 2 surface": 16.0,
    }  # fmt: skip
    write_report(with_parts(ledger=ledger), tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text()
    # energy; lobes and hemispheres of both sides; two of the orders of both sides; albedo
    assert page.count("data:image/png;base64,") == 1 + 2 + 2 + 4 + 1
    assert page.count("<h3>Transmitted</h3>") == 3
    assert re.findall(r"<td[^>]*em\">([^<]*)</td><td>([^<]*)</td>", page) == [
        ("reflected", "35.0000%"), ("transmitted", "33.0000%"), ("absorbed", "32.0000%"),
        ("layer 1 &lt;medium&gt;", "24.0000%"), ("layer 2 surface", "8.0000%"),
        ("killed", "0.0000%"), ("lost", "0.0000%"),
    ]  # fmt: skip


def test_report_of_orders_without_transmission(tmp_path):
    table = with_parts()
    write_report(
        table.replace(parts={n: p for n, p in table.parts.items() if n[0] == "L"}), tmp_path / "r.html"
    )
    page = (tmp_path / "r.html").read_text()
    assert page.count("data:image/png;base64,") == 5
    assert "By number of bounces" in page
    assert "Transmitted" not in page
    assert "Where the light went" not in page


def test_report_looks_for_files_where_it_is_told(small_pictures, table, tmp_path):
    np.save(tmp_path / "map.npy", np.random.default_rng(1).normal(size=(9, 9)))
    text = '[surface]\nkind = "heightmap"\nfile = "map.npy"\nunits = "um"\nsize = [9, 9]\n[material]\nkind = "mirror"\n'
    found = table.replace(provenance={"specimen": text})
    write_report(found, tmp_path / "r.html", folder=tmp_path)
    assert "Picture of the surface: heightmap, mirror" in (tmp_path / "r.html").read_text()
    write_report(found, tmp_path / "r.html", folder=tmp_path / "elsewhere")
    assert "No picture of the surface: [surface] file" in (tmp_path / "r.html").read_text()


def test_users_specimens(tmp_path):
    (tmp_path / "tile.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n")
    case = _users_case(tmp_path / "tile.obj")
    assert case.specimen.surface.kind == "mesh"
    assert case.specimen.material.name == "Au"
    (tmp_path / "s.toml").write_text('[surface]\nkind = "flat"\n[material]\nkind = "lambert"\nalbedo = 0.5\n')
    case = _users_case(tmp_path / "s.toml")
    assert case.model == "oren_nayar"
    assert case.folder == tmp_path
    (tmp_path / "glass.toml").write_text(
        '[[layer]]\nsurface = {kind = "flat"}\nmaterial = {kind = "dielectric", eta = 1.5}\n'
        "medium = {sigma_a = 0.1, thickness = 2.0}\n"
        '[[layer]]\nsurface = {kind = "flat"}\nmaterial = {kind = "lambert", albedo = 0.5}\n'
    )
    assert _users_case(tmp_path / "glass.toml").model == "cook_torrance_beckmann"
    with pytest.raises(InputError, match=r"nothing\.stl: no such file"):
        Demo(tmp_path / "out", tmp_path / "nothing.stl")
    assert not (tmp_path / "out").exists()
