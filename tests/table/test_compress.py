"""Compression: the bound holds on the file, the table behaves like any other, damage is one clear line."""

from __future__ import annotations

import bz2

import h5py
import numpy as np
import pytest

from gonio.formats import hdf5
from gonio.table.checks import check
from gonio.table.compress import METHODS, compress, cosine_weights, row_bounds, row_errors, row_noise
from gonio.table.compress.metric import albedo_errors, excess
from gonio.table.parts import walk
from gonio.table.table import Table
from gonio.validation import seed_from
from microgeometry.errors import InputError
from tests.table.tables import asymmetric, ggx, grid, lambert, make, share
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
    np.testing.assert_allclose(total, table.row_albedo, rtol=1e-12)
    assert report.albedo_error < 1e-12
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
    # half a step of 1 %, and as much again from scaling the row to its albedo
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


def test_noise_is_measured_in_the_error_measure():
    """The table's scatter about the truth is what its error bars say, row by row."""
    rng = np.random.default_rng(seed_from("row noise"))
    truth = make(ggx(0.5, 0.9), EDGES, tint=(1.0,), cell_points=2)
    table = poisson(ggx(0.5, 0.9), rng, 3e6, EDGES)
    ratio = row_errors(table, truth.values) / row_noise(table)
    # 1350 cells a row, but a few bright ones can dominate: 10 % a row, less on average
    assert np.median(ratio) == pytest.approx(1, abs=0.05)


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
        wavelengths_nm=(630.0, 532.0, 467.0),
    )
    compress(table, tmp_path / "c.h5", method="tree")
    decoded = Table.load(tmp_path / "c.h5")
    for name in (
        "theta_i",
        "theta_i_edges",
        "theta_r_edges",
        "delta_phi_edges",
        "row_albedo",
        "specular",
        "gaps",
    ):
        np.testing.assert_array_equal(getattr(decoded, name), getattr(table, name))
    assert decoded.channels == table.channels
    assert decoded.wavelengths_nm == table.wavelengths_nm
    assert decoded.ledger == table.ledger
    assert decoded.hits is None
    assert np.all(decoded.values[gaps] == 0)
    assert decoded.provenance["seed"] == 7
    assert decoded.provenance["compression"]["max_error"] == 0.01


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
        np.testing.assert_array_equal(after[name].row_albedo, part.row_albedo)
        np.testing.assert_array_equal(after[name].specular, part.specular)
        assert after[name].provenance["compression"]["max_error"] == 0.02
    assert report.error_worst == pytest.approx(np.max(errors), rel=1e-12)
    assert report.error_median == pytest.approx(np.median(errors), rel=1e-12)
    assert report.ratio == 4 * table.values.size * (1 + len(before)) / (tmp_path / "c.h5").stat().st_size
    assert report.albedo_error < 1e-12
    found = check(decoded)
    assert found.passed, found.lines()
    assert any(c.name == "orders add up to the table" for c in found.checks)
    with h5py.File(tmp_path / "c.h5") as file:
        assert "values" not in file["parts/transmission/parts/L1"]


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
    with h5py.File(tmp_path / "c.h5", "r+") as file:
        del file["parts/transmission/compressed/zeros"]
    with pytest.raises(InputError, match="parts/transmission/compressed: damaged content"):
        Table.load(tmp_path / "c.h5")


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
        np.testing.assert_allclose(Table.load(path).albedo(0.7), table.albedo(0.7), atol=1e-12)


def test_auto_takes_the_smallest(tmp_path):
    """A peak is the tree's: transforms of the whole table spread it over all frequencies."""
    table = make(ggx(0.1, 0.9), EDGES)
    report = compress(table, tmp_path / "c.h5")
    assert report.method == min(report.sizes, key=lambda name: report.sizes[name])
    assert set(report.sizes) >= {"tree", "dct", "zfp", "sz3", "blosc2"}
    others = [compress(table, tmp_path / "o.h5", method=m).bytes for m in ("tree", "dct")]
    assert report.bytes <= 1.05 * min(others)
    with h5py.File(tmp_path / "c.h5") as file:
        assert file["compressed"].attrs["method"] == report.method


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


