"""The command line: every command once on small input, and bad input as one line with exit status 2."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from gonio import Table
from gonio.cli import main
from gonio.trace.measurement import Measurement
from tests.table.tables import grid, lambert, make, with_parts

SPEC = """
[surface]
kind = "gaussian"
alpha = 0.5
samples = 64
size = 8
[material]
kind = "conductor"
name = "Au"
[grid]
theta_step_deg = 10
phi_step_deg = 20
"""


def gonio(*arguments, cwd, **options):
    return subprocess.run(
        [sys.executable, "-c", "from gonio.cli import main; main()", *map(str, arguments)],
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
        **options,
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a specimen and its traced table."""
    path = tmp_path_factory.mktemp("cli")
    (path / "spec.toml").write_text(SPEC)
    run = gonio("trace", "spec.toml", "-o", "t.h5", "--rays", 200_000, "--seed", 3, cwd=path)
    assert run.returncode == 0, run.stderr
    return path


def test_trace_leaves_a_table_that_knows_where_it_came_from(folder):
    table = Table.load(folder / "t.h5")
    assert table.channels == ("R", "G", "B")
    assert table.provenance["specimen"] == SPEC
    assert table.provenance["seed"] == 3
    assert table.provenance["command"].startswith("gonio trace spec.toml")
    assert table.provenance["surface"]["alpha"] == pytest.approx(0.5, rel=0.2)


def test_info_json(folder):
    run = gonio("info", "t.h5", "--json", cwd=folder)
    data = json.loads(run.stdout)
    assert len(data["theta_i_deg"]) == 9
    for name in ("albedo", "albedo_std_error", "specular", "transmittance"):
        assert np.shape(data[name]) == (9, 3)
    assert set(data["ledger"]) == {"paths", "reflected", "transmitted", "absorbed", "killed", "lost"}
    for name in ("estimator", "batches", "seconds", "paths_per_second", "figure_of_merit", "target_met", "surface",
                 "provenance", "bytes"):  # fmt: skip
        assert name in data
    assert data["bytes"] == (folder / "t.h5").stat().st_size
    # nothing goes through gold
    assert not np.any(data["transmittance"])
    assert not np.any(data["transmittance_std_error"])
    assert data["parts"] == {}


@pytest.fixture(scope="module")
def split(folder):
    """The table with transmission, orders of bounces and absorption in layers."""
    table = with_parts(Table.load(folder / "t.h5").replace(specular=0.01))
    absorbed = {
        "absorbed: layer 1 surface": table.ledger["absorbed"] - 12.5,
        "absorbed: layer 1 medium": 12.5,
    }
    table = table.replace(ledger={**table.ledger, **absorbed})
    table.save(folder / "split.h5")
    return table


def test_info_json_of_parts(folder, split):
    data = json.loads(gonio("info", "split.h5", "--json", cwd=folder).stdout)
    below = split.parts["transmission"]
    assert data["transmittance"] == below.row_albedo.tolist()
    assert data["transmittance_std_error"] == below.albedo_std_error.tolist()
    assert list(data["parts"]) == ["transmission", "L1", "L2", "L3+"]
    for found, part in (
        (data["parts"]["transmission"], below),
        (data["parts"]["L2"], split.parts["L2"]),
        (data["parts"]["transmission"]["parts"]["L3+"], below.parts["L3+"]),
    ):
        assert found["albedo"] == part.row_albedo.tolist()
        assert found["albedo_std_error"] == part.albedo_std_error.tolist()
        assert found["specular"] == part.specular.tolist()
        assert list(found["parts"]) == list(part.parts)
    assert data["ledger"]["absorbed: layer 1 medium"] == 12.5


