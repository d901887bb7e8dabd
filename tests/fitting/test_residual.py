"""Compression by a fit and its residual: the bound holds, what the model explains costs next to nothing."""

from __future__ import annotations

import numpy as np
import pytest

import fitting.residual
from fitting.residual import MODEL
from fitting.result import Fit
from gonio.table.compress import METHODS, compress, row_errors
from gonio.table.table import Table
from microgeometry.errors import InputError
from tests.table.tables import asymmetric, edit_record, grid, make

pytestmark = pytest.mark.compiled

EDGES = grid(20, 20, 30)


def model_table(tmp_path):
    """A table that the model describes exactly."""
    path = tmp_path / "fit.json"
    path.write_text(
        '{"model": "cook_torrance_ggx", "lobes": ['
        '{"name": "ggx", "parameters": {"alpha": 0.3}, '
        '"coefficients": {"f0": {"R": 0.9, "G": 0.6, "B": 0.3}, "f90": {"R": 1.0, "G": 0.9, "B": 0.8}}},'
        '{"name": "lambert", "parameters": {}, "coefficients": {"albedo": {"R": 0.1, "G": 0.1, "B": 0.2}}}]}'
    )
    return Fit.load(path).table(make(asymmetric, EDGES))


def test_it_is_registered():
    assert METHODS["residual"] is fitting.residual


def test_what_the_model_explains_costs_nothing(tmp_path):
    table = model_table(tmp_path)
    report = compress(table, tmp_path / "c.h5", 0.01, "residual")
    assert row_errors(table, Table.load(tmp_path / "c.h5").values).max() <= 0.01
    content: dict = {}
    edit_record(tmp_path / "c.h5", content.update)
    assert content["content/tree"].size < 120
    assert MODEL.encode() in bytes(content["content/model"])
    assert report.bytes < compress(table, tmp_path / "t.h5", 0.01, "tree").bytes


@pytest.mark.parametrize("max_error", [0.05, 1e-3])
def test_what_it_does_not_explain_is_in_the_residual(tmp_path, max_error):
    table = make(asymmetric, EDGES)
    compress(table, tmp_path / "c.h5", max_error, "residual")
    decoded = Table.load(tmp_path / "c.h5")
    assert row_errors(table, decoded.values).max() <= max_error
    np.testing.assert_allclose(
        np.einsum("irpc,rp->ic", decoded.values, table.projected_solid_angles), decoded.row_albedo, rtol=1e-12
    )


@pytest.mark.parametrize("text", ["{", "{}", '{"model": "no_such"}', "\xff"])
def test_a_damaged_model_is_one_clear_line(tmp_path, text):
    compress(make(asymmetric, EDGES), tmp_path / "c.h5", 0.05, "residual")
    model = np.frombuffer(text.encode("latin-1"), np.uint8)
    edit_record(tmp_path / "c.h5", lambda record: record.__setitem__("content/model", model))
    with pytest.raises(InputError, match="damaged content"):
        Table.load(tmp_path / "c.h5")
