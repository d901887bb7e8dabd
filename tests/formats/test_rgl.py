"""RGL files: Mitsuba reads what we write, we read what Mitsuba reads, conventions, round trips, damage."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from gonio import formats
from gonio.core.directions import direction
from gonio.formats import rgl
from gonio.formats.colour import reordered
from gonio.formats.highlights import resolved
from gonio.formats.tensor_file import MAGIC, read_tensors, write_tensors
from gonio.formats.warp import Warp, bilinear
from gonio.table.peak import Peak
from gonio.table.table import Table
from gonio.validation import seed_from
from microgeometry.errors import InputError
from tests.formats.damage import refused
from tests.formats.mitsuba3 import evaluate, needs_mitsuba
from tests.formats.test_highlights import metal, sampled
from tests.table.tables import asymmetric, ggx, grid, lambert, make, with_parts


def hemisphere(name, n, steepest=85):
    """Pairs of directions, cosine-weighted up to `steepest` degrees."""
    rng = np.random.default_rng(seed_from(name))
    u = rng.uniform(0, np.sin(np.radians(steepest)) ** 2, (2, n))
    wi = direction(np.arcsin(np.sqrt(u[0])), rng.uniform(0, 2 * np.pi, n))
    return wi, direction(np.arcsin(np.sqrt(u[1])), rng.uniform(0, 2 * np.pi, n))


def quadrature(n_theta=40, n_phi=80):
    """Directions of equal projected solid angle, and that solid angle."""
    u, v = (np.arange(n_theta) + 0.5) / n_theta, (np.arange(n_phi) + 0.5) * 2 * np.pi / n_phi
    return direction(np.arcsin(np.sqrt(u))[:, None], v).reshape(-1, 3), np.pi / (n_theta * n_phi)


def test_warp_inverts_and_keeps_mass():
    rng = np.random.default_rng(seed_from("warp"))
    density = rng.random((9, 13)) + 0.05
    warp = Warp(density)
    u, v = rng.random((2, 200_000))
    x, y = warp.sample(u, v)
    back = warp.invert(x, y)
    np.testing.assert_allclose(back[0], u, atol=1e-9)
    np.testing.assert_allclose(back[1], v, atol=1e-9)
    counts = np.histogram2d(y, x, (8, 12), [[0, 1], [0, 1]])[0] / len(u)
    d = warp.density
    cells = 0.25 * (d[1:, 1:] + d[1:, :-1] + d[:-1, 1:] + d[:-1, :-1]) / 96
    assert cells.sum() == pytest.approx(1)
    z = (counts - cells) / np.sqrt(cells / len(u))
    assert np.abs(z).max() < 5
    np.testing.assert_allclose(bilinear(np.arange(6.0).reshape(2, 3), np.array([0.25]), np.array([0.5])), 2.0)


@pytest.mark.compiled
@needs_mitsuba
@pytest.mark.parametrize("name", ["asymmetric", "ggx", "lambert"])
def test_mitsuba_evaluates_what_we_write(name, tmp_path):
    """Directional albedo within 1 %, values with the right roles of wi and wo, side and cosine."""
    table = make({"asymmetric": asymmetric, "ggx": ggx(0.3, 0.8), "lambert": lambert}[name], grid(45, 45, 60))
    path = tmp_path / "written.bsdf"
    table.save(path)
    wi, wo = hemisphere(f"mitsuba {name}", 400, 75)
    found = evaluate(path, wi, wo, tmp_path)
    expected = table.eval(wi, wo) * wo[:, 2:]
    assert np.sqrt(np.mean((found - expected) ** 2) / np.mean(expected**2)) < 0.01
    angles = np.radians([0.5, 20, 40, 60, 75])
    points, area = quadrature()
    wi = np.repeat(direction(angles), len(points), axis=0)
    wo = np.tile(points, (len(angles), 1))
    values = evaluate(path, wi, wo, tmp_path) / wo[:, 2:]
    albedo = area * values.reshape(len(angles), -1, 3).sum(axis=1)
    # of the table by the same points, so that only the file differs
    ours = area * table.eval(wi, wo).reshape(len(angles), -1, 3).sum(axis=1)
    assert np.mean(np.abs(albedo / ours - 1)) < 0.01
    np.testing.assert_allclose(ours, table.albedo(angles), rtol=0.02)


@pytest.mark.compiled
@needs_mitsuba
def test_mitsuba_evaluates_spectra(tmp_path):
    """Wavelengths out of order: the file has them increasing, each with its own values."""
    grey = make(asymmetric, grid(30, 30, 40), tint=(1.0,))
    tint = np.array([1.0, 0.5, 0.25, 0.7])
    table = Table(
        values=grey.values * tint,
        theta_i=grey.theta_i,
        theta_i_edges=grey.theta_i_edges,
        theta_r_edges=grey.theta_r_edges,
        delta_phi_edges=grey.delta_phi_edges,
        channels=("a", "b", "c", "d"),
        row_albedo=grey.row_albedo * tint,
        wavelengths_nm=(650.0, 450.0, 550.0, 600.0),
    )
    lost = table.save(tmp_path / "spectral.bsdf")
    assert not any("wavelengths" in line for line in lost)
    wi, wo = hemisphere("mitsuba spectral", 200, 75)
    found = evaluate(tmp_path / "spectral.bsdf", wi, wo, tmp_path, table.wavelengths_nm)
    expected = table.eval(wi, wo) * wo[:, 2:]
    assert np.sqrt(np.mean((found - expected) ** 2) / np.mean(expected**2)) < 0.01
    again = Table.load(tmp_path / "spectral.bsdf")
    assert again.wavelengths_nm == (450.0, 550.0, 600.0, 650.0)


@pytest.mark.compiled
def test_wavelengths_in_any_order(tmp_path):
    """From red to blue: the same file as from blue to red, the same losses, and the error of its values."""
    rng = np.random.default_rng(seed_from("rgl order"))
    table = with_parts(make(ggx(0.3), grid(20, 20, 24)))
    peak = Peak(10 * rng.random((20, 3, 4, 3)), np.array([0, 0.05, 0.1, 0.2]), np.linspace(0, np.pi, 5))
    names = ("630 nm", "532 nm", "467 nm")
    down = table.replace(
        peak=peak,
        std_error=0.1 * table.values,
        wavelengths_nm=(630.0, 532.0, 467.0),
        channels=names,
        parts={n: p.replace(wavelengths_nm=(630.0, 532.0, 467.0), channels=names) for n, p in table.parts.items()
               if n != "transmission"},
    )  # fmt: skip
    up = reordered(down, np.array([2, 1, 0]))
    np.testing.assert_array_equal(up.values, down.values[..., ::-1])
    down.save(tmp_path / "down.h5")
    up.save(tmp_path / "up.h5")
    found = {
        name: formats.convert(tmp_path / f"{name}.h5", tmp_path / f"{name}.bsdf") for name in ("down", "up")
    }
    assert (tmp_path / "down.bsdf").read_bytes() == (tmp_path / "up.bsdf").read_bytes()
    assert found["down"].lost == found["up"].lost
    assert any("L1" in line for line in found["down"].lost)
    assert found["down"].error == pytest.approx(found["up"].error)
    down.replace(peak=None).save(tmp_path / "plain.h5")
    plain = formats.convert(tmp_path / "plain.h5", tmp_path / "plain.bsdf")
    assert plain.error < 0.02
    assert plain.albedo_error < 0.01


@pytest.mark.compiled
def test_one_wavelength_twice(tmp_path):
    table = make(lambert, grid(6, 6, 8)).replace(wavelengths_nm=(450.0, 550.0, 450.0))
    with pytest.raises(InputError, match="two channels of 450 nm"):
        table.save(tmp_path / "t.bsdf")
    assert not (tmp_path / "t.bsdf").exists()


@needs_mitsuba
def test_we_evaluate_real_files_as_mitsuba_does(real_data, tmp_path):
    path = real_data / "rgl" / "aurora_white_rgb.bsdf"
    wi, wo = hemisphere("mitsuba real", 300)
    fields = rgl._check(read_tensors(path), path)
    theirs = evaluate(path, wi, wo, tmp_path)
    theta_i, theta_o = np.arccos(wi[:, 2]), np.arccos(wo[:, 2])
    phi = np.arctan2(wo[:, 1], wo[:, 0]) - np.arctan2(wi[:, 1], wi[:, 0])
    ours = [rgl._evaluate(fields, t, theta_o[n : n + 1], phi[n : n + 1])[:, 0] for n, t in enumerate(theta_i)]
    np.testing.assert_allclose(ours, theirs, rtol=2e-3, atol=1e-5)


@pytest.mark.compiled
def test_real_file_round_trip(real_data, tmp_path):
    """A car paint: albedo below 1, and what is written again has the same albedo within 1 %."""
    table = Table.load(real_data / "rgl" / "cm_military_green_rgb.bsdf")
    assert table.values.shape == (90, 90, 180, 3)
    assert table.channels == ("R", "G", "B")
    assert "Green" in table.provenance["description"]
    assert np.all(table.row_albedo[:80] < 1)
    table.save(tmp_path / "again.bsdf")
    fields = rgl._check(read_tensors(tmp_path / "again.bsdf"), tmp_path)
    wi, wo = hemisphere("real round trip", 300, 80)
    theta_i, theta_o = np.arccos(wi[:, 2]), np.arccos(wo[:, 2])
    phi = np.arctan2(wo[:, 1], wo[:, 0]) - np.arctan2(wi[:, 1], wi[:, 0])
    found = np.array(
        [rgl._evaluate(fields, t, theta_o[n : n + 1], phi[n : n + 1])[:, 0] for n, t in enumerate(theta_i)]
    )
    expected = table.eval(wi, wo) * wo[:, 2:]
    assert abs(np.mean(found) / np.mean(expected) - 1) < 0.01
    lit = expected > 0  # a channel may be negative in the file, and 0 here
    assert np.median(np.abs(found - expected)[lit] / expected[lit]) < 0.02
    source = rgl._check(read_tensors(real_data / "rgl" / "cm_military_green_rgb.bsdf"), tmp_path)
    truth = np.array(
        [rgl._evaluate(source, t, theta_o[n : n + 1], phi[n : n + 1])[:, 0] for n, t in enumerate(theta_i)]
    )
    assert np.median(np.abs(truth - expected)[lit] / expected[lit]) < 0.03


@pytest.mark.compiled
@pytest.mark.parametrize("alpha", [0.02, 0.005])
def test_narrow_highlight(alpha, tmp_path):
    """Narrower than the table's cells, on a grid of its own: the file's nodes are where its light is."""
    table = resolved(sampled(metal(alpha)), metal(alpha))
    assert table.peak is not None
    table.save(tmp_path / "narrow.bsdf")
    fields = rgl._check(read_tensors(tmp_path / "narrow.bsdf"), tmp_path)
    rng = np.random.default_rng(seed_from("narrow"))
    for theta_i in np.radians([10, 30, 50, 65]):  # nodes of the file
        wi = np.broadcast_to(direction(theta_i), (20_000, 3))
        wo, density = table.sample(wi, rng.random((20_000, 3)))
        wi, wo, density = wi[density > 0], wo[density > 0], density[density > 0, None]
        phi = np.arctan2(wo[:, 1], wo[:, 0])
        found = rgl._evaluate(fields, theta_i, np.arccos(np.minimum(wo[:, 2], 1)), phi).T
        expected = table.eval(wi, wo) * wo[:, 2:]
        assert np.mean(found / density) == pytest.approx(np.mean(expected / density), rel=0.01)
        rms = np.sqrt(np.mean((found - expected) ** 2 / density) / np.mean(expected**2 / density))
        assert rms < 0.1


@pytest.mark.compiled
def test_narrow_highlight_of_grazing_light(tmp_path):
    """Between the file's last two angles, 85 and 90 degrees, no more light than the table has in either row."""
    table = resolved(sampled(metal(0.005), 90), metal(0.005))
    assert table.peak is not None
    table.save(tmp_path / "narrow.bsdf")
    fields = rgl._check(read_tensors(tmp_path / "narrow.bsdf"), tmp_path)
    rng = np.random.default_rng(seed_from("grazing"))
    for theta_i in np.radians([86.5, 87.5, 88.5, 89.5]):
        wi = np.broadcast_to(direction(theta_i), (20_000, 3))
        u = rng.random((20_000, 3))
        wo = np.concatenate(
            [table.sample(wi, u)[0], direction(np.arcsin(np.sqrt(u[:, 0])), 2 * np.pi * u[:, 1])]
        )
        wo = wo[wo[:, 2] > 1e-6]
        density = table.pdf(direction(theta_i), wo) + wo[:, 2] / np.pi
        phi = np.arctan2(wo[:, 1], wo[:, 0])
        found = rgl._evaluate(fields, theta_i, np.arccos(wo[:, 2]), phi).mean(axis=0)
        albedo = np.sum(found / density) / 20_000
        assert 0.5 < albedo / table.albedo(theta_i)[0] < 1.5


