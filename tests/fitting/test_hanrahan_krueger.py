"""Single scattering in a layer: Lommel and Seeliger's law, the integral over depth, the base by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import integrate

from gonio.core.optics import fresnel_dielectric

from .kit import albedo
from .materials import polar, terms

PI = math.pi


def test_lommel_seeliger() -> None:
    # matched, infinitely deep, isotropic: 1/(4 pi (mu + mu0))
    for a, b in ((0.0, 0.0), (60.0, 30.0), (85.0, 80.0)):
        found = terms("hanrahan_krueger", polar(a), polar(b, 40.0), tau=100.0, g=0.0, eta=1.0)
        mu = math.cos(math.radians(a)) + math.cos(math.radians(b))
        assert found == pytest.approx((1 / (4 * PI * mu), 0.0), rel=1e-12, abs=1e-40)


def test_phase_function_sees_the_angle_between_the_paths() -> None:
    # retro-reflection turns the light by 180 degrees: p = (1 - g^2)/(4 pi (1 + g)^3), here 0.75/(4 pi 3.375)
    found = terms("hanrahan_krueger", polar(0.0), polar(0.0), tau=100.0, g=0.5, eta=1.0)[0]
    assert found == pytest.approx(0.75 / (4 * PI * 3.375) / 2, rel=1e-12)
    forward = terms("hanrahan_krueger", polar(89.0), polar(89.0, 180.0), tau=100.0, g=0.5, eta=1.0)[0]
    assert forward > 10 * terms("hanrahan_krueger", polar(89.0), polar(89.0), tau=100.0, g=0.5, eta=1.0)[0]


@pytest.mark.parametrize("tau", [0.1, 3.0])
def test_layer_is_the_integral_over_depth(tau: float) -> None:
    n, g = 1.4, 0.4
    wi, wo = polar(50.0, 10.0), polar(35.0, 130.0)
    inside_i, inside_o = (np.array([w[0] / n, w[1] / n, 0.0]) for w in (wi, wo))
    inside_i[2], inside_o[2] = (math.sqrt(1.0 - v @ v) for v in (inside_i, inside_o))
    cosine = -inside_i @ inside_o
    phase = (1 - g * g) / (4 * PI * (1 + g * g - 2 * g * cosine) ** 1.5)
    through = [1.0 - 0.5 * sum(fresnel_dielectric(w[2], n)) for w in (wi, wo)]

    def slice_at(depth: float) -> float:
        """Radiance inside from a slice, for unit irradiance on the surface: scattered, then dimmed."""
        arriving = through[0] * math.exp(-depth / inside_i[2]) / inside_i[2]
        return arriving * phase * math.exp(-depth / inside_o[2]) / inside_o[2]

    radiance = integrate.quad(slice_at, 0.0, tau)[0] * through[1] / n**2  # it spreads on leaving
    found = terms("hanrahan_krueger", wi, wo, tau=tau, g=g, eta=n)[0]
    assert found == pytest.approx(radiance, rel=1e-9)


def test_base_under_the_layer() -> None:
    # along the normal, n = 1.5: T = 0.96 twice, exp(-2 tau), radiance over n^2
    found = terms("hanrahan_krueger", polar(0.0), polar(0.0), tau=0.3, g=0.0, eta=1.5)[1]
    assert found == pytest.approx(0.96**2 / 2.25 * math.exp(-0.6) / PI, rel=1e-12)


@pytest.mark.compiled
def test_half_space_reflects_what_lommel_seeliger_integrates_to() -> None:
    # int_0^1 2 pi mu/(4 pi (mu + mu0)) dmu = (1 - mu0 ln(1 + 1/mu0))/2
    for mu0 in (1.0, 0.5):
        expected = 0.5 * (1 - mu0 * math.log(1 + 1 / mu0))
        angle = math.degrees(math.acos(mu0))
        shape = {"tau": 100.0, "g": 0.0, "eta": 1.0}
        assert albedo("hanrahan_krueger", shape, angle) == pytest.approx(expected, rel=1e-5)
