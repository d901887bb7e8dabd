"""Fresnel's equations against values worked by hand and against their limits."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest

from gonio.core.optics import fresnel_conductor, fresnel_dielectric


def test_normal_incidence_on_glass():
    # ((1.5 - 1)/(1.5 + 1))^2 = 0.04 for both polarisations
    assert fresnel_dielectric(1.0, 1.5) == pytest.approx((0.04, 0.04), abs=1e-15)


def test_brewster_angle():
    r_s, r_p = fresnel_dielectric(math.cos(math.atan(1.5)), 1.5)
    # R_s = ((n^2 - 1)/(n^2 + 1))^2 = (1.25/3.25)^2
    assert r_p == pytest.approx(0.0, abs=1e-30)
    assert r_s == pytest.approx((1.25 / 3.25) ** 2, rel=1e-14)


@pytest.mark.parametrize("degrees", [41.9, 60.0, 89.999, 90.0])
def test_total_internal_reflection_is_exact(degrees):
    # asin(1/1.5) = 41.81 degrees
    assert fresnel_dielectric(math.cos(math.radians(degrees)), 1 / 1.5) == (1.0, 1.0)


@pytest.mark.parametrize("cosine", [0.0, 1e-12, 0.5, 1.0])
def test_equal_indices_reflect_nothing(cosine):
    assert fresnel_dielectric(cosine, 1.0) == (0.0, 0.0)


@pytest.mark.parametrize("cosine", [1e-9, 0.3, 1.0])
@pytest.mark.parametrize("eta", [0.25, 1.0, 1.5, 4.0])
def test_vanishing_absorption_is_the_dielectric(cosine, eta):
    assert fresnel_conductor(cosine, eta, 0.0) == fresnel_dielectric(cosine, eta)
    # the limit is not uniform: at grazing incidence k must be small against cos^2
    k = 1e-12 * cosine**2
    assert fresnel_conductor(cosine, eta, k) == pytest.approx(fresnel_dielectric(cosine, eta), abs=1e-5)


@pytest.mark.parametrize("cosine", [0.01, 0.4, 0.9, 1.0])
@pytest.mark.parametrize(("eta", "k"), [(0.2, 3.9), (1.4, 0.01), (0.25, 10.0), (4.0, 10.0)])
def test_conductor_is_the_complex_formula(cosine, eta, k):
    n = complex(eta, k)
    cos_t = cmath.sqrt(1 - (1 - cosine**2) / n**2)
    r_s = abs((cosine - n * cos_t) / (cosine + n * cos_t)) ** 2
    r_p = abs((n * cosine - cos_t) / (n * cosine + cos_t)) ** 2
    assert fresnel_conductor(cosine, eta, k) == pytest.approx((r_s, r_p), rel=1e-12)


def test_nothing_is_nan_or_beyond_one():
    for cosine in np.linspace(0, 1, 101):
        for eta in (0.01, 0.25, 1.0, 4.0):
            for k in (0.0, 1e-8, 1.0, 10.0):
                for r in fresnel_conductor(cosine, eta, k):
                    assert 0.0 <= r <= 1.0
