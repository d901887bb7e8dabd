"""SPEOS files: conventions, scale, and the pair of one measurement in SPEOS's and Zemax's form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from gonio.core.directions import direction
from gonio.table.checks import check
from gonio.table.table import Table
from microgeometry.errors import InputError
from tests.formats.damage import refused_after
from tests.table.tables import asymmetric, lambert

AOI = [10.0, 40.0, 70.0]
THETA, PHI = np.arange(0.0, 91, 5), np.arange(0.0, 361, 10)


def block(brdf, aoi, transmitted=False, intensity=False, scale=1.0):
    """Rows of theta; phi = 0 is the mirror direction, opposite to the light."""
    wi = direction(np.radians(aoi))
    wo = direction(np.radians(THETA)[:, None], np.pi + np.radians(PHI))
    values = scale * brdf(wi[None, None], wo) * (wo[..., 2] if intensity else 1)
    theta = THETA
    if transmitted:
        theta, values = 180 - THETA[::-1], values[::-1]
    lines = [f"{len(THETA)} {len(PHI)}", "\t" + "\t".join(map(str, PHI))]
    return lines + ["\t".join(map(repr, map(float, [t, *v]))) for t, v in zip(theta, values, strict=True)]


def write_brdf(path, brdf, flags=(1, 0), kind=1, percent=50.0, wavelengths=(450.0, 650.0)):
    lines = [
        "OPTIS - brdf surface file v8.0",
        "0",
        "a comment",
        "9",
        "two\nlines",
        "\t".join(map(str, flags)),
    ]
    lines += [str(kind), f"{len(AOI)}\t{len(wavelengths)}", " ".join(map(str, AOI))]
    lines.append(" ".join(map(str, wavelengths)))
    for side, there in enumerate(flags):
        for aoi in AOI if there else ():
            for n in range(len(wavelengths)):
                lines += [str(percent), *block(brdf, aoi, side == 1, kind == 0, 1 / (1 + n) / (1 + side))]
    path.write_text("\n".join([*lines, "End of file", ""]))
    return path


def write_anisotropic(path, brdf, turns=(0.0,), spectrum=((400.0, 20.0), (700.0, 20.0)), kind=1):
    lines = [
        "OPTIS - Anisotropic BSDF surface file v8.0",
        "0",
        "a comment",
        "0",
        "",
        "0 1 0",
        "1 0",
        str(kind),
    ]
    lines += [str(len(turns)), " ".join(map(str, turns))]
    for _ in turns:
        lines += [str(len(AOI)), " ".join(map(str, AOI))]
    lines += ["25.0 0", "", str(len(spectrum)), *(f"{w} {c}" for w, c in spectrum)]
    for n in range(len(turns)):
        for aoi in AOI:
            lines += block(brdf, aoi, intensity=kind == 0, scale=7.0 * (n + 1))
    path.write_text("\n".join([*lines, "End of file", ""]))
    return path


def expected(table, brdf, row):
    return brdf(
        direction(table.theta_i[row]),
        direction(np.radians(THETA)[:, None], np.radians(np.arange(0.0, 181, 10))),
    )


@pytest.mark.parametrize("kind", [1, 0])
def test_asymmetric_function(kind, tmp_path):
    table = Table.load(write_brdf(tmp_path / "a.brdf", asymmetric, (1, 1), kind))
    assert table.wavelengths_nm == (450.0, 650.0)
    assert table.gaps is None
    below = table.parts["transmission"]
    for row in range(3):
        truth = expected(table, asymmetric, row)
        if kind == 1:  # f as it stands, whatever the percentage
            np.testing.assert_allclose(table.values[row, ..., 0], truth, rtol=1e-9)
            np.testing.assert_allclose(table.values[row, ..., 1], truth / 2, rtol=1e-9)
            np.testing.assert_allclose(below.values[row, ..., 0], truth / 2, rtol=1e-9)
        else:  # intensity has no scale; at the horizon it says nothing of f
            ratio = table.values[row, :-1, :, 0] / truth[:-1]
            np.testing.assert_allclose(ratio, ratio[0, 0], rtol=1e-9)
    np.testing.assert_allclose(table.provenance["tis"], 0.5)
    if kind == 0:
        np.testing.assert_allclose(table.row_albedo, 0.5, rtol=1e-9)


@pytest.mark.parametrize("kind", [1, 0])
def test_anisotropic_file_has_the_scale_of_its_spectrum(kind, tmp_path):
    """20 % at 25 degrees, half way between the first two rows; all rows by the same factor."""
    table = Table.load(write_anisotropic(tmp_path / "a.anisotropicbsdf", asymmetric, kind=kind))
    assert table.channels == ("Y",)
    assert table.row_albedo[:2, 0].mean() == pytest.approx(0.2)
    truth = np.stack([expected(table, asymmetric, row) for row in range(3)])
    ratio = table.values[:, :-1, :, 0] / truth[:, :-1]
    np.testing.assert_allclose(ratio, ratio[0, 0, 0], rtol=1e-9)


def test_spectrum_and_rotations(tmp_path):
    path = write_anisotropic(
        tmp_path / "a.anisotropicbsdf", lambert, (0.0, 90.0), ((400.0, 20.0), (700.0, 40.0))
    )
    table = Table.load(path)
    assert table.wavelengths_nm == (400.0, 700.0)
    np.testing.assert_allclose(table.row_albedo, np.broadcast_to([0.2, 0.4], (3, 2)), rtol=1e-9)
    assert "2 anisotropy angles of reflection" in table.provenance["lost"][0]
    assert "they add up to the 20 to 40 % that" in table.provenance["lost"][1]


def test_transmission_alone(tmp_path):
    table = Table.load(write_brdf(tmp_path / "t.brdf", asymmetric, (0, 1)))
    assert np.all(table.gaps)
    assert np.all(table.values == 0)
    truth = expected(table, asymmetric, 1)
    np.testing.assert_allclose(table.parts["transmission"].values[1, ..., 0], truth / 2, rtol=1e-9)


@pytest.mark.compiled
def test_pair_of_one_measurement(real_data):
    """Fields of a simulation as SPEOS and, by Ansys's own converter, as Zemax."""
    speos = Table.load(real_data / "ansys" / "test_13_brdf_one_wavelength_speos.brdf")
    zemax = Table.load(real_data / "ansys" / "test_13_brdf_one_wavelength_BRDF_zemax_reference.bsdf")
    np.testing.assert_allclose(speos.theta_i, zemax.theta_i, atol=1e-9)
    np.testing.assert_allclose(speos.row_albedo, zemax.row_albedo, rtol=2e-3)
    assert "transmission" in speos.parts
    assert check(speos).passed
    assert check(zemax).passed
    u = np.linspace(0, np.sin(np.radians(70)) ** 2, 60)
    wo = direction(np.arcsin(np.sqrt(u))[:, None], np.linspace(0, 2 * np.pi, 90))
    for theta_i in speos.theta_i:
        a, b = (t.eval(direction(theta_i), wo)[..., 0] for t in (speos, zemax))
        assert np.sqrt(np.mean((a - b) ** 2) / np.mean(b**2)) < 0.015


