import time

import numpy as np
import pytest

from microgeometry.errors import InputError
from tests.microgeometry.conftest import z_score


@pytest.mark.parametrize(("alpha", "samples", "per_length"), [(0.5, 256, 4), (0.1, 256, 16), (1.0, 129, 5.3)])
def test_expected_alpha_of_the_mesh_is_the_one_asked_for(specimen_of, alpha, samples, per_length):
    surface = specimen_of(
        "gaussian", alpha=alpha, samples=samples, samples_per_correlation_length=per_length
    ).surface
    squares = [surface.realise(seed).statistics().alpha ** 2 for seed in range(20)]
    z, relative = z_score(squares, alpha**2)
    assert z < 4
    # Sharp enough to tell the mesh from the continuous surface, whose alpha^2 differs by 3 % at 4 samples.
    if per_length == 4:
        assert relative < 0.0075


@pytest.mark.parametrize("per_length", [4, 16])
def test_expected_rms_height_of_the_mesh_is_the_one_asked_for(specimen_of, per_length):
    surface = specimen_of(
        "gaussian", rms_height=0.3, correlation_length=2, units="nm", samples=256,
        samples_per_correlation_length=per_length,
    ).surface  # fmt: skip
    stats = [surface.realise(seed).statistics() for seed in range(20)]
    assert z_score([s.rms_height**2 for s in stats], (0.3e-9) ** 2)[0] < 4
    if per_length == 16:
        # alpha = 2 rms_height / length = 0.3 on the continuous surface; the facets' alpha^2 is smaller by
        # 2 (1 - exp(-d^2)) / (2 d^2), d = 1/16 of a length: 0.2 %, far below 4 standard errors.
        assert z_score([s.alpha**2 for s in stats], 0.3**2)[0] < 4


def test_autocorrelation_is_gaussian_along_both_axes(specimen_of):
    # C(r) = s^2 (exp(-r^2/l^2) - pi l^2/L^2): the second term is the tile's mean, which is taken out.
    # With L = 16 l and r = l: C(l)/C(0) = (1/e - pi/256) / (1 - pi/256) = 0.36003.
    surface = specimen_of("gaussian", alpha=0.5, samples=256, samples_per_correlation_length=16).surface
    expected = (np.exp(-1) - np.pi / 256) / (1 - np.pi / 256)
    for axis in (0, 1):
        differences = []
        for seed in range(40):
            h = surface.realise(seed).heights
            differences.append(np.mean(h * np.roll(h, 16, axis)) / 1e-14 - expected * np.mean(h * h) / 1e-14)
        differences = np.array(differences)
        std_error = differences.std(ddof=1) / np.sqrt(40)
        # C(0) = (alpha l / 2)^2 = 6.25e-14 m^2, so the test resolves about 0.01 of rho.
        assert std_error / 6.25 < 0.02
        assert abs(differences.mean()) < 4 * std_error


def test_slopes_are_isotropic_and_gaussian(specimen_of):
    surface = specimen_of("gaussian", alpha=0.5, samples=256, samples_per_correlation_length=8).surface
    x, y, fourth = [], [], []
    for seed in range(20):
        hx, hy = surface.realise(seed).slopes()
        x.append(np.mean(hx**2))
        y.append(np.mean(hy**2))
        fourth.append(np.mean(hx**4))
    # alpha^2 / 2 per axis; a Gaussian's fourth moment is 3 variance^2 (as an ensemble: 3 (alpha^2/2)^2).
    assert z_score(x, 0.125)[0] < 4
    assert z_score(y, 0.125)[0] < 4
    assert z_score(fourth, 3 * 0.125**2)[0] < 4


@pytest.mark.parametrize("lengths", [[2, 2], [2, 5]])
def test_correlation_lengths_are_reported(specimen_of, lengths):
    # About the tile's mean, which is a share m of the variance (L = 16 l), the autocorrelation is
    # (rho - m) / (1 - m): 1/e where rho = (1 - m)/e + m, a little short of l. The mean of 40 is good to 1 %.
    keys = {"alpha": 0.5, "correlation_length": lengths, "samples": 256}
    surface = specimen_of("gaussian", **keys).surface
    mean = np.pi / 16**2
    part = (1 - mean) / np.e + mean
    stats = [surface.realise(seed).statistics() for seed in range(40)]
    for axis, length in zip("xy", lengths, strict=True):
        measured = [getattr(s, f"correlation_length_{axis}") for s in stats]
        z, relative = z_score(measured, length * 1e-6 * np.sqrt(-np.log(part)))
        assert z < 4
        assert relative < 0.02