@pytest.mark.compiled
def test_round_trip_and_losses(tmp_path):
    table = with_parts(make(asymmetric, grid(30, 30, 40), specular=0.05))
    table = table.replace(std_error=0.1 * table.values, wavelengths_nm=None)
    lost = table.save(tmp_path / "t.bsdf")
    text = " ".join(lost)
    for what in ("error bars", "delta", "transmission, L1", "provenance"):
        assert what in text

    median, worst, albedo = formats._compare(table, Table.load(tmp_path / "t.bsdf"))
    assert median < 0.02
    assert albedo < 0.01
    assert worst < 0.1


@pytest.mark.compiled
def test_one_channel_and_refusals(tmp_path):
    lost = make(lambert, grid(6, 6, 8), tint=(1.0,)).save(tmp_path / "grey.bsdf")
    assert any("one channel" in line for line in lost)
    assert read_tensors(tmp_path / "grey.bsdf")["rgb"].shape[2] == 3
    with pytest.raises(InputError, match="2 channels"):
        make(lambert, grid(6, 6, 8), tint=(1.0, 0.5)).save(tmp_path / "two.bsdf")
    with pytest.raises(InputError, match="nothing but its delta"):
        make(lambda wi, wo: 0 * wo[..., 2] * wi[..., 2], grid(6, 6, 8), specular=0.5).save(
            tmp_path / "m.bsdf"
        )


