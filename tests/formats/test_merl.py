"""MERL files: bins, conventions, round trips, damage, and real materials."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fitting.merl import decode
from gonio import formats
from gonio.core.directions import direction
from gonio.formats import merl
from gonio.table.table import Table
from gonio.validation import seed_from
from microgeometry.errors import InputError
from tests.formats.damage import refused
from tests.table.tables import grid, lambert, make, with_parts

slow_in_python = pytest.mark.compiled


def sideways(wi, wo):
    """Reciprocal, and four times as bright at retro-reflection (60 degrees) as on the mirror side."""
    return 0.1 + 0.08 * np.sum(wi[..., :2] * wo[..., :2], axis=-1) / np.pi


def write_bins(path, values, n_phi=180):
    """A file from values in 1/sr, shape (bins, 3), negative for no data."""
    stored = np.where(values < 0, values, values * 1500 / np.array([1, 1.15, 1.66]))
    with open(path, "wb") as file:
        np.array([90, 90, n_phi], "<i4").tofile(file)
        stored.T.astype("<f8").tofile(file)


def write_function(path, brdf):
    merl.write_function(brdf, path)
    return path


def classic_index(wi, wo):
    """MERL's own look-up, step by step with rotation matrices (BRDFRead.cpp)."""

    def rotate(v, axis, angle):
        c, s = math.cos(angle), math.sin(angle)
        x, y, z = v
        if axis == "z":
            return c * x - s * y, s * x + c * y, z
        return c * x + s * z, y, -s * x + c * z

    half = (wi + wo) / np.linalg.norm(wi + wo)
    theta_h, phi_h = math.acos(half[2]), math.atan2(half[1], half[0])
    diff = rotate(rotate(wi, "z", -phi_h), "y", -theta_h)
    theta_d, phi_d = math.acos(min(1.0, diff[2])), math.atan2(diff[1], diff[0])
    if phi_d < 0:
        phi_d += math.pi
    h = min(89, int(90 * math.sqrt(theta_h / (math.pi / 2))))
    d = min(89, int(90 * theta_d / (math.pi / 2)))
    return min(179, int(180 * phi_d / math.pi)) + 180 * (d + 90 * h)


def test_look_up_is_merls_own():
    """Bins numbered 0, 1, 2...: the numbers that come back are those of the original code."""
    rng = np.random.default_rng(seed_from("MERL look-up"))
    theta = np.arccos(rng.uniform(0.02, 1, (2, 500)))
    phi = rng.uniform(0, np.pi, 500)
    numbers = np.repeat(np.arange(1458000.0)[:, None], 3, axis=1).reshape(90, 90, 180, 3)
    found = merl._look_up(numbers, merl.half_difference(theta[0], theta[1], phi))[..., 0]
    for sign in (0, 1):
        azimuth = phi if sign == 0 else -phi
        wi, wo = direction(theta[0]), direction(theta[1], azimuth)
        expected = [classic_index(a, b) for a, b in zip(wi, wo, strict=True)]
        np.testing.assert_array_equal(found[:, sign], expected)


def test_bin_directions_fall_into_their_bins():
    wi, wo = merl.bin_directions()
    rng = np.random.default_rng(seed_from("MERL bins"))
    for n in rng.integers(0, 1458000, 300):
        assert classic_index(wi[n], wo[n]) == n


@pytest.fixture(scope="module")
def analytic(tmp_path_factory):
    path = write_function(
        tmp_path_factory.mktemp("merl") / "sideways.binary",
        lambda wi, wo: sideways(wi, wo)[:, None] * np.array([1.0, 0.5, 0.25]),
    )
    return path, Table.load(path)


def test_asymmetric_function(analytic):
    """Cells against the function at their centres; the rest is the width of MERL's bins."""
    path, table = analytic
    assert path.stat().st_size == 34_992_012
    assert table.values.shape == (90, 90, 180, 3)
    assert table.channels == ("R", "G", "B")
    wo = direction(table.theta_r[:, None], table.delta_phi)
    for row in (5, 30, 60, 80):
        expected = sideways(direction(table.theta_i[row]), wo)[:85, :, None] * np.array([1.0, 0.5, 0.25])
        np.testing.assert_allclose(table.values[row, :85], expected, rtol=0.06)
    assert table.values[60, 60, 0, 0] > 1.3 * table.values[60, 60, -1, 0]
    # DHR = pi x 0.1: the sideways term cancels over the azimuth. Only grazing rows have cells without data.
    np.testing.assert_allclose(table.row_albedo[:80, 0], 0.1 * np.pi, rtol=0.01)
    assert table.gaps is not None
    assert table.gaps.mean() < 1e-3