@pytest.mark.parametrize("method", METHODS)
def test_content_that_shrinks_to_nothing(tmp_path, method, monkeypatch):
    """A codec may need less than a thousandth of what it decodes to; reading must not take that for damage."""
    monkeypatch.setattr(hdf5, "_MAX_RATIO", 5)  # for tables hundreds of times as large
    table = make(lambert, grid(45, 60, 90))
    report = compress(table, tmp_path / "c.h5", method=method)
    assert report.error_worst <= 0.01
    assert report.bytes < 40_000


@pytest.mark.parametrize("method", METHODS)
def test_negative_colours_stay_negative(tmp_path, method):
    """A colour outside the gamut has a negative channel; its albedo is held like any other."""
    table = make(ggx(0.4, 0.9), EDGES, tint=(1.0, 0.3, -0.05))
    compress(table, tmp_path / "c.h5", 0.02, method)
    decoded = Table.load(tmp_path / "c.h5")
    assert row_errors(table, decoded.values).max() <= 0.02
    assert albedo_errors(table, decoded.values).max() <= 0.02
    assert np.median(decoded.values[..., 2]) < 0


def test_albedo_is_held_where_it_is_not_that_of_the_cells(tmp_path):
    """An albedo from elsewhere cannot be restored by scaling to it; that of the cells must hold."""
    table = make(ggx(0.4, 0.9), EDGES)
    table = table.replace(row_albedo=0.8 * table.row_albedo)
    for method in ("tree", "zfp"):
        compress(table, tmp_path / "c.h5", 0.01, method)
        decoded = Table.load(tmp_path / "c.h5")
        assert 0 < albedo_errors(table, decoded.values).max() <= 0.01
        np.testing.assert_array_equal(decoded.row_albedo, table.row_albedo)


def test_excess_is_the_larger_of_brdf_and_albedo():
    """A veil under a peak: 1 % of the peak's norm, but several of its albedo."""
    table = make(ggx(0.05, 0.9), EDGES, tint=(1.0,), cell_points=2)
    bounds = np.full(table.row_albedo.shape, 0.01)
    veiled = table.values + 0.05
    assert np.all(albedo_errors(table, veiled)[:10] > 1.5 * row_errors(table, veiled)[:10])
    np.testing.assert_allclose(excess(table, veiled, bounds)[:10], 100 * albedo_errors(table, veiled)[:10])
    sign = np.where(np.arange(45) % 2, 1.0, -1.0)[:44, None]
    balanced = table.values.copy()
    balanced[:, :, :44] *= 1 + 0.02 * sign
    np.testing.assert_allclose(
        excess(table, balanced, bounds)[:10], 100 * row_errors(table, balanced)[:10], rtol=1e-12
    )


def test_albedo_errors_are_relative_and_see_cancellation():
    table = make(ggx(0.4, 0.9), EDGES, tint=(1.0, -0.5))
    np.testing.assert_allclose(albedo_errors(table, 1.02 * table.values), 0.02)
    # two halves of opposite sign: nothing in total, so a change is measured against what is there
    sign = np.where(np.arange(45) % 2, 1.0, -1.0)
    mixed = make(lambert, grid(4, 4, 44), tint=(1.0,))
    values = mixed.values * sign[:44, None]
    mixed = mixed.replace(values=values)
    changed = values + 0.001 * np.abs(values)
    np.testing.assert_allclose(albedo_errors(mixed, changed), 0.01)


def test_bounds_follow_the_noise():
    """Poisson noise of n like cells: the sum of squares scatters by sqrt(2/n), twice with error bars' own."""
    table = make(lambert, EDGES, tint=(1.0,))
    noisy = table.replace(std_error=0.2 * table.values)
    areas = table.projected_solid_angles
    cells = areas.sum() ** 2 / np.sum(areas**2)
    expected = 0.2 * np.sqrt(1 + 3 * np.sqrt(4 / cells))
    np.testing.assert_allclose(row_bounds(noisy, 0.01), expected)
    np.testing.assert_array_equal(row_bounds(noisy, 0.3), 0.3)
    np.testing.assert_array_equal(row_bounds(table, 0.01), 0.01)


