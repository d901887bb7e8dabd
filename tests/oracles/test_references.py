"""The reference solutions against published numbers, limits, and each other."""

from __future__ import annotations

import math
from math import radians

import numpy as np
import pytest

from tests.oracles import cavities, fresnel, grooves, half_space, planar
from tests.oracles.films import film_stack

GOLD = 0.18 + 3.4j
METAL = grooves.Walls(GOLD)


# --- interfaces ---


def test_total_reflection_is_exact_and_changes_the_phase():
    r = fresnel.amplitudes(math.cos(radians(50)), 1.5, 1.0)
    assert np.abs(r) == pytest.approx([1.0, 1.0], abs=1e-15)
    # Born & Wolf (4th ed.), eq. 1.5.60: at n = 1/1.51, s and p differ by 45 degrees at 54 37'
    r_s, r_p = fresnel.amplitudes(math.cos(radians(54 + 37 / 60)), 1.51, 1.0)
    assert abs(math.degrees(np.angle(r_p / r_s))) == pytest.approx(45.0, abs=0.1)


def test_brewster_normal_and_metal():
    assert fresnel.reflectance(math.cos(math.atan(1.5)), 1.0, 1.5)[1] == pytest.approx(0, abs=1e-15)
    assert fresnel.reflectance(1.0, 1.0, 1.5) == pytest.approx([0.04, 0.04])
    n, k = GOLD.real, GOLD.imag
    expected = ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2)
    assert fresnel.reflectance(1.0, 1.0, GOLD) == pytest.approx([expected] * 2)
    assert fresnel.reflectance(0.3, 1.0, 1.5 + 1e-14j) == pytest.approx(fresnel.reflectance(0.3, 1.0, 1.5))


def test_diffuse_reflectance_of_an_interface():
    assert fresnel.diffuse_external(1.5) == pytest.approx(0.09178, abs=5e-6)
    assert fresnel.diffuse_internal(1.5) == pytest.approx(0.59635, abs=6e-6)
    for n in (1.1, 1.33, 2.4):  # Stern's relation
        assert fresnel.diffuse_internal(n) == pytest.approx(1 - (1 - fresnel.diffuse_external(n)) / n**2)


def test_interfaced_lambert():
    for rho, expected in ((0.5, 0.31607), (0.8, 0.63283), (1.0, 1.0)):
        assert fresnel.interfaced_lambert_albedo(1.0, 1.5, rho) == pytest.approx(expected, abs=5e-6)
    for n, tau in ((1.5, 0.0), (1.33, 0.4), (0.75, 0.2)):
        mu, w = cavities.gauss(0, 1, 400)
        if n < 1:
            critical = math.sqrt(1 - n**2)
            mu, w = cavities.gauss(critical, 1, 400)
        cos_i = math.cos(radians(25))
        f = fresnel.interfaced_lambert(cos_i, mu, n, 0.7, tau)
        total = float(fresnel.unpolarised(cos_i, 1.0, n)) + 2 * math.pi * (w * mu) @ f
        assert total == pytest.approx(fresnel.interfaced_lambert_albedo(cos_i, n, 0.7, tau), abs=1e-5)


@pytest.mark.parametrize(
    ("angle", "expected"), [(0, 0.076923), (45, 0.092656), (56.31, 0.128866), (75, 0.381851)]
)
def test_lossless_slab(angle, expected):
    r, t = fresnel.slab(math.cos(radians(angle)), 1.5)
    assert r.mean() == pytest.approx(expected, abs=1e-6)
    assert r + t == pytest.approx(1.0)


def test_absorbing_slab_loses_along_the_refracted_ray():
    cos_i = math.cos(radians(60))
    cos_t = math.sqrt(1 - 0.75 / 2.25)
    _, t = fresnel.slab(cos_i, 1.5, tau=0.3)
    first = fresnel.reflectance(cos_i, 1.0, 1.5)
    once = math.exp(-0.3 / cos_t)
    assert t == pytest.approx((1 - first) ** 2 * once / (1 - first**2 * once**2))
    r, t = fresnel.slab(cos_i, 1.5, tau=50.0)
    assert r == pytest.approx(first)
    assert t == pytest.approx(0.0, abs=1e-20)


