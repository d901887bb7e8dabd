"""Compression: the bound holds on the file, the table behaves like any other, damage is one clear line."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.table.compress import METHODS, compress, row_bounds, row_errors, row_noise
from gonio.table.compress.frame import Frame
from gonio.table.compress.metric import albedo_errors
from gonio.table.table import Table
from gonio.validation import seed_from
from microgeometry.errors import InputError
from tests.table.tables import asymmetric, edit_record, ggx, grid, lambert, make
from tests.table.test_checks import poisson

pytestmark = pytest.mark.compiled

EDGES = grid(30, 30, 45)


def row_error(original, decoded, row, channel, edges):
    """The measure written out: relative RMS of f over cos(theta) x solid angle, by a sum over cells."""
    theta = 0.5 * (edges[1][1:] + edges[1][:-1])
    solid = -np.diff(np.cos(edges[1]))[:, None] * np.diff(edges[2])
    weight = np.cos(theta)[:, None] * solid
    a, b = original.values[row, :, :, channel], decoded.values[row, :, :, channel]
    return np.sqrt(np.sum(weight * (a - b) ** 2) / np.sum(weight * a**2))


CASES = [(name, alpha, e) for name in METHODS for alpha, e in ((0.5, 0.1), (0.15, 0.01), (0.5, 1e-4))]


@pytest.mark.parametrize(("method", "alpha", "max_error"), CASES)
def test_bound_holds_on_the_file(tmp_path, method, alpha, max_error):
    table = make(ggx(alpha, 0.9), EDGES, specular=0.05)
    if method == "low_rank" and max_error < 1e-3:  # its grid is coarser than the table's
        with pytest.raises(InputError, match="no step of quantisation holds it"):
            compress(table, tmp_path / "c.h5", max_error, method)
        return
    report = compress(table, tmp_path / "c.h5", max_error, method)
    assert report.method == method
    decoded = Table.load(tmp_path / "c.h5")
    errors = [row_error(table, decoded, row, c, EDGES) for row in range(30) for c in range(3)]
    assert max(errors) <= 1.1 * max_error  # the cosine is taken at cells' centres here
    assert max(errors) > 0.4 * max_error  # and it is not met by storing everything
    assert report.error_worst <= max_error
    assert report.error_worst == pytest.approx(max(errors), rel=0.1)
    assert report.error_median <= report.error_worst
    assert report.bytes == (tmp_path / "c.h5").stat().st_size
    assert report.ratio == 4 * table.values.size / report.bytes
    # re-integrates to the stored albedo, nothing negative
    total = np.einsum("irpc,rp->ic", decoded.values, decoded.projected_solid_angles) + decoded.specular
    np.testing.assert_allclose(total, decoded.row_albedo, rtol=1e-12)
    np.testing.assert_allclose(decoded.row_albedo, table.row_albedo, rtol=1e-6)
    assert report.albedo_error < 1e-6
    assert decoded.values.min() >= 0


def test_noise_does_not_brighten_rings(tmp_path):
    """Every ring keeps its mean, the noisy dark ones at the horizon too, whatever the bound on a row."""
    rng = np.random.default_rng(seed_from("compress rings"))
    table = poisson(ggx(0.5, 0.9), rng, 1e5, EDGES)
    compress(table, tmp_path / "c.h5", 0.05, "tree")
    decoded = Table.load(tmp_path / "c.h5")
    share = table.projected_solid_angles / table.projected_solid_angles.sum(axis=1, keepdims=True)
    means, after = (np.einsum("irpc,rp->irc", t.values, share) for t in (table, decoded))
    assert np.all(after[means == 0] == 0)
    lit = means > 0
    # seven tenths of a step of 1 %, and less again from scaling the row to its albedo
    assert np.abs(after[lit] / means[lit] - 1).max() < 0.01


def test_looser_bounds_are_smaller(tmp_path):
    table = make(ggx(0.3, 0.9), EDGES)
    sizes = [compress(table, tmp_path / "c.h5", e, "dct").bytes for e in (1e-4, 1e-3, 1e-2, 1e-1)]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[0] > 1.5 * sizes[-1]


def test_noise_is_not_followed(tmp_path):
    """Rows noisier than the bound are held to their noise, and come closer to the truth than they were."""
    rng = np.random.default_rng(seed_from("compress noise"))
    truth = make(ggx(0.5, 0.9), EDGES, tint=(1.0,), cell_points=2)
    table = poisson(ggx(0.5, 0.9), rng, 3e5, EDGES)
    report = compress(table, tmp_path / "c.h5", 0.01, "tree")
    assert report.noise_median > 0.1
    decoded = Table.load(tmp_path / "c.h5")
    assert np.all(row_errors(table, decoded.values) <= row_bounds(table, 0.01) * (1 + 1e-9))
    assert np.all(row_bounds(table, 0.01) <= np.maximum(0.01, 1.3 * row_noise(table)))
    assert np.median(row_errors(truth, decoded.values)) < 0.8 * np.median(row_errors(truth, table.values))
    exact = compress(table.replace(std_error=None), tmp_path / "exact.h5", 0.01, "tree")
    assert exact.noise_worst == 0
    assert exact.bytes > 2 * report.bytes


def test_everything_else_is_kept(tmp_path):
    table = make(asymmetric, EDGES, specular=0.1)
    gaps = np.zeros(table.values.shape[:3], bool)
    gaps[3, 4:9] = True
    values = np.where(gaps[..., None], 0.0, table.values)
    table = table.replace(
        values=values,
        gaps=gaps,
        hits=np.ones(gaps.shape, int),
        ledger={"paths": 5.0},
        provenance={"seed": 7},
        albedo_std_error=0.01 * table.row_albedo**2,
        specular_std_error=np.arange(3) * table.specular,
        wavelengths_nm=(630.0, 532.0, 467.0),
    )
    compress(table, tmp_path / "c.h5", method="tree")
    decoded = Table.load(tmp_path / "c.h5")
    for name in (
        "theta_i",
        "theta_i_edges",
        "theta_r_edges",
        "delta_phi_edges",
        "gaps",
    ):
        np.testing.assert_array_equal(getattr(decoded, name), getattr(table, name))
    for name in ("row_albedo", "specular"):
        np.testing.assert_allclose(getattr(decoded, name), getattr(table, name), rtol=1e-6)
    for name in ("albedo_std_error", "specular_std_error"):
        np.testing.assert_allclose(getattr(decoded, name), getattr(table, name), rtol=0.005)
    assert decoded.channels == table.channels
    assert decoded.wavelengths_nm == table.wavelengths_nm
    assert decoded.ledger == table.ledger
    assert decoded.hits is None
    assert np.all(decoded.values[gaps] == 0)
    assert decoded.provenance["seed"] == 7
    assert decoded.provenance["compression"]["max_error"] == 0.01


def test_what_is_not_content_is_small(tmp_path):
    """HDF5's own book-keeping, axes and albedos of a table of few cells: 20 kB when each was a dataset."""
    report = compress(make(ggx(0.5, 0.9), grid(4, 37, 74), tint=(1.0,)), tmp_path / "c.h5", method="tree")
    assert report.bytes - report.content < 1600


