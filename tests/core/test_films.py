"""Thin films against the tmm package, textbook limits and the conservation of energy."""

from __future__ import annotations

import math

import numpy as np
import pytest
import tmm

from gonio.core.films import film_amplitudes
from gonio.core.optics import fresnel_amplitudes, fresnel_transmission

GREEN = 550e-9
NO_FILMS = np.empty((0, 2)), np.empty(0)


def stack(*films):
    """Arrays (indices, thicknesses) of films given as (n, k, nanometres)."""
    films = np.array(films, float)
    return np.ascontiguousarray(films[:, :2]), films[:, 2] * 1e-9


def referee(cosine, n_above, films, thicknesses, n_below, k_below, wavelength):
    """What `film_amplitudes` returns, by tmm (S. Byrnes, arXiv 1603.02720)."""
    indices = [n_above, *(films @ [1, 1j]), complex(n_below, k_below)]
    depths = [np.inf, *thicknesses, np.inf]
    theta = math.acos(cosine)
    s, p = (tmm.coh_tmm(which, indices, depths, theta, wavelength) for which in "sp")
    q = np.sqrt(complex(n_below**2 - (n_above * math.sin(theta)) ** 2)).real
    return s["r"], p["r"], s["T"], p["T"], s["t"] * p["t"].conjugate() * q / (n_above * cosine)


def random_stack(rng, count, absorbing):
    n = rng.uniform(0.3, 4.0, count)
    k = rng.uniform(0.0, 4.0, count) * absorbing * rng.integers(0, 2, count)
    return np.column_stack([n, k]), rng.uniform(0.0, 300e-9, count)


@pytest.mark.parametrize("substrate_absorbs", [False, True])
@pytest.mark.parametrize("films_absorb", [False, True])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6])
def test_agrees_with_tmm(count, films_absorb, substrate_absorbs):
    rng = np.random.default_rng([count, films_absorb, substrate_absorbs])
    for n_above in (1.0, 1.5):
        for degrees in (0.0, 30.0, 45.0, 60.0, 75.0, 89.0, 89.9):
            films, thicknesses = random_stack(rng, count, films_absorb)
            n_below, k_below = rng.uniform(0.5, 4.0), rng.uniform(0.1, 5.0) * substrate_absorbs
            case = math.cos(math.radians(degrees)), n_above, films, thicknesses, n_below, k_below, GREEN
            values, expected = film_amplitudes(*case), referee(*case)
            assert values[:4] == pytest.approx(expected[:4], abs=1e-11), case
            if not substrate_absorbs:
                assert values[4] == pytest.approx(expected[4], abs=1e-11), case


@pytest.mark.parametrize("films", [NO_FILMS, stack((2.1, 0.3, 0.0)), stack((1.2, 0.0, 0.0), (0.2, 4.0, 0.0))])
@pytest.mark.parametrize("n_above", [1.0, 1.5])
@pytest.mark.parametrize("cosine", [0.0, 1e-8, 0.3, 0.6, 1.0])
@pytest.mark.parametrize(("n", "k"), [(1.33, 0.0), (1.0, 0.0), (1.5, 0.0), (0.2, 3.4)])
def test_no_thickness_is_the_bare_interface(n, k, cosine, n_above, films):
    r_s, r_p, t_s, t_p, cross = film_amplitudes(cosine, n_above, *films, n, k, GREEN)
    assert (r_s, r_p) == pytest.approx(fresnel_amplitudes(cosine, n / n_above, k / n_above), abs=1e-12)
    if k == 0.0:
        assert (t_s, t_p, cross) == pytest.approx(fresnel_transmission(cosine, n / n_above), abs=1e-12)


def test_a_film_thins_out_continuously():
    bare = film_amplitudes(0.7, 1.0, *NO_FILMS, 1.5, 0.0, GREEN)
    for nanometres in (1e-3, 1e-5, 1e-7):
        # the phase of 2 q d, q below 3, at 550 nm
        close = 2 * 2 * math.pi * 3.0 * nanometres / 550
        thin = film_amplitudes(0.7, 1.0, *stack((2.5, 1.0, nanometres)), 1.5, 0.0, GREEN)
        assert thin == pytest.approx(bare, abs=close)
        assert thin[0] != bare[0]


def test_quarter_wave_coating_of_index_root_n_reflects_nothing():
    r_s, r_p, t_s, t_p, cross = film_amplitudes(1.0, 1.0, *stack((1.5, 0.0, 550 / 6)), 2.25, 0.0, GREEN)
    assert (abs(r_s), abs(r_p)) == pytest.approx((0.0, 0.0), abs=1e-15)
    assert (t_s, t_p, cross) == pytest.approx((1.0, 1.0, 1.0), abs=1e-15)


