from pathlib import Path

import numpy as np
import pytest

from microgeometry import colour
from microgeometry.colour import ILLUMINANTS, SRGB_FROM_XYZ, rgb_luminance, rgb_matrix, xyz_weights
from microgeometry.columns import read_columns
from microgeometry.grid import CIE_RANGE_NM
from microgeometry.indices import refractive_index

EVERY_NM = np.arange(380.0, 781.0)
SAMPLES = np.linspace(*CIE_RANGE_NM, 21)


def reflectance(wavelengths, name, film=0.0):
    """At normal incidence, of a metal, or of fused silica (thickness in nm) on it: Airy's formula."""
    n, k = refractive_index(name, wavelengths)
    n = n + 1j * k
    n_film, _ = refractive_index("SiO2", wavelengths)
    upper, lower = (1 - n_film) / (1 + n_film), (n_film - n) / (n_film + n)
    round_trip = np.exp(4j * np.pi * n_film * film / wavelengths)
    return np.abs((upper + lower * round_trip) / (1 + upper * lower * round_trip)) ** 2


@pytest.mark.parametrize(
    ("illuminant", "xy"),
    # CIE 15: white points of the 2-degree observer, from sums every 5 nm. E's is 1/3 by the observer's
    # normalisation.
    [("D65", (0.31272, 0.32903)), ("A", (0.44758, 0.40745)), ("E", (1 / 3, 1 / 3))],
)
def test_white_points(illuminant, xy):
    white = xyz_weights(EVERY_NM, illuminant).sum(axis=1)
    assert white[1] == pytest.approx(1, abs=1e-12)
    assert white[:2] / white.sum() == pytest.approx(xy, abs=4e-5)


@pytest.mark.parametrize("illuminant", ILLUMINANTS)
@pytest.mark.parametrize("n", [1, 2, 21, 301])
def test_white_is_one(illuminant, n):
    samples = np.linspace(*CIE_RANGE_NM, n)
    assert rgb_matrix(samples, illuminant) @ np.ones(n) == pytest.approx((1, 1, 1), abs=1e-12)


@pytest.mark.parametrize(
    ("illuminant", "xyz"),
    [
        # Of exp(-((wavelength - 540 nm) / 60 nm)^2), by the colour-science package 0.4 from the CIE's tables at
        # 1 nm, 360 to 780 nm.
        ("D65", (0.393213, 0.693497, 0.205959)),
        ("A", (0.426259, 0.624809, 0.086044)),
        ("E", (0.401252, 0.676184, 0.182268)),
    ],
)
def test_against_another_program(illuminant, xyz):
    spectrum = np.exp(-(((EVERY_NM - 540) / 60) ** 2))
    assert xyz_weights(EVERY_NM, illuminant) @ spectrum == pytest.approx(xyz, abs=1e-5)


def test_srgb_is_its_primaries():
    # IEC 61966-2-1: chromaticities of red, green, blue; white is D65 at (0.3127, 0.3290), Y = 1.
    xy = np.array([(0.64, 0.33), (0.30, 0.60), (0.15, 0.06)])
    primaries = np.column_stack((xy, 1 - xy.sum(axis=1))).T / xy[:, 1]
    white = np.array((0.3127, 0.3290, 0.3583)) / 0.3290
    xyz_from_srgb = primaries * np.linalg.solve(primaries, white)
    # The standard rounds that matrix to four digits before it inverts it.
    assert SRGB_FROM_XYZ @ xyz_from_srgb == pytest.approx(np.eye(3), abs=2e-4)


def test_d65_needs_no_adaptation():
    unscaled = SRGB_FROM_XYZ @ xyz_weights(SAMPLES, "D65")
    assert unscaled.sum(axis=1) == pytest.approx((1, 1, 1), abs=5e-4)


def test_a_hat_is_linear_between_and_flat_beyond_the_samples():
    # So a line between the first and last sample is integrated exactly from few samples as from many.
    first, last = CIE_RANGE_NM
    line = np.clip((EVERY_NM - first) / (last - first), 0, 1)
    for samples in (SAMPLES, np.array(CIE_RANGE_NM)):
        few = xyz_weights(samples, "D65") @ ((samples - first) / (last - first))
        assert few == pytest.approx(xyz_weights(EVERY_NM, "D65") @ line, abs=1e-12)


def test_the_lamp_is_plancks():
    # ISO/CIE 11664-2: illuminant A is a black body of 2848 K with c2 = 1.435e7 nm K, 100 at 560 nm.
    file = Path(colour.__file__).with_name("cie.csv")
    columns = read_columns(file, ("wavelength_nm", "A"), ("x_bar", "y_bar", "z_bar", "D65"))
    w = columns["wavelength_nm"]
    planck = 100 * (560 / w) ** 5 * np.expm1(1.435e7 / (2848 * 560)) / np.expm1(1.435e7 / (2848 * w))
    assert columns["A"] == pytest.approx(planck, rel=1e-5)


def test_gold():
    # Lagarde and de Rousiers 2014 (Moving Frostbite to PBR) print (1, .766, .336) for gold, clipped; data sets of
    # gold differ by some hundredths.
    rgb = rgb_matrix(SAMPLES, "D65") @ reflectance(SAMPLES, "Au")
    assert rgb == pytest.approx((1.0, 0.766, 0.336), abs=0.05)
    # It is out of sRGB's gamut, as gold is.
    assert rgb[0] > 1.02


@pytest.mark.parametrize(
    ("step", "name", "film", "error"),
    [
        # The table in Grid's docstring.
        (15, "Au", 0, 1.4e-3),
        (15, "Cu", 0, 1.3e-3),
        (15, "Ag", 0, 1.5e-4),
        (15, "Al", 0, 1.5e-4),
        (15, "Cr", 0, 1.5e-4),
        (15, "Si", 300, 1.3e-3),
        (15, "Si", 1000, 3.8e-3),
        (15, "Si", 2000, 8.6e-3),
        (5, "Au", 0, 1.3e-4),
        (5, "Si", 300, 9e-5),
        (5, "Si", 2000, 1.1e-3),
    ],
)
def test_step_is_fine_enough(step, name, film, error):
    samples = np.arange(CIE_RANGE_NM[0], CIE_RANGE_NM[1] + 1, step)
    rgb, exact = (rgb_matrix(w, "D65") @ reflectance(w, name, film) for w in (samples, EVERY_NM))
    assert np.abs(rgb - exact).max() < error


@pytest.mark.parametrize("illuminant", ILLUMINANTS)
def test_luminance_of_rgb_is_y(illuminant):
    samples = np.linspace(405, 705, 21)
    reflectance = np.random.default_rng(0).uniform(0, 1, 21)
    rgb = rgb_matrix(samples, illuminant) @ reflectance
    y = xyz_weights(samples, illuminant)[1] @ reflectance
    assert rgb_luminance(illuminant) @ rgb == pytest.approx(y, rel=1e-12)
    assert rgb_luminance(illuminant).sum() == pytest.approx(1, rel=1e-12)