def test_info_of_parts_for_people(folder, split):
    lines = gonio("info", "split.h5", cwd=folder).stdout.splitlines()
    below = split.parts["transmission"]
    at = [n for n, line in enumerate(lines) if line.startswith("theta_i  ")]
    titles = [lines[n].split("  ")[1] for n in at]
    assert titles == [
        "albedo (+- standard error) [specular] in each channel",
        "albedo by number of bounces, mean over channels",
        "transmittance (+- standard error) [specular] in each channel",
        "transmittance by number of bounces, mean over channels",
    ]
    row = 4  # of nine rows, all are shown
    assert f"{below.row_albedo[row, 1]:.5f} +- {below.albedo_std_error[row, 1]:.1e}" in lines[at[2] + 1 + row]
    for n, whole in ((at[1], split), (at[3], below)):
        assert lines[n + 1].split() == ["L1", "L2", "L3+"]
        means = [f"{whole.parts[name].row_albedo[row].mean():.5f}" for name in ("L1", "L2", "L3+")]
        assert lines[n + 2 + row].split()[1:] == means
    assert any(line.split() == ["absorbed:", "layer", "1", "medium", "12.5"] for line in lines)


def test_info_claims_no_error_bars_that_are_not_known(tmp_path):
    table = make(lambert, grid(3, 9, 12), tint=(0.5,))
    gaps = np.zeros(table.values.shape[:3], bool)
    gaps[:, 5:] = True
    values = np.where(gaps[..., None], 0.0, table.values)
    table.replace(values=values, gaps=gaps).save(tmp_path / "measured.h5")
    data = json.loads(gonio("info", "measured.h5", "--json", cwd=tmp_path).stdout)
    assert data["albedo_std_error"] == [[None]] * 3
    assert data["gaps"] == pytest.approx(np.cos(np.radians(50)) ** 2)
    text = gonio("info", "measured.h5", cwd=tmp_path).stdout
    assert "+-" not in text
    assert "gaps          41.3 % of the projected solid angle: the albedo is of the rest" in text
    assert f"{table.row_albedo[1, 0]:.5f} [0.0000]" in text


def test_convert_a_part(folder, split):
    whole = gonio("convert", "split.h5", "copy.h5", cwd=folder)
    assert whole.stdout == "copy.h5: written\n"
    assert list(Table.load(folder / "copy.h5").parts) == list(split.parts)
    below = split.parts["transmission"]
    for part, expected in (("transmission", below), ("transmission/L2", below.parts["L2"])):
        run = gonio("convert", "split.h5", "part.h5", "--part", part, cwd=folder)
        assert run.stdout == "part.h5: written\n"
        table = Table.load(folder / "part.h5")
        np.testing.assert_array_equal(table.values, expected.values)
        assert list(table.parts) == list(expected.parts)
        assert table.provenance["part"] == part
        assert f"part          {part}" in gonio("info", "part.h5", cwd=folder).stdout
    run = gonio("convert", "split.h5", "none.h5", "--part", "L4", cwd=folder)
    assert run.returncode == 2
    assert run.stderr == (
        "gonio: split.h5: part: the table has no 'L4'; its parts are: transmission, transmission/L1, "
        "transmission/L2, transmission/L3+, L1, L2, L3+\n"
    )
    assert not (folder / "none.h5").exists()


def test_info_for_people(folder):
    run = gonio("info", "t.h5", cwd=folder)
    assert "albedo" in run.stdout
    assert "reflected" in run.stdout


def test_check_compress_convert_fit_tabulate_report(folder):
    check = gonio("check", "t.h5", "--json", cwd=folder)
    assert check.returncode == 0
    assert json.loads(check.stdout)["passed"] is True
    compress = json.loads(
        gonio("compress", "t.h5", "-o", "c.h5", "--max-error", 0.02, "--json", cwd=folder).stdout
    )
    assert compress["bytes"] == (folder / "c.h5").stat().st_size
    convert = gonio("convert", "t.h5", "t.binary", cwd=folder)
    assert (folder / "t.binary").stat().st_size == 34_992_012
    assert "lost" in convert.stdout
    fit = gonio("fit", "t.h5", "--model", "cook_torrance_beckmann", "-o", "f.json", cwd=folder)
    assert fit.returncode == 0, fit.stderr
    alpha = json.loads((folder / "f.json").read_text())["lobes"][0]["parameters"]["alpha"]
    assert alpha == pytest.approx(Table.load(folder / "t.h5").provenance["surface"]["alpha"], rel=0.15)
    assert gonio("tabulate", "f.json", "-o", "m.h5", cwd=folder).returncode == 0
    report = gonio("report", "t.h5", "f.json", "-o", "r.html", cwd=folder)
    assert report.returncode == 0, report.stderr
    page = (folder / "r.html").read_text()
    assert page.count("<img") == 4  # the surface, lobes, albedo, hemisphere
    assert "alpha" in page