@pytest.mark.compiled
def test_pair_whose_scale_is_tis(real_data):
    """The two agree but for the factors that each says: Ansys's converter scaled Zemax's rows to their TIS lines.

    What is left is the converter's own interpolation at 10 degrees of azimuth and 5 of theta.
    """
    speos = Table.load(real_data / "ansys" / "test_13_planesymmetric_brdf_speos_reference.anisotropicbsdf")
    zemax = Table.load(real_data / "ansys" / "test_13_planesymmetric_brdf_zemax.bsdf")
    assert check(speos).passed
    assert check(zemax).passed
    tis = np.array(zemax.provenance["tis"])
    np.testing.assert_allclose(speos.row_albedo, tis, rtol=0.015)
    factors = (tis / zemax.row_albedo)[:, 0]
    said = f"the reflectance TIS, {factors.min():.3g} to {factors.max():.3g} times what the values add up to"
    assert zemax.provenance["lost"][0].startswith(said)
    assert "times 0.318 they add up to the 13.45 %" in speos.provenance["lost"][0]
    u = np.linspace(0, np.sin(np.radians(60)) ** 2, 60)
    wo = direction(np.arcsin(np.sqrt(u))[:, None], np.linspace(0, 2 * np.pi, 90))
    for row, theta_i in enumerate(speos.theta_i[:8]):
        a, b = (
            speos.eval(direction(theta_i), wo)[..., 0],
            factors[row] * zemax.eval(direction(theta_i), wo)[..., 0],
        )
        assert np.sqrt(np.mean((a - b) ** 2) / np.mean(b**2)) < 0.06
        assert a.mean() == pytest.approx(b.mean(), rel=0.012)