def test_plate_over_metal():
    cos_i = 0.4
    bare = fresnel.plate_over_metal(cos_i, 1.0 + 1e-12, GOLD)
    assert bare == pytest.approx(fresnel.reflectance(cos_i, 1.0, GOLD))
    assert fresnel.plate_over_metal(cos_i, 1.5, 1e9j) == pytest.approx(1.0)


# --- films ---


def test_film_limits():
    cos_i = math.cos(radians(40))
    bare = fresnel.amplitudes(cos_i, 1.0, 1.5)
    r, t = film_stack(cos_i, 1.0, [(2.1 + 0.3j, 0.0)], 1.5, 0.5)
    assert r == pytest.approx(bare)
    assert t == pytest.approx(1 - np.abs(bare) ** 2)
    # quarter wave of n = sqrt(1.5): no reflection at all
    r, t = film_stack(1.0, 1.0, [(math.sqrt(1.5), 0.25 / math.sqrt(1.5))], 1.5, 1.0)
    assert r == pytest.approx([0, 0], abs=1e-15)
    assert t == pytest.approx([1, 1])
    # averaged over phase, the coherent plate is the incoherent one
    cos_t = fresnel.refracted_cosine(cos_i, 1.0, 1.5)
    phases = (np.arange(64) + 0.5) / 64 * 0.5 / (1.5 * cos_t)
    mean = np.mean([np.abs(film_stack(cos_i, 1.0, [(1.5, d)], 1.0, 1.0)[0]) ** 2 for d in phases], axis=0)
    assert mean == pytest.approx(fresnel.slab(cos_i, 1.5)[0])


def test_films_against_the_tmm_package():
    tmm = pytest.importorskip("tmm")
    films = [(1.38, 0.1), (2.3 + 0.05j, 0.06), (1.46, 0.2)]
    for angle in (0.0, 0.5, 1.3):
        for below in (1.5, GOLD):
            r, t = film_stack(math.cos(angle), 1.0, films, below, 0.55)
            for column, pol in enumerate("sp"):
                referee = tmm.coh_tmm(
                    pol, [1.0, *(n for n, _ in films), below], [math.inf, *(d for _, d in films), math.inf],
                    angle, 0.55,
                )  # fmt: skip
                assert abs(r[column]) ** 2 == pytest.approx(referee["R"])
                if below == 1.5:
                    assert t[column] == pytest.approx(referee["T"])


# --- scattering media ---


def test_h_function_of_chandrasekhar():
    """His tables: Radiative Transfer, Table XI; H(1) for albedo 1, .8, .5."""
    assert half_space.h_function(1.0, 1.0) == pytest.approx(2.9078, abs=5e-5)
    assert half_space.h_function(0.5, 1.0) == pytest.approx(2.0128, abs=5e-5)
    x, w = cavities.gauss(0, 1, 100)
    x, w = x**2, 2 * x * w
    for albedo in (0.3, 0.8, 0.99):  # his theorem: the mean of H
        mean = w @ half_space.h_function(x, albedo)
        assert mean == pytest.approx(2 / albedo * (1 - math.sqrt(1 - albedo)), rel=1e-10)


@pytest.mark.parametrize(
    ("albedo", "angle", "expected"),
    [(0.8, 0, 0.28525), (0.8, 60, 0.36797), (0.5, 0, 0.11523), (0.5, 60, 0.16014)],
)
def test_half_space(albedo, angle, expected):
    mu_i = math.cos(radians(angle))
    assert half_space.half_space_albedo(mu_i, albedo) == pytest.approx(expected, abs=6e-6)
    x, w = cavities.gauss(0, 1, 100)
    x, w = x**2, 2 * x * w
    total = 2 * math.pi * (w * x) @ half_space.half_space(mu_i, x, albedo)
    assert total == pytest.approx(half_space.half_space_albedo(mu_i, albedo), rel=1e-9)


