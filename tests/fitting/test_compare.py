"""Ranked models, numbers of lobes, several tables: in Python and at the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from fitting import Fit, fit
from fitting.commands import _rank, fit_command
from fitting.compare import fit_lobes, fit_models, isotropic_models, with_lobes
from fitting.fit import LATE
from fitting.models import MODELS, find_model
from microgeometry.errors import InputError

from .exact import MODELS as KNOWN
from .materials import counted, gold, grid, material


def noisy(model: str):
    table = material(model, *KNOWN[model]).table(grid(6, 24, 36))
    return counted(table, 400_000, np.random.default_rng(4))


def test_glossy_lobes_are_repeated_and_diffuse_ones_are_not() -> None:
    assert with_lobes(find_model("cook_torrance_ggx"), 3).name == "ggx+ggx+ggx+lambert"
    assert with_lobes(find_model("hanrahan_krueger"), 2).name == "hanrahan_krueger+beckmann+beckmann"
    assert with_lobes(find_model("oren_nayar"), 1) is MODELS["oren_nayar"]
    with pytest.raises(InputError, match="eon has no glossy lobe"):
        with_lobes(find_model("eon"), 2)
    with pytest.raises(InputError, match="lobes: 0"):
        with_lobes(find_model("ward"), 0)


def test_anisotropic_models_are_not_among_all() -> None:
    names = isotropic_models()
    assert "ward" in names
    assert not [name for name in names if "anisotropic" in name]


@pytest.mark.compiled
@pytest.mark.parametrize(("truth", "lobes"), [("cook_torrance_ggx", 1), ("ggx+ggx+lambert", 2)])
def test_automatic_lobes_stop_at_the_truth(truth: str, lobes: int) -> None:
    found = fit_lobes(noisy(truth), "cook_torrance_ggx", "auto")
    assert [lobe.name for lobe in found.lobes].count("ggx") == lobes


@pytest.mark.compiled
def test_numbers_of_lobes_that_come_to_the_same_are_ranked_once() -> None:
    table = noisy("cook_torrance_ggx")
    found = fit_models(table, ["cook_torrance_ggx"], (1, "auto"))
    assert [each.model for each in found] == ["cook_torrance_ggx"]


@pytest.mark.compiled
def test_automatic_lobes_of_a_diffuse_model() -> None:
    assert fit_lobes(noisy("oren_nayar"), "oren_nayar", "auto").model == "oren_nayar"


@pytest.mark.compiled
def test_more_lobes_never_fit_worse() -> None:
    table = gold(0.3, "ggx").table(grid(6, 24, 36))
    errors = [fit_lobes(table, "ward", k).residuals["ngan_l2"] for k in (1, 2, 3)]
    assert errors[1] <= errors[0] * (1 + 1e-9)
    assert errors[2] <= errors[1] * (1 + 1e-9)


@pytest.mark.compiled
@pytest.mark.parametrize("truth", ["oren_nayar", "cook_torrance_1982"])
def test_the_model_a_table_was_made_of_ranks_first(truth: str) -> None:
    fits = fit_models(noisy(truth), ["lambert", "oren_nayar", "cook_torrance_1982", "cook_torrance_ggx"])
    assert fits[0].model == truth
    criteria = [each.criterion for each in fits]
    assert criteria == sorted(criteria)
    # by hand: chi2 + unknowns x ln(values)
    best = fits[0]
    values = best.cells_used * 3
    unknowns = values - best.degrees_of_freedom
    assert best.criterion == pytest.approx(best.residuals["chi2"] + unknowns * np.log(values))


@pytest.mark.compiled
def test_a_wrong_model_says_so_and_a_right_one_does_not() -> None:
    table = noisy("cook_torrance_1982")
    right, wrong = fit(table, "cook_torrance_1982"), fit(table, "cook_torrance_ggx")
    assert right.goodness["p_value"] > 1e-3
    assert wrong.goodness["p_value"] < 1e-6
    assert not [note for note in right.notes if "does not describe" in note]
    assert [note for note in wrong.notes if "does not describe" in note]


def run(*arguments: object):
    return CliRunner().invoke(fit_command, [str(a) for a in arguments], standalone_mode=False)


@pytest.mark.compiled
def test_several_tables_models_and_lobes_in_one_command(tmp_path: Path) -> None:
    for name in ("A", "B"):
        noisy("cook_torrance_ggx").save(tmp_path / f"{name}.h5")
    several = run(
        tmp_path / "A.h5", tmp_path / "B.h5", "--model", "ward", "--lobes", "1,2", "-o", tmp_path / "F.json"
    )
    assert several.exception is None, several.exception
    assert "all 2 tables: median" in several.stdout
    content = json.loads((tmp_path / "F.json").read_text())
    assert [len(fits) for fits in content["tables"].values()] == [2, 2]
    with pytest.raises(InputError, match="fits of 2 tables"):
        Fit.load(tmp_path / "F.json")

    one = run(tmp_path / "A.h5", "--model", "ward", "--lobes", "1,2", "-o", tmp_path / "G.json", "--json")
    assert one.exception is None, one.exception
    assert json.loads(one.stdout) == json.loads((tmp_path / "G.json").read_text())
    assert Fit.load(tmp_path / "G.json").model in ("ward", "ward+ward+lambert")


@pytest.mark.compiled
def test_a_ranked_fit_that_creates_energy_says_so(tmp_path: Path) -> None:
    """A Lambertian table of albedo 1.2 and one of 0.8: only the fit of the first may not be."""
    for name, albedo in (("bright", 1.2), ("dark", 0.8)):
        table = material("lambert", ("lambert", {}, {"albedo": (albedo, 0.5, 0.5)})).table(grid(6, 12, 18))
        table.save(tmp_path / f"{name}.h5")
    ranked = run(tmp_path / "bright.h5", tmp_path / "dark.h5", "--model", "lambert")
    assert ranked.exception is None, ranked.exception
    lines = [line for line in ranked.stdout.splitlines() if line.startswith("   1  lambert ")]
    assert [line.endswith("  creates energy") for line in lines] == [True, False]
    assert [float(line.split()[5]) for line in lines] == pytest.approx([1.2, 0.8], abs=2e-3)


def test_a_fit_that_ran_out_of_time_is_marked(capsys: pytest.CaptureFixture[str]) -> None:
    whole = gold(0.3).replace(
        criterion=1.0, cells_used=5, residuals={"relative_ngan_l2": 0.1, "low_log": 0.2}, objective="ngan_l2",
        albedo={"largest": 0.9, "conserves_energy": True},
    )  # fmt: skip
    _rank("T", [whole, whole.replace(notes=(LATE,))])
    *_, first, second = capsys.readouterr().out.splitlines()
    assert second == first.replace("1", "2", 1) + "  time limit"


@pytest.mark.compiled
def test_several_models_judge_the_errors_of_a_table_as_one_does() -> None:
    table = noisy("cook_torrance_ggx")
    one = fit(table, "ward").goodness
    assert fit_models(table, ["ward"])[0].goodness == one
    assert one["chi2_std"] > 0.03 * one["degrees_of_freedom"]  # of 1 % where the errors were known


@pytest.mark.compiled
def test_polar_angles_beyond_a_limit_that_is_given(tmp_path: Path) -> None:
    """A goniometer that looked at grazing angles only."""
    gold(0.4).table(grid(2, 18, 18, theta_i_deg=[82.0, 86.0])).save(tmp_path / "T.h5")
    beyond = run(tmp_path / "T.h5", "--model", "cook_torrance_beckmann")
    assert "give a higher --theta-limit" in str(beyond.exception)
    found = run(tmp_path / "T.h5", "--model", "cook_torrance_beckmann", "--theta-limit", 90, "--json")
    assert found.exception is None, found.exception
    told = json.loads(found.stdout)
    assert told["theta_limit_deg"] == 90
    assert told["lobes"][0]["parameters"]["alpha"] == pytest.approx(0.4, rel=1e-3)
    assert "theta limit: 91" in str(run(tmp_path / "T.h5", "--model", "ward", "--theta-limit", 91).exception)


def test_where_the_fit_goes_is_looked_at_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = run(tmp_path / "none.h5", "--model", "ward", "-o", tmp_path / "nowhere" / "F.json")
    assert "nowhere does not exist; create it first" in str(result.exception)
    monkeypatch.setattr("gonio.files.os.access", lambda *_: False)  # root may write anywhere
    assert "not writable" in str(run("none.h5", "--model", "ward", "-o", tmp_path / "F.json").exception)


@pytest.mark.parametrize("lobes", ["0", "x", "1,", "-1", "1.5"])
def test_lobes_that_are_no_number(tmp_path: Path, lobes: str) -> None:
    result = run(tmp_path / "none.h5", "--model", "ward", f"--lobes={lobes}")
    assert isinstance(result.exception, InputError)
    assert "lobes" in str(result.exception)
