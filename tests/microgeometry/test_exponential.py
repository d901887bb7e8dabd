import numpy as np
import pytest

from microgeometry.errors import InputError
from tests.microgeometry.conftest import z_score


@pytest.mark.parametrize(("alpha", "samples", "per_length"), [(0.5, 128, 4), (0.2, 129, 8.1)])
def test_expected_alpha_of_the_mesh_is_the_one_asked_for(specimen_of, alpha, samples, per_length):
    surface = specimen_of(
        "exponential", alpha=alpha, samples=samples, samples_per_correlation_length=per_length
    ).surface
    squares = [surface.realise(seed).statistics().alpha ** 2 for seed in range(20)]
    z, relative = z_score(squares, alpha**2)
    assert z < 4
    assert relative < 0.005


@pytest.mark.parametrize("per_length", [4, 16])
def test_slope_depends_on_the_sampling_as_documented(specimen_of, per_length):
    # alpha^2 = 4 rms^2 (1 - e^{-d}) / d^2 with d = dx / l. The mesh's rms height is that of facets, flatter
    # than the samples, and lacks the tile's mean: both are measured here, on the samples.
    surface = specimen_of(
        "exponential",
        rms_height=0.1,
        correlation_length=1,
        samples=256,
        samples_per_correlation_length=per_length,
    ).surface
    d = 1 / per_length
    differences, squares, rms = [], [], []
    for seed in range(20):
        tile = surface.realise(seed)
        squares.append(tile.statistics().rms_height ** 2)
        # Variance of the samples with their mean: periodic integral of rho, 2 pi l^2 / L^2 (L >= 16 l).
        variance = np.mean(tile.heights**2) / (1 - 2 * np.pi * (per_length / 256) ** 2)
        rms.append(variance)
        differences.append(tile.statistics().alpha ** 2 - 4e12 * variance * (1 - np.exp(-d)) / d**2)
    assert z_score(squares, 1e-14)[0] < 4
    errors = np.array(differences)
    std_error = errors.std(ddof=1) / np.sqrt(20)
    expected = 4e12 * np.mean(rms) * (1 - np.exp(-d)) / d**2
    assert std_error / expected < 0.1
    assert abs(errors.mean()) < 4 * std_error


@pytest.mark.parametrize("axis", [0, 1])
def test_autocorrelation_is_exponential_along_both_axes(specimen_of, axis):
    # C(r) = s^2 (e^{-r/l} - m), m the share of the tile's mean; L = 32 l, so m = 2 pi / 32^2, up to the
    # sum of the correlation in place of its integral (8e-4 of it). At a lag of l/2 and l, l stretched on y.
    keys = {"correlation_length": [1, 2], "samples": 256, "samples_per_correlation_length": 8}
    surface = specimen_of("exponential", alpha=0.5, **keys).surface
    mean = 2 * np.pi / 32**2
    for lag in (4, 8):
        expected = (np.exp(-lag / 8) - mean) / (1 - mean)
        differences = []
        for seed in range(40):
            h = surface.realise(seed).heights * 1e6
            differences.append(np.mean(h * np.roll(h, lag, axis)) - expected * np.mean(h * h))
        std_error = np.std(differences, ddof=1) / np.sqrt(40)
        assert std_error / np.mean(h * h) < 0.02
        assert abs(np.mean(differences)) < 4 * std_error


@pytest.mark.parametrize("lengths", [[2, 2], [2, 5]])
def test_correlation_lengths_are_reported(specimen_of, lengths):
    # About the tile's mean, which is a share m of the variance (L = 16 l), the autocorrelation is
    # (rho - m) / (1 - m): 1/e where rho = (1 - m)/e + m, a little short of l. The mean of 40 is good to 2 %.
    keys = {"alpha": 0.5, "correlation_length": lengths, "samples": 256}
    surface = specimen_of("exponential", **keys).surface
    mean = 2 * np.pi / 16**2
    part = (1 - mean) / np.e + mean
    stats = [surface.realise(seed).statistics() for seed in range(40)]
    for axis, length in zip("xy", lengths, strict=True):
        measured = [getattr(s, f"correlation_length_{axis}") for s in stats]
        z, relative = z_score(measured, length * 1e-6 * -np.log(part))
        assert z < 4
        assert relative < 0.03


def test_spectrum_loses_nothing_to_rounding(specimen_of):
    # The transform of a correlation is positive: a negative mode would be cut off, and change the rest.
    for samples, per_length in ((128, 16), (512, 16), (256, 4)):
        keys = {"samples": samples, "samples_per_correlation_length": per_length}
        filter_ = specimen_of("exponential", alpha=1, **keys).surface._filter
        assert filter_.min() > 1e-4 * filter_.max()


def test_seed_is_the_realisation(specimen_of):
    surface = specimen_of("exponential", alpha=0.5, samples=64, samples_per_correlation_length=4).surface
    first, again, other = surface.realise(7), surface.realise(7), surface.realise(8)
    assert first.heights.tobytes() == again.heights.tobytes()
    assert abs(np.corrcoef(first.heights.ravel(), other.heights.ravel())[0, 1]) < 0.5


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, "alpha: missing"),
        ({"rms_height": 1}, "correlation_length: missing"),
        ({"alpha": 0.5, "samples_per_correlation_length": 3}, "do not resolve"),
        ({"alpha": 0.5, "hurst": 0.5}, "hurst = 0.5: unknown key"),
    ],
)
def test_bad_keys(specimen_of, keys, message):
    with pytest.raises(InputError, match=message):
        specimen_of("exponential", **keys)