def test_single_scattering_is_what_weak_scattering_tends_to():
    mu_i, mu_o, albedo = 0.6, 0.3, 1e-6
    full = half_space.half_space(mu_i, mu_o, albedo)
    assert half_space.single_scattering(mu_i, mu_o, albedo) == pytest.approx(full, rel=1e-5)
    nodes = planar.make_nodes([1.0], [math.degrees(math.acos(m)) for m in (mu_i, mu_o)])
    slab = planar.medium(nodes, 1.0, 0.7, albedo, np.ones_like)
    assert half_space.single_scattering(mu_i, mu_o, albedo, 0.7) == pytest.approx(
        planar.brdf([slab.r], 1, 0)(0.0), rel=1e-5
    )
    assert half_space.single_transmission(mu_i, mu_o, albedo, 0.7) == pytest.approx(
        planar.brdf([slab.t], 1, 0)(0.0), rel=1e-5
    )


def isotropic(cosine):
    return np.ones_like(cosine)


def hg(g):
    return lambda cosine: half_space.henyey_greenstein(cosine, g)


def test_planar_half_space_is_chandrasekhars():
    nodes = planar.make_nodes([1.0], [0, 60])
    slab = planar.medium(nodes, 1.0, 60.0, 0.8, isotropic)
    for node, mu in enumerate((1.0, 0.5)):
        assert planar.albedo(slab.r, nodes, node) == pytest.approx(
            half_space.half_space_albedo(mu, 0.8), rel=1e-6
        )
    assert planar.brdf([slab.r], 1, 0)(1.0) == pytest.approx(half_space.half_space(1.0, 0.5, 0.8), rel=1e-6)


def test_planar_slab_of_van_de_hulst():
    """tau = 2, w = .9, g = .75, index-matched: R .09739, T .66096 (van de Hulst 1980, table 35; Wang et al. 1995)."""
    nodes = planar.make_nodes([1.0], [0], per_segment=32)
    slab = planar.medium(nodes, 1.0, 2.0, 0.9, hg(0.75))
    assert planar.albedo(slab.r, nodes, 0) == pytest.approx(0.09739, abs=6e-6)
    assert planar.albedo(slab.t, nodes, 0) == pytest.approx(0.66096, abs=6e-6)


def test_planar_half_space_of_giovanelli():
    """n = 1.5, w = .9, isotropic: R .2600 at normal incidence (Giovanelli 1955, mirror term included)."""
    nodes = planar.make_nodes([1.0, 1.5], [0])
    stack = planar.interface(nodes, 1.0, 1.5).over(planar.medium(nodes, 1.5, 60.0, 0.9, isotropic))
    assert planar.albedo(stack.r, nodes, 0) == pytest.approx(0.2600, abs=1e-4)


def test_planar_slab_of_prahl():
    """w = .9, tau = 2, isotropic, n = 1.5 in air: his program iadpython 0.5.3 with 64 nodes.

    His interfaces reflect the mean of s and p, of light that they have polarised too.
    """
    nodes = planar.make_nodes([1.0, 1.5], [0])
    stack = planar.interface(nodes, 1.0, 1.5).over(planar.medium(nodes, 1.5, 2.0, 0.9, isotropic))
    stack = stack.over(planar.interface(nodes, 1.5, 1.0))
    assert planar.albedo(stack.r, nodes, 0) == pytest.approx(0.25306, abs=5e-4)
    assert planar.albedo(stack.t, nodes, 0) == pytest.approx(0.28879, abs=5e-4)


