"""Zemax text: angles about the specular direction, round trips, transmission, real files, damage."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.core.directions import direction
from gonio.formats import zemax
from gonio.formats.samples import sample_error
from gonio.table.checks import check
from gonio.table.table import Table
from microgeometry.errors import InputError
from tests.formats.damage import refused_after
from tests.table.tables import asymmetric, grid, lambert, make

AOI, AZIMUTHS, RADIALS = [0.0, 30.0, 60.0], np.arange(0, 361, 15), np.arange(0, 181, 5)


def specular_direction(aoi, azimuth, radial):
    """The unit vector of Zemax's angles by rotation: about the mirror direction of light at +x."""
    a = np.radians(aoi)
    mirror = np.array([-np.sin(a), 0, np.cos(a)])
    to_normal = np.array([np.cos(a), 0, np.sin(a)])
    across = np.array([0, 1, 0])
    r, z = np.radians(radial), np.radians(azimuth)
    return np.cos(r) * mirror + np.sin(r) * (np.cos(z) * to_normal + np.sin(z) * across)


def write_file(
    path,
    brdf,
    symmetry="Asymmetrical",
    azimuths=AZIMUTHS,
    kind="BRDF",
    tis=0.5,
    rotations=(0,),
    radials=RADIALS,
):
    lines = ["# made by hand", "Source  Measured", f"Symmetry  {symmetry}", "SpectralContent  Monochrome"]
    lines += [f"ScatterType  {kind}"]
    for name, values in (
        ("SampleRotation", rotations),
        ("AngleOfIncidence", AOI),
        ("ScatterAzimuth", azimuths),
        ("ScatterRadial", radials),
    ):
        lines += [f"{name} {len(values)}", "\t".join(map(str, values))]
    lines += ["", "Monochrome", "DataBegin"]
    for n in range(len(rotations)):
        for aoi in AOI:
            lines.append(f"TIS {tis}")
            wi = direction(np.radians(aoi))
            for azimuth in azimuths:
                wo = np.array([specular_direction(aoi, azimuth, r) for r in radials])
                values = np.where(wo[:, 2] > 0, brdf(wi[None], wo), 0) * (n + 1)
                lines.append("\t".join(f"{v:.6e}" for v in values))
    lines.append("DataEnd")
    path.write_text("\r\n".join(lines) + "\r\n")
    return path


def away_from_horizon(table):
    """Cells whose neighbours in the file are all above the horizon."""
    return np.flatnonzero(table.theta_r < np.radians(75))


@pytest.mark.parametrize(
    ("symmetry", "azimuths"), [("Asymmetrical", AZIMUTHS), ("planesymmetrical", np.arange(0, 181, 15))]
)
def test_asymmetric_function(symmetry, azimuths, tmp_path):
    """Fails with wi and wo exchanged, with delta phi mirrored, with a cosine, with azimuth 0 outwards."""
    table = Table.load(write_file(tmp_path / "a.bsdf", asymmetric, symmetry, azimuths))
    rings = away_from_horizon(table)
    wo = direction(table.theta_r[:, None], table.delta_phi)
    for row, theta_i in enumerate(np.radians(AOI)):
        expected = asymmetric(direction(theta_i), wo)[rings]
        np.testing.assert_allclose(table.values[row, rings, :, 0], expected, rtol=0.02)
    assert table.gaps is None
    assert table.provenance["tis"] == [[0.5]] * 3


def test_values_are_not_scaled_to_tis(tmp_path):
    table = Table.load(write_file(tmp_path / "a.bsdf", lambert, tis=0.1))
    np.testing.assert_allclose(table.values[:, away_from_horizon(table)], 0.5 / np.pi, rtol=1e-5)
    np.testing.assert_allclose(table.provenance["integral"], 0.5, rtol=0.03)


def test_rotations_are_averaged_and_said_so(tmp_path):
    path = write_file(tmp_path / "a.bsdf", lambert, "Asymmetrical4D", rotations=(0, 120, 360))
    table = Table.load(path)  # weights 1, 2; the third is the first again
    np.testing.assert_allclose(table.values[:, away_from_horizon(table)], 0.75 / np.pi, rtol=1e-5)
    assert "3 rotations" in table.provenance["lost"][0]


def test_transmission_is_a_part(tmp_path):
    table = Table.load(write_file(tmp_path / "t.bsdf", asymmetric, kind="BTDF"))
    assert np.all(table.gaps)
    part = table.parts["transmission"]
    rings = away_from_horizon(table)
    wo = direction(table.theta_r[:, None], table.delta_phi)
    # about the straight continuation, whose delta phi is pi, as the mirror direction's is
    expected = asymmetric(direction(np.radians(60.0)), wo)[rings]
    np.testing.assert_allclose(part.values[2, rings, :, 0], expected, rtol=0.02)


def test_unmeasured_directions_are_gaps(tmp_path):
    """Beyond 30 degrees about the specular direction; samples at 30 are met as well as others."""
    path = write_file(tmp_path / "a.bsdf", lambert)
    text = path.read_text().replace("ScatterRadial 37", "ScatterRadial 7")
    lines = [
        "\t".join(line.split("\t")[:7]) if line.count("\t") == 36 else line for line in text.splitlines()
    ]
    path.write_text("\n".join(lines))
    table = Table.load(path)
    retro, mirror = (table.theta_r_edges.searchsorted(np.radians(a)) - 1 for a in (33, 25))
    assert not table.gaps[1, mirror, -1]
    assert table.gaps[1, retro, 0]
    assert table.values[1, retro, 0, 0] == 0
    samples = zemax.samples_of(path)[""]
    np.testing.assert_allclose(
        table.eval(direction(samples.theta_i), direction(samples.theta_r, samples.delta_phi))[:, 0],
        samples.values[:, 0],
        rtol=0.05,
    )