def test_compressed_table_saves_like_any_other(tmp_path):
    compress(make(ggx(0.5, 0.9), EDGES), tmp_path / "c.h5", method="dct")
    decoded = Table.load(tmp_path / "c.h5")
    decoded.save(tmp_path / "plain.h5")
    np.testing.assert_array_equal(Table.load(tmp_path / "plain.h5").values, decoded.values)


def test_dark_constant_and_small_tables(tmp_path):
    path = tmp_path / "c.h5"
    for table in (
        make(lambda wi, wo: 0 * lambert(wi, wo), EDGES),
        make(lambert, EDGES),
        make(asymmetric, EDGES, theta_i=np.array([0.7])),
        make(lambert, grid(1, 1, 1)),
        make(asymmetric, EDGES, tint=(1.0, 0.0, 0.5)),
    ):
        report = compress(table, path, method="tree")
        assert report.error_worst <= 0.01
        np.testing.assert_allclose(Table.load(path).albedo(0.7), table.albedo(0.7), rtol=1e-6)


def test_auto_takes_the_smallest(tmp_path):
    """A peak is the tree's: transforms of the whole table spread it over all frequencies."""
    table = make(ggx(0.1, 0.9), EDGES)
    report = compress(table, tmp_path / "c.h5")
    assert report.method == min(report.sizes, key=lambda name: report.sizes[name])
    assert set(report.sizes) >= {"tree", "dct", "zfp", "sz3", "blosc2"}
    others = [compress(table, tmp_path / "o.h5", method=m).bytes for m in ("tree", "dct")]
    assert report.bytes <= 1.05 * min(others)
    edit_record(tmp_path / "c.h5", lambda record: record.__setitem__("content/method", "x" + report.method))
    with pytest.raises(InputError, match=f"method 'x{report.method}' is unknown"):
        Table.load(tmp_path / "c.h5")