def test_planar_rayleigh_with_polarisation():
    """Natraj, Li & Yung (2009), ApJ 691, 1909: Coulson's tables corrected; tau = .5, mu0 = .2, flux pi.

    Intensity I at (mu, phi), phi = 0 where light goes on in its azimuth, over a base of albedo .8 and of 0.
    Scalar scattering by Rayleigh's phase function is several per cent off.
    """
    angles = np.degrees(np.arccos([0.2, 1.0, 0.4, 0.02, 0.92]))
    bright, dark = [], []
    for mode in range(3):
        nodes = planar.make_nodes([1.0], angles, per_segment=16, mode=mode)
        medium = planar.medium(nodes, 1.0, 0.5, 1.0, None)
        dark.append(medium.r)
        bright.append(medium.over(planar.lambert(nodes, 1.0, 0.8)).r)
    for operators, out, phi, expected in [
        (bright, 1, 0, 0.13280858),
        (bright, 2, 0, 0.23059806),
        (bright, 3, 0, 0.47382125),
        (bright, 2, 60, 0.18923236),
        (bright, 3, 60, 0.33343531),
        (dark, 3, 30, 0.39444956),
        (dark, 4, 60, 0.05643322),
    ]:
        intensity = planar.brdf(operators, out, 0)(math.pi - radians(phi)) * 0.2 * math.pi
        assert intensity == pytest.approx(expected, rel=1e-5)


def test_planar_interfaces_and_bases_are_the_closed_forms():
    angles = [0, 45, 75]
    nodes = planar.make_nodes([1.0, 1.5], angles, per_segment=20)
    top, bottom = planar.interface(nodes, 1.0, 1.5), planar.interface(nodes, 1.5, 1.0)
    absorber = planar.clear(nodes, 1.5, 0.3)
    slab = top.over(absorber).over(bottom)
    varnish = top.over(absorber).over(planar.lambert(nodes, 1.5, 0.8))
    plate = top.over(absorber).over(planar.metal(nodes, 1.5, GOLD))
    for node, angle in enumerate(angles):
        mu = math.cos(radians(angle))
        r, t = fresnel.slab(mu, 1.5, 0.3)
        assert planar.albedo(slab.r, nodes, node) == pytest.approx(r.mean(), rel=1e-8)
        assert planar.albedo(slab.t, nodes, node) == pytest.approx(t.mean(), rel=1e-8)
        assert planar.albedo(varnish.r, nodes, node) == pytest.approx(
            fresnel.interfaced_lambert_albedo(mu, 1.5, 0.8, 0.3), rel=1e-7
        )
        assert planar.albedo(plate.r, nodes, node) == pytest.approx(
            fresnel.plate_over_metal(mu, 1.5, GOLD, 0.3).mean(), rel=1e-8
        )


def test_planar_stacks_conserve_light():
    angles = [0, 30, 80]
    nodes = planar.make_nodes([1.0, 1.33, 1.6], angles, per_segment=16)
    upper = planar.interface(nodes, 1.0, 1.33).over(planar.medium(nodes, 1.33, 0.8, 1.0, None))
    stack = upper.over(planar.interface(nodes, 1.33, 1.6)).over(planar.medium(nodes, 1.6, 2.0, 1.0, hg(0.3)))
    white = stack.over(planar.lambert(nodes, 1.6, 1.0))
    open_below = stack.over(planar.interface(nodes, 1.6, 1.0))
    for node in range(len(angles)):
        assert planar.albedo(white.r, nodes, node) == pytest.approx(1.0, abs=1e-6)
        both = planar.albedo(open_below.r, nodes, node) + planar.albedo(open_below.t, nodes, node)
        assert both == pytest.approx(1.0, abs=1e-6)


# --- grooves and cavities ---