@pytest.mark.compiled
def test_tis_holds_what_was_not_measured(real_data):
    """Zemax's values are f as they stand: the lines' excess over their integral is in the gaps.

    The instrument saw 80 degrees about the mirror direction; 5 to 46 % of the hemisphere's projected solid angle
    lie beyond. TIS stands between the integral without that, and with what was measured continued into it.
    Scaling to TIS, as Ansys's converter did, makes what was measured 3 to 18 % too bright.
    """
    zemax = Table.load(real_data / "ansys" / "test_13_planesymmetric_brdf_zemax.bsdf")
    tis = np.array(zemax.provenance["tis"])[:, 0]
    dark = zemax.row_albedo[:, 0]
    full = []
    for values, gaps in zip(zemax.values[..., 0], zemax.gaps, strict=True):
        nearest = ndimage.distance_transform_edt(gaps, return_distances=False, return_indices=True)
        full.append(np.sum(values[tuple(nearest)] * zemax.projected_solid_angles))
    assert np.all(dark < tis)
    assert np.all(tis < full)
    share = np.sum(zemax.gaps * zemax.projected_solid_angles, axis=(1, 2)) / np.pi
    assert share[0] == pytest.approx(0.053, abs=0.01)
    assert share[-1] == pytest.approx(0.464, abs=0.01)


DAMAGE = {
    "empty": (lambda t: "", "ends where the title"),
    "title": (lambda t: t.replace("OPTIS", "OPTICS"), "'OPTIS - brdf surface file' is expected"),
    "version": (lambda t: t.replace("v8.0", "v7.0"), "version 'v7.0'"),
    "binary": (lambda t: t.replace("v8.0\n0", "v8.0\n1"), "a binary SPEOS file"),
    "neither": (lambda t: t.replace("\n1\t0\n", "\n0\t0\n"), "neither reflection"),
    "count": (lambda t: t.replace("3\t2", "3000000000\t2"), "a whole number that the file"),
    "description": (lambda t: t.replace("comment\n9", "comment\n-9"), "0 or more"),
    "row": (lambda t: t.replace("\n5.0\t", "\n5.0\t7\t"), "numbers of an angle theta"),
    "order": (lambda t: t.replace("\n5.0\t", "\n15.0\t"), "angles that increase"),
    "short": (lambda t: t[: len(t) // 2], "expected"),
    "nan": (lambda t: t.replace("\n50.0\n", "\nnan\n", 1), "NaN or infinity"),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_damaged_files(name, tmp_path):
    damage, message = DAMAGE[name]
    refused_after(damage, write_brdf(tmp_path / "a.brdf", asymmetric), message)


def test_values_without_scale(tmp_path):
    path = write_anisotropic(tmp_path / "a.anisotropicbsdf", lambda wi, wo: 0 * wi[..., 2] * wo[..., 2])
    with pytest.raises(InputError, match="0 everywhere"):
        Table.load(path)


def test_only_read(tmp_path):
    table = Table.load(write_brdf(tmp_path / "a.brdf", lambert))
    with pytest.raises(InputError, match=r"only read; written are \.h5"):
        table.save(tmp_path / "b.brdf")
