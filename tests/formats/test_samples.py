"""The samples of each format are what its files hold, and conversions say how far the tables are from them."""

from __future__ import annotations

import re

import numpy as np
import pytest

from gonio import formats
from gonio.core.directions import direction
from gonio.formats.samples import Samples, sample_error
from gonio.formats.tensor_tree import TensorTree, directions, tree_text
from gonio.table.table import Table
from tests.formats.test_lists import write_astm, write_lighttools, write_openmaterial
from tests.formats.test_radiance_xml import document, matrix_text
from tests.formats.test_speos import write_anisotropic, write_brdf
from tests.formats.test_zemax import write_file
from tests.table.tables import asymmetric, grid, lambert, make

pytestmark = pytest.mark.compiled

HALF = "LBNL/Klems Half"


def tree(n):
    theta_in, theta_out, phi = directions((np.indices((n, n, n)).transpose(1, 2, 3, 0) + 0.5) / n)
    return tree_text(asymmetric(direction(theta_in), direction(theta_out, phi)), 0.0)


FILES = {
    "t.astm": write_astm,
    "t.xompt": write_openmaterial,
    "z.bsdf": lambda path: write_file(path, asymmetric),
    "btdf.bsdf": lambda path: write_file(path, asymmetric, "planesymmetrical", np.arange(0, 181, 30), "BTDF"),
    "l.bsdf": lambda path: write_lighttools(path, colour="XYZ", pois=(0, 40)),
    "t.brdf": lambda path: write_brdf(path, asymmetric, (1, 1)),
    "intensity.brdf": lambda path: write_brdf(path, asymmetric, kind=0),
    "t.anisotropicbsdf": lambda path: write_anisotropic(path, asymmetric, (0.0, 90.0)),
    "matrix.xml": lambda path: path.write_text(
        document("Columns", [("Visible", "Transmission Back", HALF, matrix_text(HALF, asymmetric))])
    ),
    "tree.xml": lambda path: path.write_text(
        document("TensorTree3", [("Visible", "Reflection Front", "LBNL/Shirley-Chiu", tree(16))])
    ),
}
_LOOSE = {"matrix.xml": 0.15, "tree.xml": 1e-4}  # other middles of patches; six digits


def read_samples(path):
    return formats._module(formats._by_content(path, formats._names(path))).samples_of(path)


@pytest.mark.parametrize("name", FILES)
def test_samples_are_the_file_s(name, tmp_path):
    """Each, up to a factor of its angle of incidence, channel and side (rotation), is the function at its angles."""
    path = tmp_path / name
    FILES[name](path)
    table = Table.load(path)
    for part, samples in read_samples(path).items():
        assert samples.theta_r.max() <= np.pi / 2 + 1e-9
        error = sample_error(table.parts[part] if part else table, samples)[0]
        # two rotations of once and twice the same are off their mean by 0.5 of sqrt(2.5)
        assert error == pytest.approx(0.316, abs=0.01) if name == "t.anisotropicbsdf" else error < 0.12
        if name == "l.bsdf":
            np.testing.assert_allclose(samples.values, samples.values[:, [0]] * np.ones(3), rtol=1e-5)
        away = samples.where(samples.theta_r < 1.5)
        f = asymmetric(direction(away.theta_i), direction(away.theta_r, away.delta_phi))
        for values in away.values.T:
            known = ~np.isnan(values)
            assert known.sum() > 100
            ratio = values[known] / f[known]
            factors = np.unique(np.round(ratio, 6)) if name not in _LOOSE else np.array([1.0])
            assert len(factors) <= 6
            nearest = factors[np.abs(ratio[:, None] - factors).argmin(axis=1)]
            np.testing.assert_allclose(ratio, nearest, rtol=_LOOSE.get(name, 1e-5))
    assert ("transmission" in read_samples(path)) == (name in ("btdf.bsdf", "l.bsdf", "t.brdf", "matrix.xml"))