def test_two_correlation_lengths_stretch_the_surface(specimen_of):
    # lx = 1, ly = 3: the slope variance along y is 1/9 of that along x, and their sum is alpha^2.
    keys = {"alpha": 0.5, "correlation_length": [1, 3], "samples": 128, "samples_per_correlation_length": 8}
    surface = specimen_of("gaussian", **keys).surface
    tiles = [surface.realise(seed) for seed in range(40)]
    assert tiles[0].size == pytest.approx((16e-6, 48e-6))
    squares = np.array([[np.mean(slope**2) for slope in tile.slopes()] for tile in tiles])
    assert z_score(squares[:, 0], 0.25 * 9 / 10)[0] < 4
    assert z_score(squares[:, 1], 0.25 / 10)[0] < 4
    # On the continuous surface alpha^2 = 2 rms^2 (1 + 1/9); 0.8 % less at 8 samples, allowed for by 4 errors.
    rms_height = 0.5 / np.sqrt(2 * (1 + 1 / 9))
    del keys["alpha"]
    surface = specimen_of("gaussian", rms_height=rms_height, **keys).surface
    stats = [surface.realise(seed).statistics() for seed in range(40)]
    assert z_score([s.rms_height**2 for s in stats], (rms_height * 1e-6) ** 2)[0] < 4
    assert z_score([s.alpha**2 for s in stats], 0.25)[0] < 4


def test_seed_is_the_realisation(specimen_of):
    surface = specimen_of("gaussian", alpha=0.5, samples=64, samples_per_correlation_length=4).surface
    first, again, other = surface.realise(7), surface.realise(7), surface.realise(8)
    assert first.heights.tobytes() == again.heights.tobytes()
    assert abs(np.corrcoef(first.heights.ravel(), other.heights.ravel())[0, 1]) < 0.5
    assert surface.is_random


def test_scale_does_not_change_the_shape(specimen_of):
    one, small = (
        specimen_of("gaussian", alpha=0.5, samples=128, units=unit).surface.realise(3) for unit in ("m", "nm")
    )
    np.testing.assert_allclose(small.heights * 1e9, one.heights, rtol=1e-9, atol=1e-12)


def test_alpha_zero_is_exactly_flat(tile_of):
    tile = tile_of("gaussian", alpha=0, samples=128)
    assert not tile.heights.any()
    assert tile.statistics().alpha == 0


def test_size_and_samples_per_length_say_the_same(specimen_of):
    # 256 samples, 16 per length of 2 um: 32 um.
    by_size = specimen_of("gaussian", alpha=0.5, correlation_length=2, samples=256, size=32).surface
    by_count = specimen_of("gaussian", alpha=0.5, correlation_length=2, samples=256).surface
    assert by_size.size == pytest.approx(32e-6)
    assert by_count.size == pytest.approx(by_size.size)
    assert specimen_of("gaussian", alpha=0.5).surface.samples == 512


def test_realisation_is_fast(specimen_of):
    # A batch of rays waits for it. It takes 7 ms here; the limit leaves room for a busy machine.
    surface = specimen_of("gaussian", alpha=0.5).surface
    seconds = []
    for seed in range(8):
        start = time.perf_counter()
        surface.realise(seed)
        seconds.append(time.perf_counter() - start)
    assert min(seconds) < 0.025


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, "alpha: missing"),
        ({"alpha": -0.1}, "alpha = -0.1: must be a finite number, at least 0"),
        ({"alpha": float("nan")}, "alpha = nan: must be a finite number"),
        ({"alpha": float("inf")}, "alpha = inf: must be a finite number"),
        ({"alpha": 10**400}, "must be a finite number"),
        ({"alpha": "0.5"}, "alpha = '0.5': must be a finite number"),
        ({"alpha": True}, "alpha = True: must be a finite number"),
        ({"alpha": 0.5, "rms_height": 1}, "not both"),
        ({"rms_height": 1}, "correlation_length: missing"),
        ({"alpha": 0.5, "correlation_length": 0}, "above 0"),
        ({"alpha": 0.5, "correlation_length": [1, 2, 3]}, "one number, or two"),
        ({"alpha": 0.5, "samples": 512.5}, "whole number"),
        ({"alpha": 0.5, "samples": 16}, "at least 32"),
        ({"alpha": 0.5, "samples_per_correlation_length": 3}, "do not resolve"),
        ({"alpha": 0.5, "size": 200}, "2.56 samples per correlation length"),
        ({"alpha": 0.5, "samples": 64}, "4 correlation lengths wide"),
        ({"alpha": 0.5, "size": 32, "samples_per_correlation_length": 16}, "not both"),
        ({"alpha": 0.5, "units": "cm"}, "units = 'cm': must be one of 'm', 'mm', 'um', 'nm'"),
        ({"alhpa": 0.5}, "alhpa = 0.5: unknown key .did you mean 'alpha'"),
    ],
)
def test_bad_keys(specimen_of, keys, message):
    with pytest.raises(InputError, match=message) as caught:
        specimen_of("gaussian", **keys)
    assert str(caught.value).startswith("[surface] ")
    assert "\n" not in str(caught.value)
