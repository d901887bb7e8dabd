"""Transport against closed forms: where every path must go, and that none disappears."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from gonio.core.optics import fresnel_conductor
from gonio.trace.transport import ABSORBED, KILLED, LOST, MAX_SEGMENTS, REFLECTED
from microgeometry.materials import Conductor, Lambert, Mirror
from microgeometry.specimen import parse_specimen
from microgeometry.tile import HeightField, TriangleMesh
from tests.trace.paths import Paths


def v_groove(slope_deg):
    return HeightField(np.array([[0.0], [-0.5 * math.tan(math.radians(slope_deg))]]), (1.0, 1.0))


def tan(degrees):
    return math.tan(math.radians(degrees))


def cos(degrees):
    return math.cos(math.radians(degrees))


# Stratified origins: 4 x 32 strata across the groove, so a fraction is known to 1/128.
STRATUM = 1 / 128


@pytest.mark.parametrize(
    ("slope", "theta_i", "exits"),
    [
        # slopes below 30 degrees: one bounce, light turned by twice the slope
        (20, 0, {(1, 40): 0.5, (1, -40): 0.5}),
        (30, 0, {(1, 60): 0.5, (1, -60): 0.5}),
        # between 30 and 45: light from the lower part of a wall meets the other wall. At slope 35 it leaves
        # the first wall 70 degrees off vertical; a share of 2 cos 70 clears the rim
        (35, 0, {(1, 70): cos(70), (1, -70): cos(70), (2, 40): 0.5 - cos(70), (2, -40): 0.5 - cos(70)}),
        (40, 0, {(1, 80): cos(80), (1, -80): cos(80), (2, 20): 0.5 - cos(80), (2, -20): 0.5 - cos(80)}),
        # a right-angled groove returns two bounces exactly where they came from
        (45, 0, {(2, 0): 1.0}),
        (45, 20, {(2, -20): 1 - tan(20)}),
        (45, 35, {(2, -35): 1 - tan(35)}),
        (60, 0, {(3, 0): 1.0}),
        # asymmetric: light 40 degrees from +x. The wall facing it (seen under cos 10 against cos 40) turns
        # it to -20; part of the far wall's light crosses to the other wall
        (30, 40, {(1, -20): 0.7422, (2, 20): 0.2578}),
    ],
)
def test_mirror_v_groove(slope, theta_i, exits):
    paths = Paths(v_groove(slope), Mirror(), theta_i)
    assert np.all(paths.status == REFLECTED)
    for (bounces, theta_r), fraction in exits.items():
        assert paths.fraction(bounces, theta_r) == pytest.approx(fraction, abs=STRATUM), (bounces, theta_r)


@pytest.mark.parametrize("across", [0, 1])
def test_groove_cut_by_the_faces_of_the_tile(across):
    heights = np.array([[-0.5 * tan(40)], [0.0]])  # the valley lies on the face
    paths = Paths(HeightField(heights if across == 0 else heights.T, (1.0, 1.0)), Mirror(), 0)
    assert np.mean(paths.bounces == 1) == pytest.approx(2 * cos(80), abs=STRATUM)
    assert np.mean(paths.bounces == 2) == pytest.approx(1 - 2 * cos(80), abs=STRATUM)


def test_right_angled_groove_one_bounce_share():
    # slope 45, t < 45 degrees: one bounce for tan t of the light
    paths = Paths(v_groove(45), Mirror(), 25)
    assert np.mean(paths.bounces == 1) == pytest.approx(tan(25), abs=STRATUM)


def test_steep_groove_loses_nothing():
    # walls 170 degrees about each other's... a groove of 10 degrees opening: up to 18 bounces
    paths = Paths(v_groove(85), Mirror(), 0, max_bounces=256)
    assert np.all(paths.status == REFLECTED)
    assert paths.bounces.max() == 18 or paths.bounces.max() == 17


@pytest.mark.parametrize(
    ("eta", "k", "slope", "angles"),
    [(0.2, 3.4, 45, (45, 45)), (1.5, 0, 45, (45, 45)), (1.1, 7, 60, (60, 0, 60))],
)
def test_conductor_groove_multiplies_reflectances(eta, k, slope, angles):
    # normal incidence: two or three bounces in one plane, so s and p stay apart
    paths = Paths(v_groove(slope), Conductor((eta,), (k,)), 0)
    r_s, r_p = np.prod([fresnel_conductor(cos(angle), eta, k) for angle in angles], axis=0)
    assert paths.weight == pytest.approx(np.full((len(paths.weight), 1), 0.5 * (r_s + r_p)), rel=1e-5)
    assert paths.weight.sum() + paths.absorbed.sum() == pytest.approx(len(paths.weight), rel=1e-12)


def test_bounce_cap_kills_and_counts():
    paths = Paths(v_groove(45), Mirror(), 0, max_bounces=1)
    assert np.all(paths.status == KILLED)
    assert np.all(paths.weight == 1)


@pytest.mark.compiled
@pytest.mark.parametrize(("slope", "albedo", "expected"), [
    # Fredholm's equation for an infinite Lambertian V-groove, normal incidence
    (30, 0.5, 0.46370), (30, 0.8, 0.77553), (45, 0.5, 0.41215), (45, 0.8, 0.73594),
])  # fmt: skip
def test_lambert_v_groove(slope, albedo, expected):
    batches = [
        Paths(v_groove(slope), Lambert((albedo,)), 0, side=64, seed=s).weight.mean() for s in range(16)
    ]
    error = np.std(batches, ddof=1) / 4
    # Student's t with 15 degrees of freedom exceeds 4.9 with a chance of 2e-4
    assert abs(np.mean(batches) - expected) < 4.9 * error
    assert error < 1e-3


def test_roulette_is_unbiased_and_exact_in_the_ledger():
    tile = v_groove(60)
    paths = Paths(tile, Lambert((0.9, 0.3)), 10, side=64)
    assert np.any(paths.status == ABSORBED)
    energy = paths.weight.sum(axis=0) + paths.absorbed
    assert energy == pytest.approx([len(paths.weight)] * 2, rel=1e-11)


@pytest.mark.compiled
def test_sharp_valleys_swallow_no_light():
    """The step off one wall can end behind the other: 1 path in 10 000 here, were it not taken back."""
    surface = parse_specimen({"surface": {"kind": "exponential", "alpha": 1, "correlation_length": [1, 50]},
                              "material": {"kind": "mirror"}}).surface  # fmt: skip
    paths = Paths(surface.realise(1), Mirror(), 0, side=96, max_bounces=1000)
    assert np.all(paths.status == REFLECTED)


def floating_sphere():
    """A sphere above a plane: overhangs, and free flight below them."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.25)
    ball.apply_translation([0.5, 0.5, 0.5])
    floor = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False
    )
    mesh = trimesh.util.concatenate([ball, floor])
    return TriangleMesh(np.array(mesh.vertices), np.array(mesh.faces, np.int32), (0.0, 0.0), (1.0, 1.0))


