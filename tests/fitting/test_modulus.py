"""The mean curvature of a modulus, against integrals worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from fitting.modulus import mean_curvature


def test_of_a_narrow_rounding_it_is_twice_the_density_at_zero() -> None:
    # brightness and scatter go together, as measurements do: sigma = brightness/10, density 1/(sigma sqrt(2 pi))
    rng = np.random.default_rng(4)
    brightness = np.exp(rng.uniform(-3.0, 3.0, (20_000, 3)))
    sigma = 0.1 * brightness
    found = mean_curvature(brightness, sigma * rng.standard_normal(sigma.shape), 1e-6)
    ratio = found * sigma * np.sqrt(2.0 * np.pi) / 2.0
    # smoothing over a fifth of sigma lowers a density by 2 %; 50 groups of 1200 values are known to 5 % each, the
    # brightest, of 100, to 18 %
    assert ratio.mean() == pytest.approx(1.0 / np.sqrt(1.04), abs=4 * 0.05 / np.sqrt(50))
    brightest = ratio.ravel()[np.argsort(brightness, axis=None)[-500:]]
    assert brightest.mean() == pytest.approx(1.0 / np.sqrt(1.04), abs=4 * 0.08)
    assert ratio.std() < 0.15


@pytest.mark.parametrize("d", [0.0, 1e-3, 1.0])
def test_of_a_wide_rounding_it_is_that_of_the_values(d: float) -> None:
    # all values d, d = 0 or below the rounding s = 10: s^2/(d^2 + s^2)^(3/2)
    found = mean_curvature(np.ones(100), np.full(100, d), 10.0)
    assert found == pytest.approx(100.0 / (d**2 + 100.0) ** 1.5)


def test_rounding_and_scatter_of_one_size() -> None:
    # k is s^2/(d^2 + s^2)^(3/2); its mean over a Gaussian of the same size, by quadrature
    d, step = np.linspace(-12.0, 12.0, 200_001, retstep=True)
    expected = step * np.sum(np.exp(-0.5 * d**2) / np.sqrt(2.0 * np.pi) / (d**2 + 1.0) ** 1.5)
    rng = np.random.default_rng(5)
    assert mean_curvature(np.ones(500), rng.standard_normal(500), 1.0)[0] == pytest.approx(expected, rel=0.1)
    many = mean_curvature(np.ones(100_000), rng.standard_normal(100_000), 0.19)
    expected = step * np.sum(np.exp(-0.5 * d**2) / np.sqrt(2.0 * np.pi) * 0.19**2 / (d**2 + 0.19**2) ** 1.5)
    # groups of 2000 to 4 % each, and smoothed over 0.2: the density at 0 falls by 2 %
    assert many.mean() == pytest.approx(expected, rel=0.04)