@pytest.fixture
def fields(tmp_path):
    rng = np.random.default_rng(seed_from("rgl fields"))
    return {
        "description": np.frombuffer(b"test", np.uint8),
        "phi_i": np.zeros(1, np.float32),
        "theta_i": np.array([0, 0.8, 1.57], np.float32),
        "ndf": np.ones((2, 4), np.float32),
        "sigma": np.ones((2, 4), np.float32),
        "vndf": rng.random((1, 3, 4, 4)).astype(np.float32) + 0.1,
        "luminance": np.ones((1, 3, 2, 2), np.float32),
        "rgb": rng.random((1, 3, 3, 2, 2)).astype(np.float32),
        "jacobian": np.ones(1, np.uint8),
    }


def change(name, value):
    def action(fields):
        fields[name] = value

    return action


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda f: f.pop("vndf"), "'vndf' is missing"),
        (lambda f: f.pop("phi_i"), "'phi_i' is missing"),
        (change("phi_i", np.zeros(8, np.float32)), "anisotropic, 8 angles"),
        (change("theta_i", np.array([0, 0.8], np.float32)), "'vndf' begins with shape"),
        (change("theta_i", np.array([0, 0.8, 0.3], np.float32)), "must increase"),
        (change("rgb", np.ones((1, 3, 2, 2, 2), np.float32)), "'spectra' begins with shape"),
        (change("rgb", np.ones((1, 3, 3, 1, 2), np.float32)), "single node"),
        (change("rgb", np.full((1, 3, 3, 2, 2), np.nan, np.float32)), "'rgb' holds NaN"),
        (change("sigma", np.zeros((2, 4), np.float32)), "cannot be inverted"),
        (change("vndf", np.zeros((1, 3, 4, 4), np.float32)), "cannot be inverted"),
        (change("ndf", np.ones((2, 4, 4), np.float32)), "'ndf' has shape"),
    ],
)
def test_damaged_fields(fields, damage, message, tmp_path):
    damage(fields)
    write_tensors(tmp_path / "bad.bsdf", fields)
    refused(tmp_path / "bad.bsdf", message)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (MAGIC, "middle of its list"),
        (MAGIC + b"\2\0" + b"\0" * 4, "version 2.0"),
        (MAGIC + b"\1\0" + b"\0" * 4, "'phi_i' is missing"),
        (MAGIC + b"\1\0\1\0\0\0\1\0x" + struct.pack("<HBQQ", 1, 10, 0, 2**40), "is not within"),
        (MAGIC + b"\1\0\1\0\0\0\1\0x" + struct.pack("<HBQQ", 1, 77, 0, 1), "type 77"),
        (MAGIC + b"\1\0\1\0\0\0\1\0x" + struct.pack("<HBQ2Q", 2, 10, 0, 2**63, 2), "is not within"),
    ],
)
def test_damaged_containers(content, message, tmp_path):
    (tmp_path / "bad.bsdf").write_bytes(content)
    refused(tmp_path / "bad.bsdf", message)
