import numpy as np
import pytest
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from microgeometry.errors import InputError
from microgeometry.surfaces.packing import pack
from tests.microgeometry.conftest import assert_closed


@pytest.mark.parametrize(
    ("arrangement", "cover"), [("square", 0.78), ("hexagonal", 0.9), ("hexagonal", 0.1), ("random", 0.45)]
)
def test_spheres_and_plane(tile_of, arrangement, cover):
    for seed in range(3):
        keys = {"arrangement": arrangement, "cover": cover, "subdivisions": 3}
        tile = tile_of("spheres", seed, **keys, radius=2, units="nm")
        assert_closed(tile)
        stats = tile.statistics()
        assert stats.peak_to_valley == pytest.approx(4e-9, rel=0.01)
        # The plane, and 4 pi R^2 for each pi R^2 covered. Seen from the centre an equilateral facet of
        # circumradius c stands for 1 + 5/8 c^2 of its area; 1280 of them, c^2 = 4 pi / 1280 * 4 / 27^0.5
        # = 0.0076, lack 0.47 %, a little more as they are not equal.
        assert stats.area_ratio == pytest.approx(1 + 4 * cover * (1 - 0.0047), rel=2e-4)
        normals, areas = tile.facets()
        # Of a closed body as much looks up as down: what is left is the plane.
        period = tile.size[0] * tile.size[1]
        np.testing.assert_allclose(areas @ normals / period, (0, 0, 1), atol=1e-9)
        # Half the projected area of the spheres looks up, and it is that of the discs.
        up = (normals[:, 2] > 0) & (tile.vertices[tile.faces, 2] > 0).any(axis=1)
        assert areas[up] @ normals[up, 2] / period == pytest.approx(cover, rel=0.01)
        # Nothing sinks into the plane.
        heights = np.sort(np.unique(tile.vertices[:, 2]))
        assert heights[0] == 0
        assert heights[1] > 1e-12
        np.testing.assert_array_equal(tile.labels, (tile.vertices[tile.faces, 2] == 0).all(axis=1))


def balls(tile):
    """Distances of the vertices from their centre, for each body wholly within the tile."""
    faces = tile.faces[tile.labels == 0]
    n, bodies = connected_components(
        coo_array((np.ones(len(faces)), (faces[:, 0], faces[:, 1])), shape=2 * [len(tile.vertices)])
    )
    for body in range(n):
        points = tile.vertices[bodies == body]
        inside = ((points[:, :2] > 0) & (points[:, :2] < tile.size)).all()
        if len(points) > 4 and inside:
            yield np.linalg.norm(points - points.mean(axis=0), axis=1)


@pytest.mark.parametrize(("fraction", "layers"), [(0.4, 4), (0.05, 2), (0.5, 1)])
def test_bed_of_spheres(tile_of, fraction, layers):
    keys = {"arrangement": "packed", "fraction": fraction, "layers": layers, "subdivisions": 2, "units": "m"}
    tile = tile_of("spheres", 3, **keys)
    assert_closed(tile)
    normals, areas = tile.facets()
    heights = tile.vertices[tile.faces, 2]
    np.testing.assert_array_equal(tile.labels, (heights == 0).all(axis=1))
    # Within the bed, whose tile is about 12 radii wide; a ball's facets look out.
    assert heights.max() <= 2 * layers + 0.002
    assert tile.size[0] == pytest.approx(12, abs=1)
    period = tile.size[0] * tile.size[1]
    volume = np.sum(heights.mean(axis=1) * normals[:, 2] * areas) / period
    # Volume and area are those of as many icospheres, whatever way they are turned or cut.
    sphere = trimesh.creation.icosphere(2, radius=1.0)
    assert volume / (2 * layers) == pytest.approx(fraction * sphere.volume / (4 / 3 * np.pi), rel=1e-6)
    surface = 3 * fraction * 2 * layers * sphere.area / (4 * np.pi)
    assert areas.sum() / period == pytest.approx(1 + surface, rel=1e-6)
    bodies = list(balls(tile))
    assert bodies
    for radii in bodies:
        np.testing.assert_allclose(radii, 1, rtol=1e-9)


