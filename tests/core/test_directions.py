"""Frames, warps and solid angles."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gonio.core.directions import (
    cos_delta_phi,
    cosine_hemisphere,
    direction,
    frame,
    half_vector,
    projected_solid_angles,
)  # fmt: skip
from gonio.core.lookup import axis, find


@pytest.mark.parametrize("n", [(0, 0, 1), (0, 0, -1), (0.6, 0, 0.8), (0.48, -0.6, -0.64), (1, 0, 0)])
def test_frame_is_right_handed_and_orthonormal(n):
    n = tuple(map(float, n))
    s, t = frame(n)
    matrix = np.array([s, t, n])
    assert matrix @ matrix.T == pytest.approx(np.eye(3), abs=1e-15)
    assert np.linalg.det(matrix) == pytest.approx(1.0)


def test_cosine_hemisphere_moments():
    u = (np.arange(100) + 0.5) / 100
    z = np.array([cosine_hemisphere(a, b)[2] for a in u for b in u])
    # E[cos] = 2/3 and E[cos^2] = 1/2 for density cos/pi; the midpoint rule is good to 1e-4
    assert z.mean() == pytest.approx(2 / 3, abs=1e-3)
    assert (z**2).mean() == pytest.approx(0.5, abs=1e-4)


def test_delta_phi_is_zero_at_retro_reflection():
    wi = direction(0.5, 1.0)
    assert cos_delta_phi(wi, direction(0.9, 1.0)) == pytest.approx(1.0)
    assert cos_delta_phi(wi, direction(0.9, 1.0 + math.pi)) == pytest.approx(-1.0)
    assert cos_delta_phi(wi, (0.0, 0.0, 1.0)) == 1.0


def test_half_vector():
    assert half_vector((0.6, 0.0, 0.8), (-0.6, 0.0, 0.8)) == pytest.approx((0, 0, 1))
    assert half_vector((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)) == (0.0, 0.0, 1.0)


def test_projected_solid_angles_sum_to_pi():
    omega = projected_solid_angles(np.radians(np.arange(91)), np.radians(np.arange(181)))
    assert omega.shape == (90, 180)
    assert omega.sum() == pytest.approx(math.pi, rel=1e-14)
    # one cell, both signs of delta phi: (sin^2 46 - sin^2 45) x 1 degree
    expected = (math.sin(math.radians(46)) ** 2 - 0.5) * math.radians(1)
    assert omega[45, 7] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("edges", [np.linspace(-1, 2, 7), np.array([0.0, 1e-9, 0.5, 0.500001, 1.0]),
                                   -np.cos(np.radians(np.arange(181)))])  # fmt: skip
def test_find_agrees_with_searchsorted(edges):
    prepared = axis(edges)
    x = np.concatenate([np.random.default_rng(1).uniform(edges[0], edges[-1], 500), edges, edges[1:] - 1e-13])
    expected = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    assert [find(prepared, v) for v in x] == expected.tolist()
    assert find(prepared, edges[0] - 5) == 0
    assert find(prepared, edges[-1] + 5) == len(edges) - 2