@pytest.mark.parametrize("material", [Mirror(), Lambert((1.0,))])
@pytest.mark.parametrize("theta_i", [0, 45, 80, 89.9])
def test_white_furnace_with_overhangs(material, theta_i):
    paths = Paths(floating_sphere(), material, theta_i, side=8, max_bounces=1000)
    assert np.all(paths.status == REFLECTED)
    assert paths.weight.sum() == len(paths.weight)


def test_hole_loses_what_falls_through_it():
    # a floor with a quarter missing
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 0.75, 0], [0, 0.75, 0]], float)
    tile = TriangleMesh(vertices, np.array([[0, 1, 2], [0, 2, 3]], np.int32), (0.0, 0.0), (1.0, 1.0))
    paths = Paths(tile, Mirror(), 30)
    assert np.mean(paths.status == LOST) == pytest.approx(0.25, abs=STRATUM)


@pytest.mark.parametrize(("factor", "shift"), [(1e-9, 0.0), (1e6, 0.0), (1.0, 1e6)])
def test_scale_and_shift_do_not_matter(factor, shift):
    surface = parse_specimen({"surface": {"kind": "gaussian", "alpha": 0.7, "samples": 64, "size": 8,
                                          "units": "m"}, "material": {"kind": "mirror"}}).surface  # fmt: skip
    tile = surface.realise(3)
    moved = HeightField(tile.heights * factor + shift, (tile.size[0] * factor, tile.size[1] * factor))
    a, b = (Paths(t, Mirror(), 50, side=16) for t in (tile, moved))
    same = np.linalg.norm(a.exits - b.exits, axis=1) < 1e-3
    # a path that grazes an edge may go the other way: at most a few in 4096
    assert np.mean(~same) < 2e-3
    assert b.weight.mean() == pytest.approx(a.weight.mean(), abs=1e-5)


def test_grazing_light_crosses_many_tiles_and_comes_out():
    paths = Paths(v_groove(45), Mirror(), 89.99, side=4)
    assert np.all(paths.status == REFLECTED)


@pytest.mark.compiled
def test_no_path_goes_on_for_ever():
    """Ramps at 45 degrees without a back turn light from above level: it runs on below all of them."""
    vertices = np.array([[0, 0, 0], [1, 0, 1], [1, 1, 1], [0, 1, 0]], float)
    ramp = TriangleMesh(vertices, np.array([[0, 1, 2], [0, 2, 3]], np.int32), (0.0, 0.0), (1.0, 1.0))
    paths = Paths(ramp, Mirror(), 0, side=1)
    assert np.all(paths.status == LOST)
    assert paths.rays == 16 * MAX_SEGMENTS