@pytest.mark.parametrize(
    ("slope", "theta", "exits"),
    [
        (25, 0, {(1, 50): 0.5, (1, -50): 0.5}),
        (35, 0, {(1, 70): 0.3420, (1, -70): 0.3420, (2, 40): 0.1580, (2, -40): 0.1580}),
        (45, 0, {(2, 0): 1.0}),
        (60, 0, {(3, 0): 1.0}),
        (45, 20, {(1, -70): math.tan(radians(20)), (2, -20): 1 - math.tan(radians(20))}),
        (30, 40, {(1, -20): 0.7422, (2, 20): 0.2578}),
    ],
)
def test_mirror_grooves(slope, theta, exits):
    table = grooves.mirror_exits(radians(slope), radians(theta))
    assert table.keys() == exits.keys()
    for key, share in exits.items():
        assert table[key] == pytest.approx(share, abs=6e-5)


def test_metal_grooves_at_normal_incidence():
    r45 = fresnel.reflectance(math.cos(radians(45)), 1.0, GOLD)
    assert grooves.albedo(radians(45), 0, 0, METAL) == pytest.approx((r45**2).mean())
    r60, r0 = (fresnel.reflectance(math.cos(radians(a)), 1.0, GOLD) for a in (60, 0))
    assert grooves.albedo(radians(60), 0, 0, METAL) == pytest.approx((r60**2 * r0).mean())


def test_glass_groove():
    assert grooves.albedo(radians(45), 0, 0, grooves.Walls(1.5)) == pytest.approx(0.004269, abs=5e-7)
    for slope, theta, phi in ((50, 60, 35), (20, 80, 60), (70, 30, 5)):
        for films in ((), ((1.38, 0.2), (2.3, 0.15))):  # clear ones
            exits = grooves.groove(radians(slope), radians(theta), radians(phi), grooves.Walls(1.5, films))
            assert sum(e.share * e.weight for e in exits) == pytest.approx(1.0, abs=1e-6)


def test_a_groove_turned_about_its_own_line_of_sight_is_reciprocal():
    """Light that retraces its path: the intensity of retro-reflection is the same from any side of a cross-plane."""
    for phi in (0.0, 0.7):
        forth = grooves.albedo(radians(50), radians(40), phi, METAL)
        back = grooves.albedo(radians(50), radians(40), math.pi - phi, METAL)
        assert forth == pytest.approx(back)


@pytest.mark.parametrize(
    ("slope", "rho", "expected"),
    [(30, 0.5, 0.46370), (30, 0.8, 0.77553), (45, 0.5, 0.41215), (45, 0.8, 0.73594)],
)
def test_lambert_groove(slope, rho, expected):
    assert cavities.lambert_groove(radians(slope), rho) == pytest.approx(expected, abs=6e-6)
    orders = cavities.lambert_groove(radians(slope), rho, orders=60)
    assert orders.sum() == pytest.approx(expected, abs=1e-5)


def test_white_lambert_groove():
    for slope, theta, phi in ((30, 20, 0.0), (45, 75, 0.0), (70, 80, 0.4), (80, 0, 0.0)):
        white = cavities.lambert_groove(radians(slope), 1.0, radians(theta), phi, nodes=240)
        assert white == pytest.approx(1.0, abs=1e-5)


def test_pits():
    rho = 0.7
    assert cavities.pit_albedo(1.0, rho) == pytest.approx(rho / (2 - rho))  # a hemisphere
    for depth in (0.3, 1.0):
        orders = [cavities.pit_order(depth, rho, k) for k in range(1, 200)]
        assert sum(orders) == pytest.approx(cavities.pit_albedo(depth, rho))
    inside = 1.0 - np.cumsum([cavities.pit_order(1.0, 1.0, k) for k in range(1, 6)])
    assert inside == pytest.approx(0.5 ** np.arange(1, 6))


def test_lambert_sphere_scatters_all_its_light():
    mu, w = cavities.gauss(-1, 1, 200)
    assert w @ cavities.lambert_sphere(np.arccos(mu)) / 2 == pytest.approx(1.0, rel=1e-6)
