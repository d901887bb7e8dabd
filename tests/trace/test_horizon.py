"""The horizon of a height field: never below the true one, close to it, and without a trace in the tables."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.core.embree import new_ray
from gonio.core.jit import kernel
from gonio.trace.horizon import NO_HORIZON, escapes, find_horizon
from gonio.trace.scene import TraceScene
from gonio.trace.tracer import Tracer
from gonio.trace.visibility import _is_free
from microgeometry.materials import Conductor, Lambert, Mirror
from microgeometry.specimen import parse_specimen
from microgeometry.tile import HeightField

from .paths import Paths

pytestmark = pytest.mark.compiled

SURFACES = {
    "smooth": {"kind": "gaussian", "alpha": 0.5, "samples": 64, "size": 8},
    "odd": {"kind": "gaussian", "alpha": 1.0, "samples": 62, "size": 8},
    "stretched": {
        "kind": "gaussian",
        "alpha": 0.3,
        "samples": 64,
        "size": 8,
        "correlation_length": [1.0, 4.0],
    },
    "jagged": {"kind": "exponential", "rms_height": 0.3, "correlation_length": 1.0, "samples": 64, "size": 8},
    "groove": {"kind": "v_groove", "slope_deg": 40.0},
}


def tile_of(name):
    return (
        parse_specimen({"surface": SURFACES[name], "material": {"kind": "mirror"}})
        .layers[0]
        .surface.realise(5)
    )


@kernel
def look(embree, box, horizon, points, directions, found, free):
    ray = new_ray()
    for k in range(len(points)):
        x, y, z = points[k]
        a, b, c = directions[k]
        found[k] = escapes(horizon, x, y, z, a, b, c)
        free[k], _ = _is_free(embree, box, ray, (x, y, z), (a, b, c))


def looks(tile, n=100_000):
    """Whether the horizon, and whether Embree, lets rays go that start on the surface in all directions up."""
    scene = TraceScene([tile], horizon=True)
    rng = np.random.default_rng(1)
    nx, ny = tile.heights.shape
    place = rng.random((n, 2)) * (nx, ny)
    i, j = place.astype(int).T
    u, v = (place - np.floor(place)).T
    i1, j1 = (i + 1) % nx, (j + 1) % ny
    z = tile.heights
    height = np.where(  # on the triangles (v0, v1, v3) and (v2, v3, v1)
        u + v < 1,
        z[i, j] + u * (z[i1, j] - z[i, j]) + v * (z[i, j1] - z[i, j]),
        z[i1, j1] + (1 - u) * (z[i, j1] - z[i1, j1]) + (1 - v) * (z[i1, j] - z[i1, j1]),
    )
    points = np.column_stack([place / (nx, ny) * (tile.size[0], tile.size[1]), height - scene.centre])
    points /= scene.unit
    points[:, 2] += 4 * float(scene.box.lift)
    slope, azimuth = rng.exponential(0.5, n), rng.uniform(0, 2 * np.pi, n)
    directions = np.column_stack([np.cos(azimuth), np.sin(azimuth), slope])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found, free = np.zeros(n, bool), np.zeros(n, bool)
    look(scene.embree, scene.box, scene.horizon, points, directions, found, free)
    return found, free


@pytest.mark.parametrize("name", SURFACES)
def test_what_escapes_meets_nothing(name):
    found, free = looks(tile_of(name))
    assert 0 < free.sum() < len(free)
    assert not np.any(found & ~free)


def test_most_of_the_needless_rays_are_saved():
    """On a surface sampled as finely as is usual, 16 times a correlation length; measured: 0.86 of them."""
    surface = {"kind": "gaussian", "alpha": 0.5, "samples": 256}
    tile = parse_specimen({"surface": surface, "material": {"kind": "mirror"}}).layers[0].surface.realise(5)
    with_horizon, without = (Paths(tile, Mirror(), 0.0, horizon=h) for h in (True, False))
    needless = without.rays - without.bounces.sum()
    assert without.rays - with_horizon.rays > 0.8 * needless


@pytest.mark.parametrize("shape", [(128, 128), (50, 90)])
def test_a_lone_tower_is_seen_from_everywhere(shape):
    """Rays to just below its tip are not let go, from as far as the next period; some that pass well above are."""
    z = np.zeros(shape)
    z[0, 0] = height = 0.05
    horizon = find_horizon(z, 1.0, 1.5)
    rng = np.random.default_rng(2)
    points = rng.random((3000, 2)) * (1.0, 1.5)
    to_tip = rng.integers(-1, 3, (3000, 2)) * (1.0, 1.5) - points
    slope = height / np.linalg.norm(to_tip, axis=1)

    def let_go(factor):
        rays = np.column_stack(
            [points, np.zeros(3000), to_tip, factor * slope * np.linalg.norm(to_tip, axis=1)]
        )
        return np.array([escapes(horizon, *ray) for ray in rays.astype(np.float32)])

    assert not let_go(0.98).any()
    assert let_go(2.0).mean() > 0.2


def test_a_plane_has_no_horizon():
    horizon = find_horizon(np.zeros((3, 5)), 1.0, 2.0)
    assert escapes(horizon, *np.float32([0.5, 0.7, 0.0, 1.0, 0.0, 0.01]))
    assert not escapes(horizon, *np.float32([0.5, 0.7, 0.0, 1.0, 0.0, -0.01]))


def test_nobody_is_let_go_beside_a_wall_too_steep_to_tell():
    z = np.zeros((64, 64))
    z[32:] = 1.0
    horizon = find_horizon(z, 1.0, 1.0)
    assert not escapes(horizon, *np.float32([0.47, 0.5, 0.0, 0.01, 0.0, 1.0]))
    assert escapes(horizon, *np.float32([0.47, 0.5, 0.0, -0.7, 0.0, 0.7 * 3.0]))  # the other is 0.47 away


@pytest.mark.parametrize(
    "material", [Mirror(), Conductor((0.2,), (3.9,)), Lambert((0.6,))], ids=lambda m: type(m).__name__
)
@pytest.mark.parametrize("name", SURFACES)
def test_paths_end_the_same_to_the_bit(name, material):
    tile = tile_of(name)
    with_horizon, without = (Paths(tile, material, 50.0, horizon=h) for h in (True, False))
    assert with_horizon.rays < without.rays
    for field in ("exits", "weight", "bounces", "status", "absorbed"):
        assert np.array_equal(getattr(with_horizon, field), getattr(without, field)), field


@pytest.mark.parametrize(
    ("surface", "paths", "expected"),
    [
        ({"kind": "gaussian", "alpha": 0.5, "samples": 64, "size": 8}, 100, False),
        ({"kind": "gaussian", "alpha": 0.5, "samples": 64, "size": 8}, 100_000, True),
        ({"kind": "v_groove", "slope_deg": 40.0}, 100, True),
    ],
    ids=["few paths", "many paths", "one tile for all batches"],
)
def test_where_it_pays(surface, paths, expected):
    tracer = Tracer(parse_specimen({"surface": surface, "material": {"kind": "mirror"}}), 0, paths)
    assert (tracer.realise(0).scene.horizon is not NO_HORIZON) == expected


def test_heights_and_widths_are_in_one_unit():
    """A field twice as wide and twice as high has the same slopes."""
    tile: HeightField = tile_of("smooth")
    z = tile.heights / tile.size[0]
    one, two = find_horizon(z, 1.0, 1.0), find_horizon(2.0 * z, 2.0, 2.0)
    assert np.abs(one.slopes.astype(int) - two.slopes).max() <= 1
