"""Plots, report and demo: what they show is what the table says."""

from __future__ import annotations

import numpy as np
import pytest

from fitting.result import Fit, FittedLobe
from gonio.trace.measure import measure
from microgeometry.errors import InputError
from microgeometry.specimen import parse_specimen
from renderer import plots
from renderer.demo import Demo, _users_case
from renderer.report import write_report
from tests.renderer.scenes import lambert_table


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


def test_report_holds_everything_in_one_file(table, tmp_path):
    fit = Fit("lambert", (FittedLobe("lambert", {}, {"albedo": {"grey": 0.5}}),), ("grey",))
    write_report(table, tmp_path / "r.html", {"a <fit>": fit}, [("More", "<p>words</p>")], title="A & B")
    page = (tmp_path / "r.html").read_text()
    assert page.count("data:image/png;base64,") == 3
    assert "A &amp; B" in page
    assert "a &lt;fit&gt;" in page
    assert "http" not in page  # nothing is loaded from elsewhere
    assert "all passed" in page


def test_report_of_a_table_without_error_bars(tmp_path):
    write_report(lambert_table(0.5), tmp_path / "r.html")
    assert (tmp_path / "r.html").stat().st_size > 10_000


def test_users_specimens(tmp_path):
    (tmp_path / "tile.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n")
    case = _users_case(tmp_path / "tile.obj")
    assert case.specimen.surface.kind == "mesh"
    assert case.specimen.material.name == "Au"
    (tmp_path / "s.toml").write_text('[surface]\nkind = "flat"\n[material]\nkind = "lambert"\nalbedo = 0.5\n')
    assert _users_case(tmp_path / "s.toml").model == "oren_nayar"
    with pytest.raises(InputError, match=r"nothing\.stl: no such file"):
        Demo(tmp_path / "out", tmp_path / "nothing.stl")
    assert not (tmp_path / "out").exists()