@slow_in_python
@pytest.mark.compiled
def test_parts_are_lost_and_said_so(tmp_path):
    table = with_parts(make(sideways, grid(6, 6, 6)))
    for given, found in ((table, 1), (table.replace(parts={}), 0)):
        lost = given.save(tmp_path / "parts.binary")
        assert sum(line.startswith("the parts transmission, L1, L2, L3+: MERL") for line in lost) == found


@slow_in_python
@pytest.mark.compiled
def test_round_trip(analytic, tmp_path):
    path, table = analytic
    lost = table.save(tmp_path / "again.binary")
    assert any("provenance" in line for line in lost)
    before, after = (
        np.fromfile(p, "<f8", offset=12).reshape(3, -1) for p in (path, tmp_path / "again.binary")
    )
    np.testing.assert_array_equal(before < 0, after < 0)
    wi, wo = merl.bin_directions()
    inside = np.minimum(wi[:, 2], wo[:, 2]) > np.cos(np.radians(85))
    np.testing.assert_allclose(after[:, inside], before[:, inside], rtol=0.06)
    relative = after[:, inside] / before[:, inside] - 1
    assert np.sqrt(np.mean(relative**2)) < 0.006


@slow_in_python
@pytest.mark.compiled
def test_write_one_channel_and_refuse_two(tmp_path):
    table = make(sideways, grid(10, 10, 12), tint=(1.0,))
    assert any("one channel" in line for line in table.save(tmp_path / "grey.binary"))
    stored = np.fromfile(tmp_path / "grey.binary", "<f8", offset=12).reshape(3, -1)
    np.testing.assert_allclose(stored[1], np.where(stored[0] < 0, stored[0], stored[0] / 1.15), rtol=1e-12)
    with pytest.raises(InputError, match="2 channels"):
        make(sideways, grid(10, 10, 12), tint=(1.0, 0.5)).save(tmp_path / "two.binary")
    assert not (tmp_path / "two.binary").exists()


@slow_in_python
@pytest.mark.compiled
def test_colours_outside_the_gamut_are_not_no_data(tmp_path):
    lost = make(sideways, grid(6, 6, 6), tint=(1.0, 0.5, -0.1)).save(tmp_path / "cyan.binary")
    assert any("outside the gamut" in line for line in lost)
    gaps = Table.load(tmp_path / "cyan.binary").gaps
    assert gaps is not None
    assert gaps.mean() < 1e-3  # bins below the horizon, as in every MERL file
    stored = np.fromfile(tmp_path / "cyan.binary", "<f8", offset=12).reshape(3, -1)
    assert np.all(stored[2][stored[0] > 0] == 0)


def test_full_turn_of_phi_d(tmp_path):
    """With 360 bins phi_d and phi_d + pi may differ; both signs of delta phi are averaged."""
    values = np.empty((90, 90, 360, 3))
    values[:, :, :180], values[:, :, 180:] = 0.1, 0.3
    values[:, 45:] *= 2
    write_bins(tmp_path / "full.binary", values.reshape(-1, 3), 360)
    table = Table.load(tmp_path / "full.binary")
    np.testing.assert_allclose(table.values[10:44, 10:44], 0.2, rtol=1e-9)  # theta_d <= 45 degrees
    np.testing.assert_allclose(table.values[70, 70, -1], 0.4, rtol=1e-9)
    np.testing.assert_allclose(table.values[70, 70, 0], 0.2, rtol=1e-9)


def test_gaps(tmp_path):
    """No data at all beyond theta_d = 60 degrees: mirror-side cells of steep rows are gaps, not zeros."""
    values = np.full((90, 90, 180, 3), 0.1)
    values[:, 60:] = -1.0
    write_bins(tmp_path / "gaps.binary", values.reshape(-1, 3))
    table = Table.load(tmp_path / "gaps.binary")
    assert table.gaps[70, 70, -1]
    assert not table.gaps[70, 70, 0]
    assert table.values[70, 70, -1, 0] == 0
    np.testing.assert_allclose(table.values[~table.gaps], 0.1, rtol=1e-12)