@pytest.mark.parametrize("cosine", [0.2, 0.6, 1.0])
def test_mean_over_the_thickness_is_the_incoherent_slab(cosine):
    """R = R1 + T1^2 R2 / (1 - R1 R2), T = T1 T2 / (1 - R1 R2): energies of all internal reflections, summed."""
    n_film, n_below, steps = 1.8, 1.4, 64
    cos_film = math.sqrt(1 - (1 - cosine**2) / n_film**2)
    period = GREEN / (2 * n_film * cos_film)
    sums = np.zeros(4)
    for step in range(steps):  # equal steps over one period: exact for a periodic analytic function
        d = np.array([1e-4 + step / steps * period])
        r_s, r_p, t_s, t_p, _ = film_amplitudes(
            cosine, 1.0, np.array([[n_film, 0.0]]), d, n_below, 0.0, GREEN
        )
        sums += [abs(r_s) ** 2, abs(r_p) ** 2, t_s, t_p]
    for polarisation in (0, 1):
        t1 = fresnel_transmission(cosine, n_film)[polarisation]
        t2 = fresnel_transmission(cos_film, n_below / n_film)[polarisation]
        closed = 1 - (1 - t1) * (1 - t2)
        expected = 1 - t1 + t1 * t1 * (1 - t2) / closed, t1 * t2 / closed
        # the phase of a 0.1 mm film is 2000 rad, good to 1e-12 or so
        assert sums[polarisation::2] / steps == pytest.approx(expected, abs=1e-10)


def test_a_weakly_absorbing_slab_follows_beer_and_lambert():
    """A film matched in index on both sides: nothing interferes, T = exp(-4 pi k d / (wavelength cos theta))."""
    k, d, cosine = 1e-7, 1e-2, 0.6
    *_, t_s, t_p, _ = film_amplitudes(cosine, 1.5, np.array([[1.5, k]]), np.array([d]), 1.5, 0.0, GREEN)
    expected = math.exp(-4 * math.pi * k * d / (GREEN * cosine))
    assert (t_s, t_p) == pytest.approx((expected, expected), rel=1e-6)


@pytest.mark.parametrize("nanometres", [10.0, 100.0, 1000.0, 20000.0])
def test_frustrated_total_internal_reflection(nanometres):
    """An air gap in glass at 60 degrees: T = 1 / (1 + ((a^2 + b^2) / (2 a b))^2 sinh^2(kappa d)).

    a and b are the admittances n cos theta of glass and gap, over n^2 each for p.
    """
    n, sine = 1.5, math.sqrt(0.75)
    a, b = n * 0.5, math.sqrt((n * sine) ** 2 - 1)
    kappa_d = 2 * math.pi / 550 * nanometres * b
    values = film_amplitudes(0.5, n, *stack((1.0, 0.0, nanometres)), n, 0.0, GREEN)
    for transmitted, (x, y) in zip(values[2:4], [(a, b), (a / n**2, b)], strict=True):
        ratio = (x * x + y * y) / (2 * x * y)
        expected = 1 / (1 + (ratio * math.sinh(kappa_d)) ** 2)
        assert transmitted == pytest.approx(expected, rel=1e-10)


def test_a_millimetre_of_gold_is_bulk_gold():
    gold = 0.35, 2.7
    for cosine in (0.0, 0.01, 0.5, 1.0):
        values = film_amplitudes(cosine, 1.0, *stack((*gold, 1e6)), 1.5, 0.0, GREEN)
        assert values[:2] == pytest.approx(fresnel_amplitudes(cosine, *gold), abs=1e-14)
        assert values[2:] == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("pairs", [10, 50])
def test_bragg_mirror(pairs):
    """Quarter waves of n1, n2: the stack's admittance is (n1/n2)^(2 pairs) n_below (Born & Wolf, equation 1.6.97)."""
    high, low, below = 2.3, 1.38, 1.52
    films = stack(*[(high, 0.0, 550 / 4 / high), (low, 0.0, 550 / 4 / low)] * pairs)
    r_s, r_p, t_s, t_p, _ = film_amplitudes(1.0, 1.0, *films, below, 0.0, GREEN)
    admittance = (high / low) ** (2 * pairs) * below
    assert r_s == pytest.approx((1 - admittance) / (1 + admittance), abs=1e-13)
    assert r_p == pytest.approx(-r_s, abs=1e-13)
    expected = 4 * admittance / (1 + admittance) ** 2
    assert (t_s, t_p) == pytest.approx((expected, expected), rel=1e-10)


