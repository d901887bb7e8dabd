"""The command line on an anisotropic table: what works, and one line from what does not."""

import json

import numpy as np
import pytest

from gonio import Table
from gonio.core.jit import disabled
from tests.cli.test_commands import gonio

pytestmark = [pytest.mark.skipif(disabled, reason="needs compiled kernels"), pytest.mark.compiled]

SPEC = """
[surface]
kind = "gaussian"
alpha = 0.3
correlation_length = [1, 4]
samples = 128
[material]
kind = "mirror"
[grid]
anisotropic = true
theta_i_deg = [0, 30, 60]
phi_i_step_deg = 45
tilt_cells = 17
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("anisotropic")
    (path / "spec.toml").write_text(SPEC)
    run = gonio("trace", "spec.toml", "-o", "t.h5", "--rays", 200_000, cwd=path)
    assert run.returncode == 0, run.stderr
    assert "albedo 1.0000" in run.stdout
    return path


def test_trace(folder):
    table = Table.load(folder / "t.h5")
    assert table.energy.shape == (3, 8, 17, 17, 1)
    assert table.provenance["command"].startswith("gonio trace spec.toml")
    assert table.provenance["specimen"] == SPEC


def test_info(folder):
    run = gonio("info", "t.h5", cwd=folder)
    assert run.returncode == 0, run.stderr
    assert "3 theta_i x 8 phi_i x 17 x 17 cells" in run.stdout
    data = json.loads(gonio("info", "t.h5", "--json", cwd=folder).stdout)
    assert data["phi_i_deg"] == pytest.approx([0, 45, 90, 135, 180, 225, 270, 315])
    assert data["albedo"][2][5] == pytest.approx([1.0])
    assert data["ledger"]["paths"] >= 200_000
    assert data["anisotropic"] is True


def test_check(folder):
    run = gonio("check", "t.h5", cwd=folder)
    assert run.returncode == 0, run.stdout + run.stderr
    data = json.loads(gonio("check", "t.h5", "--json", cwd=folder).stdout)
    assert data["passed"]
    assert {"reciprocity", "energy", "noise", "ledger"} <= set(data["checks"])


@pytest.mark.parametrize(
    "arguments",
    [
        ("compress", "t.h5", "-o", "c.h5"),
        ("convert", "t.h5", "t.binary"),
        ("fit", "t.h5", "--model", "ward"),
        ("convert", "t.h5", "t.npz"),
    ],
)
def test_what_is_for_isotropic_tables_says_so(folder, arguments):
    run = gonio(*arguments, cwd=folder)
    assert run.returncode == 2
    (line,) = run.stderr.strip().splitlines()[-1:]
    assert "an anisotropic table" in line
    assert "trace the specimen without anisotropic = true" in line
    assert "Traceback" not in run.stderr
    assert not (folder / arguments[-1]).exists()


def test_report_shows_it_at_several_azimuths(folder):
    run = gonio("report", "t.h5", "-o", "r.html", cwd=folder)
    assert run.returncode == 0, run.stderr
    page = (folder / "r.html").read_text()
    for heading in ("Measurement", "Where the light went", "Checks", "Hemisphere", "Directional albedo"):
        assert f"<h2>{heading}</h2>" in page
    assert page.count("data:image/png") >= 3
    assert "reciprocity" in page


def test_convert_to_h5_keeps_it(folder):
    run = gonio("convert", "t.h5", "copy.h5", cwd=folder)
    assert run.returncode == 0, run.stderr
    table, copy = Table.load(folder / "t.h5"), Table.load(folder / "copy.h5")
    assert np.array_equal(table.energy, copy.energy)
    assert table.provenance == copy.provenance
    run = gonio("convert", "t.h5", "part.h5", "--part", "transmission", cwd=folder)
    assert run.returncode == 2
    assert "the table has no 'transmission'; its parts are: none" in run.stderr


def test_a_format_that_cannot_hold_it_is_refused_before_the_trace(folder):
    run = gonio("trace", "spec.toml", "-o", "t.binary", "--rays", 10**12, cwd=folder)
    assert run.returncode == 2
    assert "can only be written as .h5" in run.stderr


def test_the_demo_refuses(folder):
    run = gonio("demo", "--specimen", "spec.toml", "--out", "demo", cwd=folder)
    assert run.returncode == 2
    assert "leave out anisotropic = true" in run.stderr
