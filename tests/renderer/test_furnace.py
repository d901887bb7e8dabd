"""White furnace: what reflects everything vanishes in a constant environment."""

import numpy as np
import pytest

from renderer.render import render
from renderer.scene import Camera, Material, Scene, Sphere, look_at
from tests.renderer.scenes import WHITE, assert_within, constant, lambert_table, square

CAMERA = Camera(look_at((0, 0, 5), (0, 0, 0)), 40, width=16, height=12)
WHITES = {
    "diffuse": WHITE,
    "conductor": Material("conductor", {}),
    "dielectric": Material("dielectric", {"eta": 1.5}),
    "table": Material("tabulated", {"table": lambert_table()}),
    "table with mirror": Material("tabulated", {"table": lambert_table(0.4, specular=0.6)}),
}


def scene(material, floor=True):
    shapes = [Sphere((-0.5, 0, 0), 0.8, material=material), Sphere((0.8, 0, 0.3), 0.5, material=material)]
    if floor:
        shapes.append(square(3, -1, material))
    return Scene(CAMERA, tuple(shapes), constant(), max_depth=-1)


@pytest.mark.compiled
@pytest.mark.parametrize("name", WHITES)
def test_white_vanishes(name):
    image = render(scene(WHITES[name], floor=name != "dielectric"), spp=256)  # glass must be closed
    total, error = image.pixels.mean(), np.sqrt((image.std_error**2).sum()) / image.pixels.size
    # error bars of the three channels are one and the same
    assert abs(total - 1) < 4.5 * max(np.sqrt(3) * error, 1e-6)
    z = (image.pixels[..., 0] - 1) / np.maximum(image.std_error[..., 0], 1e-6)
    assert np.abs(z).max() < 6


@pytest.mark.compiled
def test_every_single_path_brings_one_where_materials_alone_are_sampled():
    # the weight of cosine-drawn diffuse reflection is 1, and all paths end in light of radiance 1; roulette
    # (which divides by at most 0.95) is put off beyond their length
    white = scene(WHITE)
    white = Scene(white.camera, white.shapes, white.environment, russian_roulette_depth=1000, max_depth=-1)
    image = render(white, spp=4, strategy="material")
    np.testing.assert_allclose(image.pixels, 1.0, atol=2e-6)


@pytest.mark.compiled
def test_microfacets_lose_energy_and_do_not_make_any():
    # at normal incidence GGX sends 1/(1 + 1/alpha^2) below the horizon without any masking
    for alpha, least in ((0.05, 0.98), (0.5, 0.65), (1.0, 0.35)):
        for distribution in ("beckmann", "ggx"):
            rough = Material("rough_conductor", {"alpha": alpha, "distribution": distribution})
            ball = Scene(
                Camera(look_at((0, 0, 5), (0, 0, 0)), 20, width=8, height=8), (Sphere(material=rough),)
            )
            image = render(Scene(ball.camera, ball.shapes, constant()), spp=400)
            value = image.pixels.mean()
            error = np.sqrt(3 * (image.std_error**2).sum()) / image.pixels.size
            assert least < value < 1 + 4 * error, (alpha, distribution, value)


def test_black_reflects_nothing():
    black = Scene(
        Camera(look_at((0, 0, 5), (0, 0, 0)), 5, width=3, height=2),
        (Sphere(material=Material("none", {})),),
        constant(),
    )
    assert np.all(render(black, spp=2).pixels == 0)


@pytest.mark.compiled
def test_half_grey_inside_a_glowing_sphere():
    # a diffuse sphere of albedo a in a constant environment shows exactly a: it is convex
    grey = Scene(
        Camera(look_at((0, 0, 5), (0, 0, 0)), 8, width=4, height=4), (Sphere(),), constant(2, 1, 0.5)
    )
    image = render(grey, spp=2000)
    assert_within(image.pixels.mean((0, 1)), [1, 0.5, 0.25], np.sqrt((image.std_error**2).sum((0, 1))) / 16)