@slow_in_python
@pytest.mark.compiled
def test_gaps_are_written_as_no_data(tmp_path):
    """Only light from below 45 degrees was measured: bins that know one way hold it, those that know none, no data."""
    table = make(lambert, grid(90, 30, 36))
    gaps = np.broadcast_to((table.theta_i > np.radians(45))[:, None, None], table.values.shape[:3])
    values = np.where(gaps[..., None], 0.0, table.values)
    table = table.replace(values=values, gaps=gaps, row_albedo=table.row_albedo * ~gaps[:, 0, :1])
    lost = table.save(tmp_path / "gaps.binary")
    assert not any("gaps" in line for line in lost)
    stored = np.fromfile(tmp_path / "gaps.binary", "<f8", offset=12).reshape(3, -1)[0] * merl.FACTORS[0]
    wi, wo = merl.bin_directions()
    steep, flat = (f(wi[:, 2], wo[:, 2]) for f in (np.maximum, np.minimum))
    assert np.all(stored[steep < np.cos(np.radians(45))] < 0)
    # between the rows at 44.5 and 45.5 degrees the table falls to 0
    between = np.abs(np.degrees(np.arccos(np.clip(np.stack([steep, flat]), 0, 1))) - 45) < 0.6
    known = (flat > 0) & (steep > np.cos(np.radians(45))) & ~between.any(axis=0)
    np.testing.assert_allclose(stored[known], 0.5 / np.pi, rtol=1e-6)
    again = Table.load(tmp_path / "gaps.binary")
    assert np.all(again.gaps[60:, 60:])
    assert not np.any(again.gaps[:30, :30])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "dimensions"),
        (b"\x5a\0\0\0\x5a\0\0\0\xb4\0\0\0", "34992012 are expected"),
        (b"\xff" * 400, "dimensions"),
        (b"\x5a\0\0\0\x5a\0\0\0\xb4\0\0\0" + b"\0" * 34_992_008, "truncated or not MERL"),
    ],
)
def test_damaged_files(tmp_path, content, message):
    path = tmp_path / "bad.binary"
    path.write_bytes(content)
    refused(path, message)


def test_nan_in_file(tmp_path):
    values = np.full((1458000, 3), 0.1)
    values[77, 1] = np.nan
    write_bins(tmp_path / "nan.binary", values)
    with pytest.raises(InputError, match="NaN"):
        Table.load(tmp_path / "nan.binary")


@slow_in_python
@pytest.mark.compiled
def test_real_material(real_data, tmp_path):
    """A whole MERL file decoded from a network, read, and compared with the network at random directions.

    What is left is MERL's bins (2 degrees wide in theta_h far from the peak) and our cells of 1 degree.
    """
    weights = np.load(real_data / "nbrdf" / "nbrdf_weights.npz")
    name = "gold-metallic-paint"
    path = write_function(tmp_path / "gold.binary", lambda wi, wo: decode(weights, name, wi, wo))
    assert path.stat().st_size == 34_992_012
    table = Table.load(path)
    rng = np.random.default_rng(seed_from("real MERL material"))
    u = rng.uniform(0, np.sin(np.radians(80)) ** 2, (2, 20_000))
    wi = direction(np.arcsin(np.sqrt(u[0])))
    wo = direction(np.arcsin(np.sqrt(u[1])), rng.uniform(0, np.pi, 20_000))
    truth, read = decode(weights, name, wi, wo), table.eval(wi, wo)
    cosine = wo[:, 2:]
    rms = np.sqrt(np.sum(((read - truth) * cosine) ** 2) / np.sum((truth * cosine) ** 2))
    assert rms < 0.04, rms
    assert np.median(np.abs(read - truth) / truth) < 0.05
    assert np.all(table.row_albedo[:85] < 1)
    done = formats.convert(path, tmp_path / "gold.h5")
    assert done == formats.Conversion(done.lost)
    assert len(done.lost) == 1  # MERL's steps, of 2.2 %
    assert "differs from the file's by 2.2 %" in done.lost[0]
    np.testing.assert_array_equal(Table.load(tmp_path / "gold.h5").values, table.values)