def test_methods_that_cannot_hold_the_bound_are_passed_over(tmp_path, monkeypatch):
    class Never:
        @staticmethod
        def encode(table, bounds, quick=False):
            raise InputError("max_error: no step of quantisation holds it")

    table = make(ggx(0.5, 0.9), EDGES)
    monkeypatch.setitem(METHODS, "never", Never)
    assert "never" not in compress(table, tmp_path / "c.h5").sizes
    for name in METHODS:
        monkeypatch.setitem(METHODS, name, Never)
    with pytest.raises(InputError, match="no method holds it, allow more"):
        compress(table, tmp_path / "c.h5")


@pytest.mark.parametrize("method", METHODS)
def test_negative_colours_stay_negative(tmp_path, method):
    """A colour outside the gamut has a negative channel; its albedo is held like any other."""
    table = make(ggx(0.4, 0.9), EDGES, tint=(1.0, 0.3, -0.05))
    compress(table, tmp_path / "c.h5", 0.02, method)
    decoded = Table.load(tmp_path / "c.h5")
    assert row_errors(table, decoded.values).max() <= 0.02
    assert albedo_errors(table, decoded.values).max() <= 0.02
    assert np.median(decoded.values[..., 2]) < 0


def test_what_nearly_cancels_is_not_scaled(tmp_path):
    """A channel on the edge of the gamut adds up to little: its albedo comes back, its cells stay."""
    sign = np.where(np.arange(44) % 2, 1.0, -0.999)
    table = make(ggx(0.4, 0.9), grid(30, 30, 44), tint=(1.0, 0.3))
    values = table.values * np.stack([np.ones(44), sign], axis=-1)
    table = table.replace(
        values=values, row_albedo=np.einsum("irpc,rp->ic", values, table.projected_solid_angles)
    )
    frame = Frame.of_table(table, row_bounds(table, 0.01))
    rng = np.random.default_rng(seed_from("cancels"))
    near = values * (1 + 0.003 * rng.standard_normal(values.shape))
    corrected = frame.correct(near.copy())
    np.testing.assert_allclose(albedo_errors(table, corrected), 0, atol=1e-9)
    assert np.all(row_errors(table, corrected) < 1.05 * row_errors(table, near))


def test_albedo_is_held_where_it_is_not_that_of_the_cells(tmp_path):
    """An albedo from elsewhere cannot be restored by scaling to it; that of the cells must hold."""
    table = make(ggx(0.4, 0.9), EDGES)
    table = table.replace(row_albedo=0.8 * table.row_albedo)
    for method in ("tree", "zfp"):
        compress(table, tmp_path / "c.h5", 0.01, method)
        decoded = Table.load(tmp_path / "c.h5")
        assert 0 < albedo_errors(table, decoded.values).max() <= 0.01
        np.testing.assert_allclose(decoded.row_albedo, table.row_albedo, rtol=1e-6)


def test_bad_arguments(tmp_path):
    table = make(lambert, grid(2, 2, 2))
    for bad in (0.0, -1.0, 2.0, float("nan")):
        with pytest.raises(InputError, match="max_error"):
            compress(table, tmp_path / "c.h5", bad)
    with pytest.raises(InputError, match=r"suffix must be \.h5"):
        compress(table, tmp_path / "c.binary")
    with pytest.raises(InputError, match="allowed are auto, tree, dct"):
        compress(table, tmp_path / "c.h5", method="zip")
    assert list(tmp_path.iterdir()) == []


def test_a_method_is_replaceable(tmp_path, monkeypatch):
    """Another method is one entry: here one that stores the values as they are."""

    class Plain:
        @staticmethod
        def encode(table, bounds, quick=False):
            return {"raw": table.values}

        @staticmethod
        def decode(content, fields):
            return content["raw"]

    monkeypatch.setitem(METHODS, "plain", Plain)
    assert compress(make(ggx(0.5, 0.9), EDGES), tmp_path / "c.h5", method="plain").error_worst == 0


def test_a_method_that_breaks_its_promise_leaves_no_file(tmp_path, monkeypatch):
    class Wrong:
        @staticmethod
        def encode(table, bounds, quick=False):
            return {"raw": 1.02 * table.values}

        @staticmethod
        def decode(content, fields):
            return content["raw"]

    monkeypatch.setitem(METHODS, "wrong", Wrong)
    with pytest.raises(RuntimeError, match="exceeds its bound"):
        compress(make(ggx(0.5, 0.9), EDGES), tmp_path / "c.h5", method="wrong")
    assert list(tmp_path.iterdir()) == []