def test_a_dark_channel_is_measured_against_a_tenth_of_the_brightest():
    """Red of a deep blue may be the small difference of large numbers."""
    table = make(ggx(0.4, 0.9), EDGES, tint=(1.0, 0.5, 0.01))
    np.testing.assert_allclose(row_errors(table, 1.02 * table.values), [[0.02, 0.02, 0.002]] * 30)
    np.testing.assert_allclose(albedo_errors(table, 1.02 * table.values), [[0.02, 0.02, 0.002]] * 30)


def test_metric_of_a_constant():
    """For f = 1 the squared norm is the projected solid angle of the hemisphere, pi."""
    weights = cosine_weights(EDGES[1], EDGES[2])
    assert np.sum(weights**2) == pytest.approx(np.pi)


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


def replace(name, data):
    def action(group):
        del group[name]
        group[name] = data

    return action


DAMAGE = {
    "method": ("dct", lambda g: g.attrs.__setitem__("method", "wavelet"), "method 'wavelet' is unknown"),
    "no method": ("dct", lambda g: g.attrs.__delitem__("method"), "method None is unknown"),
    "no step": ("dct", lambda g: g.attrs.__delitem__("step"), "damaged content"),
    "count": ("dct", lambda g: g.attrs.__setitem__("count", 10**12), "damaged content"),
    "scale": ("dct", replace("scale", np.ones((2, 2), "f4")), "damaged content"),
    "nan": ("dct", replace("scale", np.full((30, 3), np.nan, "f4")), "damaged content"),
    "zeros": ("dct", replace("zeros", np.zeros(50, np.uint8)), "damaged content"),
    "coefficients": ("dct", replace("coefficients", np.zeros(50, np.uint8)), "damaged content"),
    "missing": ("dct", lambda g: g.__delitem__("zeros"), "damaged content"),
    "text": ("dct", replace("zeros", "hello"), "zeros holds"),
    "another method's": ("dct", lambda g: g.attrs.__setitem__("method", "tree"), "damaged content"),
    "rings": ("tree", lambda g: g.attrs.__setitem__("ring_step", 2.0), "damaged content"),
    "bright rings": ("tree", lambda g: g.attrs.__setitem__("ring_floor", 1e308), "damaged content"),
    "tree": ("tree", replace("tree", np.frombuffer(bz2.compress(b""), np.uint8)), "nodes, more are expected"),
    "no tree": ("tree", replace("tree", np.zeros(9, np.uint8)), "damaged content"),
    "negative step": ("tree", lambda g: g.attrs.__setitem__("step", -1.0), "damaged content"),
    "basis": ("low_rank", replace("basis", np.ones((31, 2), "f4")), "damaged content"),
    "weights": ("low_rank", replace("weights", np.zeros(31, "f4")), "damaged content"),
    "huge basis": ("low_rank", replace("basis", np.full((31, 2), 9, "f4")), "damaged content"),
    "array": ("zfp", replace("array", np.zeros((3, 3), "f4")), "damaged content"),
    "array of nan": ("sz3", replace("array", np.full((3, 30, 30, 45), np.nan, "f4")), "damaged content"),
    "no array": ("blosc2", lambda g: g.__delitem__("array"), "damaged content"),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_damaged_content(tmp_path, name):
    path = tmp_path / "c.h5"
    method, damage, message = DAMAGE[name]
    compress(make(ggx(0.5, 0.9), EDGES), path, 0.1, method)
    with h5py.File(path, "r+") as file:
        damage(file["compressed"])
    with pytest.raises(InputError, match=message) as caught:
        Table.load(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("method", ["zfp", "sz3", "blosc2"])
def test_bytes_the_codec_would_trust_are_checked_before(tmp_path, method):
    """One bit flipped in what the filter wrote: the checksum finds it, no decoder sees it."""
    path = tmp_path / "c.h5"
    compress(make(ggx(0.5, 0.9), EDGES), path, 0.02, method)
    with h5py.File(path) as file:
        chunk = file["compressed/array"].id.get_chunk_info(0)
    data = bytearray(path.read_bytes())
    for at in np.linspace(0, chunk.size - 5, 20).astype(int):
        damaged = data.copy()
        damaged[chunk.byte_offset + at] ^= 4
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="compressed/array is damaged or truncated"):
            Table.load(path)


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
