"""Compression of a table's parts: each on its own, in one file."""

from __future__ import annotations

import h5py
import numpy as np
import pytest

from gonio.table.checks import check
from gonio.table.compress import METHODS, compress, row_errors, row_noise
from gonio.table.parts import walk
from gonio.table.table import Table
from gonio.validation import seed_from
from microgeometry.errors import InputError
from tests.table.tables import edit_record, ggx, grid, make, share
from tests.table.test_checks import poisson

pytestmark = pytest.mark.compiled

EDGES = grid(30, 30, 45)


def test_parts_are_compressed_with_the_table(tmp_path):
    """Each to the same bound in its own rows, in one file; the orders' albedos still add up."""
    wide = make(ggx(0.3, 0.5), EDGES, specular=0.05)
    narrow = make(ggx(0.15, 0.3), EDGES)
    other = make(ggx(0.2, 0.3), EDGES)
    table = wide.replace(
        values=wide.values + narrow.values,
        row_albedo=wide.row_albedo + narrow.row_albedo,
        parts={"transmission": share(narrow, 0.1).replace(parts={"L1": other}), "L1": wide, "L2+": narrow},
    )
    report = compress(table, tmp_path / "c.h5", 0.02, "tree")
    decoded = Table.load(tmp_path / "c.h5")
    before, after = dict(walk(table)), dict(walk(decoded))
    assert list(after) == list(before)
    errors = [row_errors(table, decoded.values)]
    for name, part in before.items():
        errors.append(row_errors(part, after[name].values))
        assert 0.01 < errors[-1].max() <= 0.02 * (1 + 1e-9)
        np.testing.assert_allclose(after[name].row_albedo, part.row_albedo, rtol=1e-6)
        np.testing.assert_array_equal(after[name].specular, part.specular)
        assert after[name].provenance["compression"]["max_error"] == 0.02
    assert report.error_worst == pytest.approx(np.max(errors), rel=1e-12)
    assert report.error_median == pytest.approx(np.median(errors), rel=1e-12)
    assert report.ratio == 4 * table.values.size * (1 + len(before)) / (tmp_path / "c.h5").stat().st_size
    assert report.albedo_error < 1e-6
    found = check(decoded)
    assert found.passed, found.lines()
    assert any(c.name == "orders add up to the table" for c in found.checks)
    with h5py.File(tmp_path / "c.h5") as file:
        assert list(file) == ["compressed"]


def test_parts_lose_error_bars_and_hits_and_say_their_noise(tmp_path):
    rng = np.random.default_rng(seed_from("compress parts"))
    noisy = poisson(ggx(0.5, 0.9), rng, 1e5, EDGES)
    quiet = noisy.replace(std_error=0.1 * noisy.std_error)
    report = compress(quiet.replace(parts={"transmission": noisy}), tmp_path / "c.h5", method="tree")
    decoded = Table.load(tmp_path / "c.h5")
    part = decoded.parts["transmission"]
    assert part.std_error is None
    assert part.hits is None
    facts = [t.provenance["compression"] for t in (decoded, part)]
    assert [f["noise_worst"] for f in facts] == [row_noise(t).max() for t in (quiet, noisy)]
    assert report.noise_worst == row_noise(noisy).max()


def test_a_part_that_breaks_the_bound_leaves_no_file(tmp_path, monkeypatch):
    class OnlyTheTable:
        @staticmethod
        def encode(table, bounds, quick=False):
            return {"raw": table.values if table.parts else 1.02 * table.values}

        @staticmethod
        def decode(content, fields):
            return content["raw"]

    monkeypatch.setitem(METHODS, "partial", OnlyTheTable)
    table = make(ggx(0.5, 0.9), EDGES)
    with pytest.raises(RuntimeError, match="exceeds its bound"):
        compress(table.replace(parts={"L1": share(table, 0.5)}), tmp_path / "c.h5", method="partial")
    assert list(tmp_path.iterdir()) == []


def test_damage_to_a_part_names_it(tmp_path):
    table = make(ggx(0.5, 0.9), EDGES)
    compress(table.replace(parts={"transmission": share(table, 0.5)}), tmp_path / "c.h5", method="dct")
    edit_record(tmp_path / "c.h5", lambda record: record.__delitem__("transmission/content/coefficients"))
    with pytest.raises(InputError, match=r"transmission/compressed: damaged content .'coefficients'"):
        Table.load(tmp_path / "c.h5")


def test_a_part_that_the_chosen_method_cannot_hold_falls_back(tmp_path, monkeypatch):
    class OnlyTheTable:
        @staticmethod
        def encode(table, bounds, quick=False):
            if not table.parts:
                raise InputError("max_error: no step of quantisation holds it")
            return {"none": np.zeros(1)}

        @staticmethod
        def decode(content, fields):
            return table.values

    table = make(ggx(0.5, 0.9), EDGES)
    table = table.replace(parts={"L1": share(table, 0.5)})
    monkeypatch.setitem(METHODS, "picky", OnlyTheTable)
    report = compress(table, tmp_path / "c.h5")
    assert report.method == "picky"
    decoded = Table.load(tmp_path / "c.h5")
    assert decoded.provenance["compression"]["method"] == "picky"
    assert decoded.parts["L1"].provenance["compression"]["method"] == "tree"
    with pytest.raises(InputError, match="no step"):
        compress(table, tmp_path / "c.h5", method="picky")
