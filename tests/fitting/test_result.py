from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from fitting import Fit, fit
from fitting.models.dispatch import lobe_eval
from fitting.tabulate import directional_albedo
from gonio.table.table import Table
from microgeometry.errors import InputError

from .materials import gold, grid, material, polar

LAMBERT = {
    "model": "lambert",
    "lobes": [{"name": "lambert", "coefficients": {"albedo": {"R": 0.5, "G": 0.2}}}],
}
GGX = {
    "model": "cook_torrance_ggx",
    "lobes": [
        {"name": "ggx", "parameters": {"alpha": 0.3}, "coefficients": {"f0": {"Y": 0.9}, "f90": {"Y": 1.0}}}
    ],
}


def written(folder: Path, content: object) -> Path:
    path = folder / "FIT.json"
    path.write_text(json.dumps(content))
    return path


def changed(content: dict, *path: str | int, to: object) -> dict:
    out = json.loads(json.dumps(content))
    at = out
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = to
    return out


def test_a_minimal_file_is_enough(tmp_path: Path) -> None:
    loaded = Fit.load(written(tmp_path, LAMBERT))
    assert loaded.channels == ("R", "G")
    kinds, shapes, weights = loaded.terms()
    value = sum(
        w * lobe_eval(k, p, polar(10.0), polar(50.0)) for k, p, w in zip(kinds, shapes, weights, strict=True)
    )
    assert value == pytest.approx(np.array([0.5, 0.2]) / math.pi)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([], "content"),
        ({}, "model: missing"),
        (changed(LAMBERT, "model", to="lambrt"), "did you mean lambert"),
        (changed(LAMBERT, "colour", to=1), "unknown 'colour'"),
        (changed(LAMBERT, "schema", to="gonio-fit/9"), "another version"),
        (changed(LAMBERT, "lobes", to=[]), "lobes: empty"),
        (changed(LAMBERT, "lobes", 0, "name", to="ggx"), "no lobe of this model"),
        (
            changed(LAMBERT, "lobes", 0, "coefficients", "albedo", "R", to=-0.1),
            "albedo.R: -0.1; a number >= 0",
        ),
        (changed(LAMBERT, "lobes", 0, "coefficients", "albedo", "R", to=float("nan")), "albedo.R: nan"),
        (changed(LAMBERT, "lobes", 0, "coefficients", "albedo", "R", to="x"), "albedo.R: 'x'"),
        (changed(LAMBERT, "lobes", 0, "coefficients", to={}), "albedo is missing"),
        (changed(LAMBERT, "lobes", 0, "coefficients", "albedo", to={}), "channels: none"),
        (changed(LAMBERT, "wavelengths_nm", to=[550]), "2 positive numbers"),
        (
            changed(GGX, "lobes", 0, "parameters", "alpha", to=-0.3),
            r"parameters.alpha: -0.3; .* from 0.001 to 2",
        ),
        (changed(GGX, "lobes", 0, "parameters", "alpha", to=None), "parameters.alpha: None"),
        (changed(GGX, "lobes", 0, "parameters", to={}), "alpha is missing"),
        (changed(GGX, "lobes", 0, "parameters", "beta", to=1.0), "unknown 'beta'"),
        (changed(GGX, "lobes", 0, "coefficients", "f90", to={"R": 1.0}), "all must be the same"),
    ],
)
def test_bad_files_are_one_clear_line(tmp_path: Path, content: object, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        Fit.load(written(tmp_path, content))
    assert "\n" not in str(caught.value)
    assert "FIT.json" in str(caught.value)


def test_missing_and_foreign_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        Fit.load(tmp_path / "none.json")
    (tmp_path / "x.json").write_bytes(b"\x89HDF\r\n")
    with pytest.raises(InputError, match="not a JSON file"):
        Fit.load(tmp_path / "x.json")


@pytest.mark.compiled
def test_round_trip_of_a_fit(tmp_path: Path) -> None:
    found = fit(gold(0.4).table(grid(6, 20, 40)), "cook_torrance_beckmann")
    found.save(tmp_path / "FIT.json")
    assert Fit.load(tmp_path / "FIT.json").to_json() == json.loads(found.dumps())
    assert [p.name for p in tmp_path.iterdir()] == ["FIT.json"]
    assert set(found.residuals) == {"ngan_l2", "relative_ngan_l2", "low_log", "nbrdf", "cube_root"}
    assert found.seconds > 0
    assert found.versions["nlopt"]


@pytest.mark.compiled
@pytest.mark.parametrize("truth", [gold(0.5), gold(0.06), gold(0.2, "ggx")], ids=["rough", "sharp", "ggx"])
def test_albedo_of_a_table_is_the_models(truth: Fit) -> None:
    angles = [0.0, 30.0, 60.0, 80.0]
    table = truth.table(grid(0, 45, 90, theta_i_deg=angles))
    for row, angle in enumerate(angles):
        # two independent integrals: cell quadrature, and the lobe's own sampling
        assert table.row_albedo[row] == pytest.approx(
            directional_albedo(truth, math.radians(angle)), rel=2e-3
        )
    assert table.theta_i_edges is None


@pytest.mark.compiled
def test_lambert_is_exact_in_every_cell() -> None:
    table = material("lambert", ("lambert", {}, {"albedo": (0.9, 0.5, 0.0)})).table(grid(5, 7, 9))
    assert table.values == pytest.approx(
        np.broadcast_to(np.array([0.9, 0.5, 0.0]) / math.pi, table.values.shape)
    )
    assert table.row_albedo == pytest.approx(np.broadcast_to([0.9, 0.5, 0.0], table.row_albedo.shape))


@pytest.mark.compiled
def test_cell_averages_are_reciprocal() -> None:
    # rows that are cells: the average over (row i, ring r) is that over (row r, ring i)
    table = gold(0.3).table(grid(12, 12, 16))
    assert table.values == pytest.approx(np.swapaxes(table.values, 0, 1), rel=2e-4)


@pytest.mark.compiled
def test_a_model_that_creates_energy_says_so() -> None:
    bright = fit(
        material("lambert", ("lambert", {}, {"albedo": (1.2, 0.5, 0.1)})).table(grid(4, 4, 4)), "lambert"
    )
    assert bright.albedo["largest"] == pytest.approx(1.2, rel=1e-6)
    assert not bright.albedo["conserves_energy"]


@pytest.mark.compiled
def test_zero_model_is_a_zero_table() -> None:
    table = material("lambert", ("lambert", {}, {"albedo": (0.0, 0.0, 0.0)})).table(grid(2, 2, 2))
    assert isinstance(table, Table)
    assert not table.values.any()
