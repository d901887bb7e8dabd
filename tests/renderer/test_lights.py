"""Direct light on a white diffuse plane against closed forms: L_o = E / pi."""

import numpy as np
import pytest

from renderer.scene import DirectionalLight, Disk, Material, PointLight, Sphere, look_at
from tests.renderer.scenes import WHITE, assert_within, constant, mean, simple, spot, square

FLOOR = square(5)
STRATEGIES = ("mis", "light", "material")


def disk_light(radius, height):
    matrix = np.diag([radius, radius, radius, 1.0])
    matrix[2, 3] = height
    return Disk(matrix, flip_normals=True, emission=(1.0, 0.5, 2.0))


def test_point_light_is_exact():
    # E = I cos / d^2 with d^2 = 1 + 4 + 4 = 9 and cos = 2/3
    light = PointLight((1.0, 2.0, 2.0), (9.0, 18.0, 27.0))
    value, error = mean(simple([FLOOR], lights=[light], max_depth=2), 2)
    np.testing.assert_allclose(value, np.array([1, 2, 3]) * 2 / 3 / np.pi, rtol=1e-3)  # the pixel's size
    assert np.all(error < 1e-3)


def test_directional_light_is_exact_and_casts_shadows():
    light = DirectionalLight((0.0, 3.0, -4.0), (1.0, 2.0, 3.0))
    value, _ = mean(simple([FLOOR], lights=[light], max_depth=2), 2)
    np.testing.assert_allclose(value, np.array([1, 2, 3]) * 0.8 / np.pi, rtol=1e-5)
    # towards the light from the origin is (0, -3, 4)/5: a ball there darkens it, one opposite does not
    for y, expected in ((-1.2, 0.0), (1.2, 0.8 / np.pi)):
        ball = Sphere((0.0, y, 1.6), 0.3, material=WHITE)
        value, _ = mean(simple([FLOOR, ball], lights=[light], max_depth=2), 2)
        assert value[0] == pytest.approx(expected, rel=1e-5)


@pytest.mark.compiled
@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize(("radius", "height"), [(1.0, 1.0), (4.0, 0.5)])
def test_disk_light_overhead(strategy, radius, height):
    # E = L pi sin^2(theta) = L pi R^2 / (R^2 + h^2) on the axis of a parallel disk
    scene = simple([FLOOR, disk_light(radius, height)], max_depth=2, camera=low_camera())
    value, error = mean(scene, 4000, strategy=strategy)
    expected = radius**2 / (radius**2 + height**2)
    assert_within(value, expected * np.array([1, 0.5, 2]), error)


def low_camera():
    return spot((4.0, 0.0, 0.3))


@pytest.mark.compiled
@pytest.mark.parametrize("strategy", STRATEGIES)
def test_sphere_light(strategy):
    # a sphere wholly above the horizon: E = pi L (R/d)^2 cos(theta of its centre); d = 3, cos = 2/3
    ball = Sphere((1.0, 2.0, 2.0), 1.2, emission=(1.0, 2.0, 3.0))
    value, error = mean(simple([FLOOR, ball], max_depth=2, camera=low_camera()), 6000, strategy=strategy)
    assert_within(value, np.array([1, 2, 3]) * (1.2 / 3) ** 2 * 2 / 3, error)


@pytest.mark.compiled
@pytest.mark.parametrize("strategy", STRATEGIES)
def test_rectangle_light(strategy):
    # A square of half width w parallel to the floor at height h, four quarters with a corner overhead:
    # form factor of a quarter 1/(2 pi) [2 a/sqrt(1 + a^2) atan(a/sqrt(1 + a^2))], a = w/h (Howell C-11)
    a = 1.5
    root = np.sqrt(1 + a * a)
    form = 4 / (2 * np.pi) * 2 * a / root * np.arctan(a / root)
    light = square(1.5, 1.0, emission=(1.0, 2.0, 3.0), down=True)
    value, error = mean(simple([FLOOR, light], max_depth=2, camera=low_camera()), 4000, strategy=strategy)
    assert_within(value, form * np.array([1, 2, 3]), error)


@pytest.mark.compiled
def test_lights_add_up():
    # the chance to choose a light must cancel, in sampling and in both densities; multiple bounces too
    disk, point = disk_light(1, 1), PointLight((1, 1, 1.5), (1, 1, 1))
    dark = Disk(disk.to_world, True)  # hides the sky whether it shines or not
    sky = constant(0.2, 0.3, 0.4)
    floor = square(5, material=Material())

    def lit(shape, environment, lights, seed):
        return mean(simple([floor, shape], environment, lights, low_camera()), 10_000, seed)

    parts = [lit(disk, None, [], 1), lit(dark, sky, [], 2), lit(dark, None, [point], 3)]
    both, error = lit(disk, sky, [point], 4)
    assert_within(both, sum(v for v, _ in parts), np.sqrt(error**2 + sum(e**2 for _, e in parts)))


def test_emitters_shine_from_their_front_only():
    for down, expected in ((True, 1.0), (False, 0.0)):
        light = square(1.0, 1.0, material=None, emission=(1.0, 1.0, 1.0), down=down)
        camera = simple([], camera=None).camera
        matrix = look_at((0, 0, 0.2), (0, 0, 1), (0, 1, 0))
        camera = type(camera)(matrix, 5, width=2, height=2)
        value, _ = mean(simple([light], camera=camera), 1)
        assert np.all(value == expected)
