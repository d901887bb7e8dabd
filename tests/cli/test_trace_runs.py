"""What `gonio trace` says about a run: target, merit, one realisation; and what it refuses to go on with."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from gonio import Table
from gonio.cli import build, main
from gonio.table.checks import relative_noise
from gonio.validation import seed_from

SPEC = """
[surface]
{surface}
[material]
kind = "conductor"
eta = 1.0
k = 2.0
[grid]
theta_step_deg = 15
phi_step_deg = 30
"""
RANDOM = 'kind = "gaussian"\nalpha = 0.3\nsamples = 64\nsize = 8'
GIVEN = 'kind = "heightmap"\nfile = "map.npy"\nunits = "um"\nsize = [8, 8]'


@pytest.fixture(autouse=True)
def _folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "random.toml").write_text(SPEC.format(surface=RANDOM))
    (tmp_path / "given.toml").write_text(SPEC.format(surface=GIVEN))
    rng = np.random.default_rng(seed_from("a given piece"))
    np.save(tmp_path / "map.npy", rng.normal(size=(8, 8)) * 0.1)


def gonio(line):
    """Output of a command that succeeds."""
    result = CliRunner().invoke(build(), line.split(), catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def refused(line, monkeypatch, capsys):
    """The one line of error of a command that is refused."""
    monkeypatch.setattr("sys.argv", ["gonio", *line.split()])
    with pytest.raises(SystemExit, match="2"):
        main()
    (message,) = capsys.readouterr().err.splitlines()
    return message


@pytest.mark.parametrize(
    ("target", "words"), [(0.3, "target met: cells within"), (0.001, "target NOT met: cells")]
)
def test_target_and_merit_are_printed_and_stored(target, words):
    said = gonio(f"trace random.toml -o t.h5 --rays 200000 --target-error {target}")
    assert words in said
    assert " merit " in said
    told = gonio("info t.h5")
    assert words.split(":")[0].split()[1] in told
    known = json.loads(gonio("info t.h5 --json"))
    assert known["target_met"] is (target == 0.3)
    table = Table.load("t.h5")
    variance = np.median(relative_noise(table)) ** 2
    assert known["figure_of_merit"] == pytest.approx(1 / (variance * known["seconds"]), rel=1e-5)
    assert known["figure_of_merit"] == table.provenance["figure_of_merit"]


def test_a_given_piece_says_that_it_is_one_realisation():
    for line in ("trace given.toml -o given.h5 --rays 20000", "info given.h5"):
        said = gonio(line)
        assert "realisation" in said
        assert "noise of the rays alone" in said
        assert "measure several" in said
    assert Table.load("given.h5").provenance["realisations"] == 1
    for line in ("trace random.toml -o random.h5 --rays 20000", "info random.h5"):
        assert "realisation" not in gonio(line)


def test_an_unfinished_run_is_gone_on_with_only_as_it_was_begun(monkeypatch, capsys):
    from gonio.trace.checkpoint import Checkpoint
    from gonio.trace.measure import start
    from microgeometry.specimen import load_specimen

    measurement = start(load_specimen("random.toml"), 20_000, None, 0, None)
    measurement.add_batch()
    Checkpoint("t.h5", measurement).save()
    for options, words in [
        ("--rays 20000", "add --resume"),
        ("--rays 20000 --seed 1 --resume", "begun with seed 0, not 1"),
        ("--rays 30000 --resume", "begun with rays 20000, not 30000"),
    ]:
        message = refused(f"trace random.toml -o t.h5 {options}", monkeypatch, capsys)
        assert message.startswith("gonio: t.h5.checkpoint: ")
        assert words in message
    result = CliRunner().invoke(
        build(), ["trace", "random.toml", "-o", "t.h5", "--rays", "20000", "--resume"]
    )
    assert "going on after 1 batches" in result.output
