from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from fitting import Fit
from fitting.commands import COMMANDS, fit_command, fit_merl_command, tabulate_command
from gonio.bench import BENCHMARKS
from gonio.table.table import Table
from microgeometry.errors import InputError

from .materials import gold, grid

pytestmark = pytest.mark.compiled


def run(command, *arguments: object):
    return CliRunner().invoke(command, [str(a) for a in arguments], standalone_mode=False)


def test_names() -> None:
    assert [c.name for c in COMMANDS] == ["fit", "fit-merl", "tabulate"]


def test_fit_writes_json_and_prints_it(tmp_path: Path) -> None:
    gold(0.4).table(grid(6, 20, 40)).save(tmp_path / "T.h5")
    result = run(
        fit_command,
        tmp_path / "T.h5",
        "--model",
        "cook_torrance_beckmann",
        "-o",
        tmp_path / "F.json",
        "--json",
    )
    assert result.exception is None, result.exception
    printed = json.loads(result.stdout)
    assert printed["lobes"][0]["parameters"]["alpha"] == pytest.approx(0.4, rel=1e-3)
    assert json.loads((tmp_path / "F.json").read_text()) == printed

    words = run(fit_command, tmp_path / "T.h5", "--model", "cook_torrance_beckmann").stdout
    assert "beckmann: alpha 0." in words
    assert "above 80 degrees" in words


def test_of_many_channels_a_few_are_told(tmp_path: Path) -> None:
    one, channels = gold(0.4).table(grid(3, 6, 8)), tuple(f"{n} nm" for n in range(400, 411))
    Table(
        values=one.values[..., [0] * 11],
        theta_i=one.theta_i,
        theta_r_edges=one.theta_r_edges,
        delta_phi_edges=one.delta_phi_edges,
        channels=channels,
        row_albedo=one.row_albedo[:, [0] * 11],
        theta_i_edges=one.theta_i_edges,
        wavelengths_nm=tuple(range(400, 411)),
    ).save(tmp_path / "T.h5")
    told = run(fit_command, tmp_path / "T.h5", "--model", "lambert", "-o", tmp_path / "F.json")
    assert told.exception is None, told.exception
    assert [word in told.stdout for word in ("400 nm 0.", "405 nm 0.", "410 nm 0.", "401 nm")] == [
        True,
        True,
        True,
        False,
    ]
    assert len(Fit.load(tmp_path / "F.json").lobes[0].coefficients["albedo"]) == 11


def test_tabulate_a_hand_written_file(tmp_path: Path) -> None:
    content = {
        "model": "cook_torrance_ggx",
        "lobes": [
            {
                "name": "ggx",
                "parameters": {"alpha": 0.3},
                "coefficients": {"f0": {"Y": 0.9}, "f90": {"Y": 1.0}},
            },
            {"name": "lambert", "coefficients": {"albedo": {"Y": 0.05}}},
        ],
    }
    (tmp_path / "F.json").write_text(json.dumps(content))
    result = run(tabulate_command, tmp_path / "F.json", "-o", tmp_path / "T.h5")
    assert result.exception is None, result.exception
    table = Table.load(tmp_path / "T.h5")
    assert table.values.shape == (90, 90, 180, 1)
    assert np.all(table.row_albedo < 1.0)
    assert Fit.load(tmp_path / "F.json").channels == table.channels


def test_bad_input_raises_what_the_command_line_reports(tmp_path: Path) -> None:
    assert isinstance(
        run(fit_command, tmp_path / "none.h5", "--model", "lambert").exception, (InputError, OSError)
    )
    result = run(fit_command, tmp_path / "none.h5", "--model", "lambertian")
    assert isinstance(result.exception, InputError)
    assert "did you mean lambert" in str(result.exception)
    assert isinstance(
        run(tabulate_command, tmp_path / "none.json", "-o", tmp_path / "T.h5").exception, InputError
    )


def test_networks_that_are_not_there(tmp_path: Path) -> None:
    result = run(fit_merl_command, tmp_path)
    assert isinstance(result.exception, InputError)
    assert "nbrdf_weights.npz: does not exist" in str(result.exception)
    np.savez(tmp_path / "nbrdf_weights.npz", **{"rgl/other|0": np.zeros(1)})
    assert "no array is called merl/" in str(run(fit_merl_command, tmp_path).exception)


def test_the_benchmark_of_fits_is_registered() -> None:
    assert callable(import_module(BENCHMARKS["fit"]).run)