def test_the_error_is_weighted_with_the_cosine_and_the_solid_angle():
    """Of a table of 1 in cells of other sizes: two samples share a cell, one is on the horizon, one is unknown."""
    edges = grid()[0], np.array([0, 0.5, np.pi / 2]), np.array([0, np.pi])
    table = make(lambda wi, wo: np.ones((1, *wo.shape[1:-1])), edges, theta_i=np.array([0.6]), tint=(1, 1, 1))
    theta_r = np.array([0.2, 0.4, 1.0, np.pi / 2, 1.0])
    values = np.array([1.0, 2.0, 1.0, 9.0, np.nan])[:, None] * np.ones(3)
    samples = Samples(np.full(5, 0.3), theta_r, np.array([0.0, 3.0, -2.0, 1.0, 1.0]), values)
    low, high = (1 - np.cos(0.5)) / 2, np.cos(0.5) / 3
    wrong = low * np.cos(0.4)
    expected = np.sqrt(wrong / (low * np.cos(0.2) + 4 * wrong + high * np.cos(1.0)))
    assert sample_error(table, samples) == pytest.approx((expected, expected, np.degrees(0.3)), rel=1e-4)
    # another angle of incidence, all wrong by half, and a third that agrees
    more = Samples(np.full(1, 0.9), np.ones(1), np.ones(1), np.full((1, 3), 2.0))
    best = Samples(np.full(1, 0.5), np.ones(1), np.ones(1), np.ones((1, 3)))
    median, worst, at_deg = sample_error(table, Samples.joined([samples, more, best]))
    assert (median, worst, at_deg) == pytest.approx((expected, 0.5, np.degrees(0.9)), rel=1e-4)


def test_middles_of_a_tree():
    """The fifth child is that of bit 2: the upper half of the last axis."""
    text = "{{1}{2}{3}{4}{1 2 3 4 5 6 7 8}{6}{7}{8}}"
    middles = TensorTree(text, None).middles()
    np.testing.assert_allclose(middles[np.all(middles % 0.5 == 0.25, axis=1)].sum(axis=0), [3.75, 3.75, 3.25])
    small = middles[np.any(middles % 0.5 != 0.25, axis=1)]
    assert len(small) == 8
    np.testing.assert_allclose(small.mean(axis=0), [0.25, 0.25, 0.75])


def test_a_tree_has_no_incidence_in_its_other_half(tmp_path):
    FILES["tree.xml"](tmp_path / "t.xml")
    assert read_samples(tmp_path / "t.xml")[""].theta_i.min() > 0
    # the middle of a single cell is light along the normal
    (tmp_path / "one.xml").write_text(
        document("TensorTree3", [("Visible", "Reflection Front", "LBNL/Shirley-Chiu", "{ 0.25 }")])
    )
    one = read_samples(tmp_path / "one.xml")[""]
    assert (one.theta_i.tolist(), one.values.tolist()) == ([0.0], [[0.25]])


def test_without_samples_there_is_no_error():
    nothing = Samples(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros((0, 3)))
    assert sample_error(make(lambert, grid(6, 6, 8)), nothing) == (0.0, 0.0, 0.0)


def test_conversions_say_nothing_of_samples_that_are_kept(tmp_path):
    write_file(tmp_path / "z.bsdf", lambert)
    done = formats.convert(tmp_path / "z.bsdf", tmp_path / "z.h5")
    assert not any("samples" in line for line in done.lost)
    make(asymmetric, grid(9, 12, 18)).save(tmp_path / "cells.csv")
    assert read_samples(tmp_path / "cells.csv") == {}


def test_the_part_asked_for_is_compared(tmp_path):
    write_brdf(tmp_path / "t.brdf", asymmetric, (1, 1))
    both = formats.convert(tmp_path / "t.brdf", tmp_path / "t.h5").lost
    below = formats.convert(tmp_path / "t.brdf", tmp_path / "t.h5", "transmission").lost
    assert sum("samples:" in line for line in both) == 1
    said = [line for line in below if "samples" in line]
    assert said == [line for line in both if "samples of tr" in line]
    assert float(re.search(r"differs by ([\d.]+) %", said[0])[1]) < 5


def test_measurements_in_a_plane_keep_their_scale(tmp_path):
    """Interpolated over half the hemisphere they were a fiftieth of the samples."""
    lines = [f"30,{angle},{0.0 if abs(angle + 30) < 5 else 0.5}" for angle in range(-80, 81, 2)]
    path = tmp_path / "plane.csv"
    path.write_text("\n".join(["Incident_angle,Measure_angle,500nm", *lines]))
    assert sample_error(Table.load(path), read_samples(path)[""])[1] < 0.03