@pytest.mark.parametrize(("fraction", "layers"), [(0.5, 1), (0.5, 3), (0.2, 2)])
def test_packed_spheres_overlap_nowhere(fraction, layers):
    touches = 0
    for seed in range(10):
        side, centres = pack(np.random.default_rng(seed), fraction, 2.0 * layers, 12.0, 1e-3)
        assert len(centres) * 4 / 3 * np.pi == pytest.approx(fraction * 2 * layers * side**2, rel=1e-12)
        apart = centres[:, None] - centres
        apart[..., :2] -= side * np.round(apart[..., :2] / side)
        distances = np.linalg.norm(apart, axis=2) + 9 * np.eye(len(centres))
        assert distances.min() > 2.001
        touches += np.count_nonzero(distances < 2.01)
        assert (centres[:, :2] >= 0).all()
        assert (centres[:, :2] < side).all()
        assert centres[:, 2].min() >= 1.001
        assert centres[:, 2].max() <= max(1.001, 2 * layers - 1)
    assert touches > 0


def test_bed_is_random_and_fills_its_tile_evenly(specimen_of):
    # Every fourth of the plane's two axes holds a fourth of the spheres, and so do the two halves of the depth.
    plan, depth = [], []
    for seed in range(60):
        side, centres = pack(np.random.default_rng(seed), 0.3, 6.0, 12.0, 1e-3)
        plan.append(np.histogram2d(*centres[:, :2].T, bins=2, range=[[0, side], [0, side]])[0] / len(centres))
        depth.append(np.mean(centres[:, 2] > 3))
    assert (np.abs(np.mean(plan, axis=0) - 0.25) < 4 * np.std(plan, axis=0, ddof=1) / np.sqrt(60)).all()
    assert abs(np.mean(depth) - 0.5) < 4 * np.std(depth, ddof=1) / np.sqrt(60)
    surface = specimen_of("spheres", arrangement="packed", subdivisions=1).surface
    first, again, other = (surface.realise(seed).vertices for seed in (7, 7, 8))
    assert first.tobytes() == again.tobytes() != other.tobytes()


def test_vertices_are_on_the_spheres_and_faces_look_out(tile_of):
    tile = tile_of("spheres", arrangement="square", cover=0.5, units="m")
    centre = np.array([tile.size[0] / 2, tile.size[1] / 2, 1.001])
    ball = (tile.vertices[tile.faces, 2] > 0).any(axis=1)
    corners = tile.vertices[tile.faces[ball]] - centre
    np.testing.assert_allclose(np.linalg.norm(corners, axis=2), 1, rtol=1e-12)
    assert (np.sum(corners.mean(axis=1) * tile.facets()[0][ball], axis=1) > 0.99).all()
    assert ball.sum() == 20 * 4**4


def test_seed_turns_the_spheres(specimen_of):
    surface = specimen_of("spheres", cover=0.5, subdivisions=1).surface
    first, again, other = (surface.realise(seed).vertices for seed in (7, 7, 8))
    assert first.tobytes() == again.tobytes() != other.tobytes()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, "cover: missing"),
        ({"cover": 0.8, "arrangement": "square"}, "at most 0.78"),
        ({"cover": 0.5, "subdivisions": 7}, "at most 6"),
        ({"cover": 0.5, "depth": 1}, "depth = 1: unknown key"),
        (
            {"cover": 0.5, "arrangement": "packed"},
            "cover = 0.5: unknown key.*allowed here: .*fraction, layers",
        ),
        ({"cover": 0.5, "layers": 2}, "layers = 2: unknown key"),
        ({"arrangement": "packed", "fraction": 0.51}, "at least 0.01 and at most 0.5"),
        ({"arrangement": "packed", "layers": 2.5}, "whole number, at least 1 and at most 20"),
    ],
)
def test_bad_keys(specimen_of, keys, message):
    with pytest.raises(InputError, match=message):
        specimen_of("spheres", **keys)