def test_highlights_between_coarse_angles_are_met(tmp_path):
    """Half as bright one sample of 5 degrees off the mirror direction."""

    def glossy(wi, wo):
        return np.exp(-((np.arccos(np.clip(wo @ (wi[0] * [-1, 1, 1]), -1, 1)) / np.radians(6)) ** 2))

    path = write_file(tmp_path / "a.bsdf", glossy)
    assert sample_error(Table.load(path), zemax.samples_of(path)[""])[1] < 0.08


def test_a_small_file_gets_larger_cells(tmp_path, monkeypatch):
    path = write_file(tmp_path / "a.bsdf", lambert)
    monkeypatch.setattr(zemax, "justified_bytes", lambda path: 8 * 2 * len(AOI) * 20**2)
    assert Table.load(path).values.shape == (len(AOI), 20, 40, 1)


@pytest.mark.compiled
def test_round_trip(tmp_path):
    """Three colours through tristimulus values and back, and the written angles."""
    table = make(asymmetric, grid(9, 30, 36), theta_i=np.radians([0.0, 20, 45, 70]))
    lost = table.save(tmp_path / "t.zemax.bsdf")
    assert any("provenance" in line for line in lost)
    again = Table.load(tmp_path / "t.zemax.bsdf")
    assert again.channels == ("R", "G", "B")
    np.testing.assert_allclose(again.theta_i, table.theta_i, atol=1e-9)
    wo = direction(table.theta_r[:25, None], table.delta_phi)
    for row, theta_i in enumerate(table.theta_i):
        wi = direction(theta_i)
        np.testing.assert_allclose(
            again.eval(wi, wo) / again.albedo(theta_i),
            table.eval(wi, wo) / table.albedo(theta_i),
            rtol=0.04,
            err_msg=str(row),
        )
    np.testing.assert_allclose(again.provenance["tis"], table.row_albedo, rtol=1e-4)
    np.testing.assert_allclose(again.row_albedo, table.row_albedo, rtol=0.03)


def test_angles_there_and_back():
    theta_r, phi = np.meshgrid(np.linspace(0.01, 1.5, 20), np.linspace(-3.1, 3.1, 30))
    for theta_i in (0.0, 0.4, 1.3):
        again = zemax._from_specular(theta_i, *zemax._to_specular(theta_i, theta_r.ravel(), phi.ravel()))
        np.testing.assert_allclose(again[0], theta_r.ravel(), atol=1e-9)
        np.testing.assert_allclose(again[1], phi.ravel(), atol=1e-9)


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["AnoBlackEC2onAlum", "AnoBlackNiTEonSteel", "IMX455"])
def test_real_files(name, real_data):
    table = Table.load(real_data / "ualoft" / f"{name}.bsdf")
    np.testing.assert_allclose(np.degrees(table.theta_i), [10, 30, 50, 70])
    assert check(table).passed
    assert (table.gaps is None) == (name == "IMX455")
    if name == "AnoBlackEC2onAlum":
        # the file's own numbers at the specular direction
        found = table.eval(direction(np.radians(10.0)), direction(np.radians(10.0), np.pi))
        known = table.row_albedo[0, 0] / table.albedo(np.radians(10.0))[0]
        assert found[0] * known == pytest.approx(2.633e-2, rel=0.05)


DAMAGE = {
    "empty": (lambda t: "", "ends where Source"),
    "binary": (lambda t: "\x89PNG" * 10, "where Source is expected"),
    "symmetry": (lambda t: t.replace("Asymmetrical", "Spherical"), "Symmetry 'spherical'; allowed are plane"),
    "content": (lambda t: t.replace("Monochrome", "Stereo", 1), "SpectralContent 'stereo'"),
    "count": (lambda t: t.replace("ScatterRadial 37", "ScatterRadial 1e9"), "a whole number that the file"),
    "fraction": (lambda t: t.replace("ScatterRadial 37", "ScatterRadial 3.5"), "a whole number"),
    "order": (lambda t: t.replace("0.0\t30.0\t60.0", "0.0\t60.0\t30.0"), "angles that increase"),
    "short": (lambda t: t[: len(t) // 2], "copy it again"),
    "word": (lambda t: t.replace("e-02", "e-xx", 1), "numbers are expected"),
    "nan": (lambda t: t.replace("TIS 0.5", "TIS nan"), "NaN or infinity"),
    "tis": (lambda t: t.replace("TIS", "TOT", 1), "'TOT' where TIS is expected"),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_damaged_files(name, tmp_path):
    damage, message = DAMAGE[name]
    refused_after(damage, write_file(tmp_path / "a.bsdf", asymmetric), message)


def test_two_channels_are_refused(tmp_path):
    with pytest.raises(InputError, match="2 channels"):
        make(lambert, grid(6, 6, 8), tint=(1.0, 0.5)).save(tmp_path / "two.zemax.bsdf")
