"""Smooth light from blocks to cells."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gonio.trace.remainder import block_size, spread

THETA = np.radians(np.arange(0, 90.1, 3.0))
PHI = np.radians(np.arange(0, 180.1, 6.0))
FINE = np.radians(np.arange(0.5, 90))
FINE_PHI = np.radians(np.arange(0.5, 180))


def smooth(theta_i, theta_r, delta_phi):
    """A reciprocal function of two directions without a seam at the poles, as wide as light after two bounces."""
    ci, cr = np.cos(theta_i), np.cos(theta_r)
    cos = ci * cr + np.sin(theta_i) * np.sin(theta_r) * np.cos(delta_phi)
    return 0.05 * np.exp(0.8 * cos) * (1.5 - ci) * (1.5 - cr)


def mesh(theta_i, theta_r, delta_phi):
    return np.meshgrid(theta_i, theta_r, delta_phi, indexing="ij")


def block_averages():
    """Averages over projected solid angle, by 6 points along each axis of a block."""
    points = (np.arange(6) + 0.5) / 6
    theta = (THETA[:-1, None] + np.diff(THETA)[:, None] * points).ravel()
    phi = (PHI[:-1, None] + np.diff(PHI)[:, None] * points).ravel()
    weight = np.sin(2 * theta)
    f = smooth(*mesh(theta, theta, phi)) * weight[:, None, None] * weight[None, :, None]
    n, p = len(THETA) - 1, len(PHI) - 1
    sums = f.reshape(n, 6, n, 6, p, 6).sum((1, 3, 5))
    norm = weight.reshape(n, 6).sum(1)
    return (sums / (norm[:, None, None] * norm[None, :, None] * 6))[..., None]


def test_smooth_light_comes_through_to_a_hundredth():
    blocks = block_averages()
    values, _ = spread(blocks, np.zeros_like(blocks), THETA, PHI, FINE, FINE_PHI, FINE)
    expected = smooth(*mesh(FINE, FINE, FINE_PHI))
    error = values[..., 0] / expected - 1
    assert np.abs(error).max() < 0.02
    assert math.sqrt(np.mean(error**2)) < 2e-3


def test_exact_rows_stay_rows():
    blocks = block_averages()[[5, 20]]
    values, _ = spread(blocks, np.zeros_like(blocks), THETA, PHI, FINE, FINE_PHI, None)
    assert values.shape == (2, 90, 180, 1)
    expected = smooth(*mesh(np.radians([16.5, 61.5]), FINE, FINE_PHI))
    assert values[..., 0] == pytest.approx(expected, rel=0.03)


def test_error_bars_are_those_of_noisy_blocks():
    rng = np.random.default_rng(1)
    shape = (len(THETA) - 1, len(THETA) - 1, len(PHI) - 1, 1)
    sigma = 0.01 * (1 + np.arange(shape[1])[:, None, None] / shape[1]) * np.ones(shape)
    runs = []
    for _ in range(30):
        values, error = spread(
            1 + sigma * rng.standard_normal(shape), sigma**2, THETA, PHI, FINE[::6], FINE_PHI[::9], FINE[::6]
        )
        runs.append(values)
    scatter = np.var(runs, axis=0, ddof=1)
    # pairs (i, o) with i = o are averaged with themselves
    assert np.mean(scatter / error**2) == pytest.approx(1, abs=0.1)


def test_blocks_shrink_with_roughness_and_are_whole_cells():
    assert block_size(1.0, 90, 180) == (3, 6)
    assert block_size(0.5, 90, 180) == (2, 3)
    assert block_size(0.2, 90, 180) == (1, 1)
    assert block_size(1.0, 18, 18) == (1, 1)
    assert block_size(1.0, 40, 80) == (1, 2)