def test_check_fails_a_table_that_creates_energy(folder):
    table = Table.load(folder / "t.h5")
    table.replace(values=table.values * 1.5, row_albedo=table.row_albedo * 1.5, ledger={}).save(
        folder / "bright.h5"
    )
    run = gonio("check", "bright.h5", cwd=folder)
    assert run.returncode == 1
    assert "energy" in run.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("trace", "missing.toml", "-o", "x.h5"), "missing.toml"),
        (("trace", "spec.toml", "-o", "nowhere/x.h5"), "does not exist"),
        (("trace", "spec.toml", "-o", "x.h6"), "suffix"),
        (("trace", "spec.toml", "-o", "x.h5", "--rays", "0"), "rays: 0"),
        (("trace", "spec.toml", "-o", "x.h5", "--rays", "5", "--time", "5"), "both"),
        (("trace", "bad.toml", "-o", "x.h5"), "alpa"),
        (("info", "spec.toml"), "suffix"),
        (("info", "truncated.h5"), "truncated.h5"),
        (("info", "foreign.h5"), "foreign.h5"),
        (("compress", "t.h5", "-o", "x.h5", "--max-error", "-1"), "max_error"),
        (("fit", "t.h5", "--model", "cook_torance_ggx"), "cook_torrance_ggx"),
        (("convert", "t.h5", "t.xyz"), "suffix"),
        (("render", "missing.xml", "-o", "x.exr"), "missing.xml"),
        (("report", "t.h5", "missing.json", "-o", "x.html"), "missing.json"),
        (("demo", "--specimen", "missing.obj"), "missing.obj"),
        (("bench", "nothing"), "nothing"),
    ],
)
def test_bad_input_is_one_line_and_exit_status_2(folder, arguments, words):
    (folder / "bad.toml").write_text(SPEC.replace("alpha", "alpa"))
    whole = (folder / "t.h5").read_bytes()
    (folder / "truncated.h5").write_bytes(whole[: len(whole) // 2])
    (folder / "foreign.h5").write_bytes(b"not a table at all")
    before = set(folder.iterdir())
    run = gonio(*arguments, cwd=folder)
    assert run.returncode == 2
    assert words in run.stderr
    assert run.stderr.startswith("gonio: ")
    assert run.stderr.count("\n") == 1
    assert set(folder.iterdir()) - before <= {folder / "gonio-demo"}


def test_ctrl_c_saves_what_there_is(folder, monkeypatch, capsys):
    whole = Measurement.add_batch

    def third_time_interrupted(self):
        if self.tally.batches == 2:
            raise KeyboardInterrupt
        whole(self)

    monkeypatch.setattr(Measurement, "add_batch", third_time_interrupted)
    out = folder / "stopped.h5"
    monkeypatch.setattr(sys, "argv", ["gonio", "trace", str(folder / "spec.toml"), "-o", str(out)])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 130
    assert "interrupted after 2 of" in capsys.readouterr().err
    table = Table.load(out)
    assert table.provenance["interrupted"] is True
    assert table.provenance["batches"] == 2


def test_ctrl_c_before_the_first_batch_leaves_nothing(folder, monkeypatch, capsys):
    def interrupted(self):
        raise KeyboardInterrupt

    monkeypatch.setattr(Measurement, "add_batch", interrupted)
    out = folder / "never.h5"
    monkeypatch.setattr(sys, "argv", ["gonio", "trace", str(folder / "spec.toml"), "-o", str(out)])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 130
    assert capsys.readouterr().err.strip() == "gonio: interrupted"
    assert not out.exists()
