"""Fresnel's equations against values worked by hand and against their limits."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest

from gonio.core.optics import (
    fresnel_amplitudes,
    fresnel_conductor,
    fresnel_dielectric,
    fresnel_transmission,
    refract,
    root,
)

ETAS = (0.25, 1 / 1.5, 1.0, 1.5, 4.0)
COSINES = (0.0, 1e-12, 1e-3, 0.3, 0.74, 0.9, 1.0)


def textbook(cosine, n):
    """r_s, r_p and q = n cos(theta_t) straight from the boundary conditions."""
    q = cmath.sqrt(n * n - (1 - cosine**2))
    if q.imag < 0:
        q = -q
    return (cosine - q) / (cosine + q), (n * n * cosine - q) / (n * n * cosine + q), q


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


@pytest.mark.parametrize(
    ("real", "imaginary"), [(2.0, 0.0), (-2.0, 0.0), (3.0, 1e-9), (-3.0, 1e-9), (-1.0, 5.0), (0.0, 2.0)]
)
def test_root_is_the_decaying_one_to_full_precision(real, imaginary):
    a, b = root(real, imaginary)
    expected = cmath.sqrt(complex(real, imaginary))
    # part by part: the small one must not be lost in the large one's rounding
    assert (a, b) == (pytest.approx(expected.real, rel=1e-15), pytest.approx(expected.imag, rel=1e-15))


@pytest.mark.parametrize("k", [0.0, 1e-6, 0.5, 10.0])
@pytest.mark.parametrize("eta", ETAS)
def test_amplitudes_are_those_of_the_reflectances(eta, k):
    for cosine in COSINES:
        r_s, r_p = fresnel_amplitudes(cosine, eta, k)
        assert (abs(r_s) ** 2, abs(r_p) ** 2) == pytest.approx(fresnel_conductor(cosine, eta, k), rel=1e-13)


@pytest.mark.parametrize("n", [0.25, 0.5 + 1e-3j, 1.5, 4 + 0.1j, 0.2 + 3.4j, 4 + 10j])
def test_amplitudes_are_the_complex_formula(n):
    for cosine in (0.01, 0.4, 0.9, 1.0):
        r_s, r_p, _ = textbook(cosine, complex(n))
        assert fresnel_amplitudes(cosine, n.real, n.imag) == pytest.approx((r_s, r_p), rel=1e-13, abs=1e-15)


@pytest.mark.parametrize(("eta", "k"), [(1.5, 0.0), (0.25, 0.0), (0.2, 3.4)])
def test_amplitudes_at_normal_incidence_differ_in_sign_only(eta, k):
    # p = d x s turns round with d: the field itself is reflected alike in s and p
    r_s, r_p = fresnel_amplitudes(1.0, eta, k)
    n = complex(eta, k)
    assert r_s == pytest.approx((1 - n) / (1 + n), rel=1e-15)
    assert r_p == -r_s


def test_amplitude_r_p_changes_sign_at_the_brewster_angle():
    brewster = math.atan(1.5)
    r_p = [fresnel_amplitudes(math.cos(brewster + d), 1.5, 0.0)[1] for d in (-0.01, 0.0, 0.01)]
    assert r_p[0].real > 1e-3
    assert abs(r_p[1]) < 1e-15
    assert r_p[2].real < -1e-3


@pytest.mark.parametrize("degrees", [42.0, 50.0, 60.0, 80.0, 89.99])
def test_phases_of_total_internal_reflection(degrees):
    """Born & Wolf, section 1.5.4, equation 60."""
    theta, n = math.radians(degrees), 1 / 1.5
    evanescent = math.sqrt(math.sin(theta) ** 2 - n * n)
    r_s, r_p = fresnel_amplitudes(math.cos(theta), n, 0.0)
    assert cmath.phase(r_s) == pytest.approx(-2 * math.atan(evanescent / math.cos(theta)), abs=1e-14)
    assert cmath.phase(r_p) == pytest.approx(
        -2 * math.atan(evanescent / (n * n * math.cos(theta))), abs=1e-14
    )


@pytest.mark.parametrize("eta", [0.25, 0.6, 1 / 1.5, 0.99999])
def test_total_internal_reflection_loses_no_amplitude(eta):
    critical = math.sqrt((1 - eta) * (1 + eta))
    for cosine in critical * np.linspace(0, 1, 2001)[:-1]:
        for r in fresnel_amplitudes(cosine, eta, 0.0):
            assert abs(abs(r) - 1) <= 2.3e-16  # 1 ulp


@pytest.mark.parametrize("eta", [0.25, 0.6, 1 / 1.5, 0.99999])
def test_both_sides_of_the_critical_angle_meet(eta):
    cosine = math.sqrt((1 - eta) * (1 + eta))
    for _ in range(20):
        cosine = np.nextafter(cosine, 0.0)
    for _ in range(40):  # some of them land on it exactly, by rounding
        cosine = float(np.nextafter(cosine, 1.0))
        # q is of the order of sqrt(rounding)
        assert fresnel_amplitudes(cosine, eta, 0.0) == pytest.approx((1.0, 1.0), abs=1e-5 / eta**2 / cosine)
        assert fresnel_transmission(cosine, eta) == pytest.approx((0.0, 0.0, 0.0), abs=1e-5 / eta**2 / cosine)


@pytest.mark.parametrize("cosine", [1e-6, 0.2, 0.5, 0.95, 1.0])
@pytest.mark.parametrize("eta", [0.25, 0.8, 1.0, 1.5, 4.0])
def test_amplitudes_of_vanishing_absorption(cosine, eta):
    # beyond the critical angle (eta < 1) this is where a wrong branch of the root shows
    assert fresnel_amplitudes(cosine, eta, 1e-14 * cosine**2) == pytest.approx(
        fresnel_amplitudes(cosine, eta, 0.0), abs=1e-6
    )


@pytest.mark.parametrize("k", [0.0, 1e-300, 1e-12, 10.0])
@pytest.mark.parametrize("eta", [1e-3, 0.25, 1.0, 4.0])
def test_amplitudes_are_never_nan_nor_beyond_one(eta, k):
    for cosine in (0.0, 1e-30, 1e-8, *np.linspace(0, 1, 101)):
        for r in fresnel_amplitudes(cosine, eta, k):
            assert abs(r) <= 1 + 1e-15
    grazing = (0.0, 0.0) if (eta, k) == (1.0, 0.0) else (-1.0, -1.0)
    assert fresnel_amplitudes(0.0, eta, k) == grazing
    assert fresnel_conductor(0.0, eta, k) == tuple(r * r for r in grazing)


@pytest.mark.parametrize("cosine", [0.0, 1e-9, 0.2, 0.7, 0.75, 0.99, 1.0])
@pytest.mark.parametrize("eta", ETAS)
def test_an_interface_keeps_the_energy(cosine, eta):
    t_s, t_p, cross = fresnel_transmission(cosine, eta)
    r_s, r_p = fresnel_dielectric(cosine, eta)
    assert (t_s + r_s, t_p + r_p) == pytest.approx((1.0, 1.0), abs=4e-16)
    assert cross == pytest.approx(math.sqrt(t_s * t_p), rel=1e-15)


@pytest.mark.parametrize(
    ("cosine", "eta"), [(0.01, 1.5), (0.6, 1.5), (1.0, 4.0), (0.8, 1 / 1.5), (0.99, 0.25)]
)
def test_transmittance_is_that_of_the_amplitudes(cosine, eta):
    r_s, r_p, q = textbook(cosine, eta)
    # continuity of the tangential fields: 1 + r_s = t_s of E, 1 + r_p = eta t_p of H
    t_s, t_p = 1 + r_s.real, (1 + r_p.real) / eta
    power = q.real / cosine
    expected = power * t_s**2, power * t_p**2, power * t_s * t_p
    assert fresnel_transmission(cosine, eta) == pytest.approx(expected, rel=1e-12)


def _tilted(theta, azimuth, n):
    """A direction of propagation at angle theta to -n."""
    s = np.cross(n, [0.3, -0.5, 0.2])
    s /= np.linalg.norm(s)
    t = np.cross(n, s)
    return math.sin(theta) * (math.cos(azimuth) * s + math.sin(azimuth) * t) - math.cos(theta) * n


@pytest.mark.parametrize("eta", ETAS)
@pytest.mark.parametrize("degrees", [0.0, 1e-6, 10.0, 41.0, 75.0, 89.9, 90.0])
def test_refraction_obeys_snell_and_turns_back(degrees, eta):
    n = np.array([2.0, -1.0, 2.0]) / 3
    theta = math.radians(degrees)
    d = _tilted(theta, 0.7, n)
    out, cos_t = refract(tuple(d), tuple(n), eta)
    if math.sin(theta) > eta:
        assert (out, cos_t) == ((0.0, 0.0, 0.0), 0.0)
        assert fresnel_dielectric(math.cos(theta), eta) == (1.0, 1.0)
        return
    # the component along the surface, times the index, goes through: sin and plane of incidence at once
    assert eta * np.cross(out, n) == pytest.approx(np.cross(d, n), abs=1e-14)
    assert np.linalg.norm(out) == pytest.approx(1.0, abs=4e-16)
    assert -np.dot(out, n) == pytest.approx(cos_t, abs=1e-14)
    assert math.sqrt(1 - (math.sin(theta) / eta) ** 2) == pytest.approx(cos_t, rel=1e-11)
    if degrees < 90.0:
        back, _ = refract(tuple(-np.array(out)), tuple(-n), 1 / eta)
        assert back == pytest.approx(tuple(-d), abs=1e-12)


def test_refraction_keeps_unit_length_of_single_precision_directions():
    n = np.array([0.6, 0.0, 0.8], np.float32)
    d = _tilted(0.2, 0.7, n.astype(float)).astype(np.float32) * np.float32(1 + 1e-6)
    out, _ = refract(tuple(map(float, d)), tuple(map(float, n)), 0.25)
    assert np.linalg.norm(out) == pytest.approx(1.0, abs=4e-16)
