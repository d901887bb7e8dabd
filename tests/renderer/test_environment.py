"""The environment map: orientation, and the density it is drawn with."""

import numpy as np
import pytest
from scipy import stats

from gonio.core.directions import direction
from gonio.core.jit import kernel
from renderer.environment import environment_radiance, pack_environment, sample_environment
from renderer.render import render
from renderer.scene import Camera, Environment, Material, Scene, look_at
from tests.renderer.scenes import assert_within, mean, simple, spot, square

RNG = np.random.default_rng(7)
H, W = 9, 16


def ramps():
    """Red is the row, green the column, blue one."""
    return np.stack([*np.meshgrid(np.arange(H), np.arange(W), indexing="ij"), np.ones((H, W))], axis=-1)


def speckle():
    image = 0.1 + RNG.random((H, W, 3))
    image[6, 5] = (40, 20, 10)
    image[0], image[-1] = image[0].mean(0), image[-1].mean(0)  # a pole is one direction
    return image


@pytest.mark.parametrize(
    ("toward", "row", "column"),
    [
        ((0, 0, 1), 4, 7.5),  # Mitsuba: u = atan2(x, -z)/2 pi = 1/2, pixel centres at (i + 1/2)/W
        ((1, 0, 0), 4, 3.5),
        ((-1, 0, 0), 4, 11.5),
        ((0, 1, 0), 0, None),
        ((0, -1, 0), 8, None),
        ((0.5, np.sqrt(0.5), 0.5), 2, 5.5),  # 45 degrees up, between +x and +z
    ],
)
def test_orientation(toward, row, column):
    red, green, blue, _ = environment_radiance(pack_environment(Environment(ramps())), toward)
    assert red == pytest.approx(row, abs=1e-5)
    assert blue == pytest.approx(1)
    if column is not None:
        assert green == pytest.approx(column, abs=1e-5)


def test_to_world_turns_the_map():
    # 90 degrees about +y takes the map's +z to the world's +x
    turn = np.eye(4)
    turn[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    packed = pack_environment(Environment(ramps(), turn, 2.0))
    red, green, _, _ = environment_radiance(packed, (1.0, 0.0, 0.0))
    assert (red, green) == pytest.approx((8, 15), abs=1e-4)


def test_camera_sees_left_on_the_left():
    # looking to +z with +y up, Mitsuba's image has +x on its left
    scene = simple([], Environment(ramps()), camera=Camera(np.eye(4), 60, width=8, height=8))
    image = render(scene, spp=1).pixels
    assert image[0, 0, 0] < image[-1, 0, 0]  # rows grow downwards
    assert image[0, 0, 1] < image[0, -1, 1]  # columns grow from +x over +z to -x


def test_mirror_shows_the_mirrored_direction():
    # from (3, 1, 2) the floor mirrors to (-3, -1, 2): asymmetric in every coordinate
    mirror = square(5, material=Material("conductor", {}))
    packed = pack_environment(Environment(speckle()))
    scene = simple([mirror], Environment(speckle()))
    value, _ = mean(Scene(spot(), scene.shapes, Environment(np.array(packed.radiance, float))), 1)
    expected = environment_radiance(packed, tuple(np.array([-3, -1, 2]) / np.sqrt(14)))[:3]
    np.testing.assert_allclose(value, expected, rtol=2e-3)


@kernel
def _draw_many(environment, u, out):
    for i in range(len(u)):
        d = sample_environment(environment, u[i, 0], u[i, 1], u[i, 2])
        out[i, 0], out[i, 1], out[i, 2] = d
        out[i, 3] = environment_radiance(environment, d)[3]


@pytest.mark.compiled
def test_samples_follow_the_density():
    turn = look_at((0, 0, 0), (1, 2, 3))
    packed = pack_environment(Environment(speckle(), turn))
    n = 400_000
    out = np.empty((n, 4))
    _draw_many(packed, RNG.random((n, 3)), out)
    # bins that cut through the map's cells, in the world's own frame
    z, phi = out[:, 2], np.arctan2(out[:, 1], out[:, 0])
    counts = np.histogram2d(z, phi, (20, 40), [[-1, 1], [-np.pi, np.pi]])[0].ravel()
    fine = 24
    zs = -1 + 2 * (np.arange(20 * fine) + 0.5) / (20 * fine)
    phis = -np.pi + 2 * np.pi * (np.arange(40 * fine) + 0.5) / (40 * fine)
    grid = direction(np.arccos(zs)[:, None], phis[None, :]).reshape(-1, 3)
    density = np.empty(len(grid))
    _densities(packed, grid, density)
    expected = density.reshape(20, fine, 40, fine).mean(axis=(1, 3)).ravel() * 4 * np.pi / 800
    assert expected.sum() == pytest.approx(1, abs=2e-3)
    expected *= n / expected.sum()
    # midpoints do not resolve the cells' edges exactly: half a per cent of a bin joins the variance
    chi2 = ((counts - expected) ** 2 / (expected + (0.02 * expected) ** 2)).sum()
    assert stats.chi2.sf(chi2, 799) > 1e-4
    assert chi2 > 400  # the allowance does not hide everything


@kernel
def _densities(environment, grid, out):
    for i in range(len(grid)):
        out[i] = environment_radiance(environment, (grid[i, 0], grid[i, 1], grid[i, 2]))[3]


@pytest.mark.compiled
@pytest.mark.parametrize("material", ["diffuse", "rough_conductor"])
def test_all_ways_to_find_light_agree(material):
    floor = square(5, material=Material(material, {"alpha": 0.5} if material != "diffuse" else {}))
    scene = simple([floor], Environment(speckle(), look_at((0, 0, 0), (1, 2, 3))), max_depth=2)
    results = [mean(scene, 20_000, seed=i, strategy=s) for i, s in enumerate(("mis", "material", "light"))]
    for value, error in results[1:]:
        assert_within(results[0][0], value, np.hypot(error, results[0][1]))
    assert np.all(results[0][1] < 0.95 * results[1][1])  # and it pays


def test_constant_environment_is_drawn_uniformly():
    packed = pack_environment(Environment(np.full((1, 1, 3), 3.0)))
    for toward in ((0, 1, 0), (0.6, -0.8, 0), (0, 0, -1)):
        assert environment_radiance(packed, toward) == pytest.approx((3, 3, 3, 1 / (4 * np.pi)))