def test_a_monstrous_mirror_does_not_overflow():
    # 16^400 = 1e481 between the fields at its two ends
    films = stack(*[(4.0, 0.0, 550 / 16), (0.25, 0.0, 550.0)] * 400)
    values = film_amplitudes(1.0, 1.0, *films, 1.5, 0.0, GREEN)
    assert values[:2] == pytest.approx((-1.0, 1.0), abs=1e-12)
    assert values[2:] == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("nanometres", [1.0, 300.0, 1e5])
def test_light_that_just_grazes_inside_a_film(nanometres):
    """At the critical angle of a film its wave neither runs nor decays: the limit from both sides, and finite."""
    # 0.75^2 - 1.25^2 + (1.25 cos)^2 = 0, exactly so in double precision
    n_above, n_film, cosine = 1.25, 0.75, 0.8
    films = stack((n_film, 0.0, nanometres))
    at = film_amplitudes(cosine, n_above, *films, n_above, 0.0, GREEN)
    # E of s and H of p are linear in depth: with q = n cos theta = 1 outside, t_s = 1 / (1 - i k0 d q / 2)
    # and t_p the same with (n_film / n_above)^2 q
    for transmitted, q in zip(at[2:4], (1.0, 0.6**2), strict=True):
        assert transmitted == pytest.approx(1 / (1 + (math.pi * nanometres / 550 * q) ** 2), rel=1e-13)
    for shift in (-1e-15, 1e-15):
        assert film_amplitudes(cosine + shift, n_above, *films, n_above, 0.0, GREEN) == pytest.approx(
            at, abs=1e-5
        )
    thinnest = film_amplitudes(1.0, 1.0, *stack((1.0, 0.0, nanometres)), 1.0, 0.0, GREEN)
    assert thinnest[:4] == pytest.approx((0.0, 0.0, 1.0, 1.0), abs=1e-12)


def test_total_reflection_at_the_substrate_leaves_nothing_below():
    # glass above, sin 60 x 1.5 = 1.3 > 1.2
    r_s, r_p, t_s, t_p, cross = film_amplitudes(0.5, 1.5, *stack((2.2, 0.0, 130.0)), 1.2, 0.0, GREEN)
    assert (abs(r_s), abs(r_p)) == pytest.approx((1.0, 1.0), abs=1e-15)
    assert (t_s, t_p, cross) == (0.0, 0.0, 0.0)


def test_seen_from_below_the_transmittance_is_the_same():
    """Stokes' reversibility: T is one number for both senses of a path, absorbing films too."""
    films, thicknesses = stack((1.38, 0.0, 100.0), (0.05, 3.5, 20.0), (2.3, 0.1, 60.0))
    cosine = 0.6
    cos_below = math.sqrt(1 - (1 - cosine**2) / 1.5**2)
    down = film_amplitudes(cosine, 1.0, films, thicknesses, 1.5, 0.0, GREEN)
    up = film_amplitudes(cos_below, 1.5, films[::-1].copy(), thicknesses[::-1].copy(), 1.0, 0.0, GREEN)
    assert up[2:] == pytest.approx(down[2:], rel=1e-12)
    assert abs(up[0]) != pytest.approx(abs(down[0]), rel=1e-3)


def test_cross_is_the_product_of_the_two_intensities():
    rng = np.random.default_rng(7)
    for _ in range(200):
        films, thicknesses = random_stack(rng, 3, True)
        *_, t_s, t_p, cross = film_amplitudes(rng.uniform(), 1.5, films, thicknesses, 1.7, 0.0, GREEN)
        assert abs(cross) ** 2 == pytest.approx(t_s * t_p, rel=1e-12)


@pytest.mark.parametrize("absorbing", [False, True])
def test_energy_over_random_stacks(absorbing):
    rng = np.random.default_rng(11 + absorbing)
    for _ in range(3000):
        films, thicknesses = random_stack(rng, rng.integers(1, 8), absorbing)
        thicknesses *= 10.0 ** rng.uniform(-4, 4)
        films[:, 1] *= 10.0 ** rng.uniform(-12, 0.5)
        cosine = rng.choice([rng.uniform(), 10.0 ** rng.uniform(-20, 0), 0.0, 1.0])
        case = cosine, rng.choice([1.0, 1.5, 4.0]), films, thicknesses, rng.uniform(0.25, 4.0), 0.0, GREEN
        r_s, r_p, t_s, t_p, cross = film_amplitudes(*case)
        for reflected, transmitted in ((abs(r_s) ** 2, t_s), (abs(r_p) ** 2, t_p)):
            assert 0.0 <= reflected <= 1 + 1e-12, case
            assert 0.0 <= transmitted <= 1 + 1e-12, case
            assert reflected + transmitted <= 1 + 1e-12, case
            if not absorbing:
                assert reflected + transmitted == pytest.approx(1.0, abs=1e-12), case
        assert abs(cross) <= 1 + 1e-12, case
