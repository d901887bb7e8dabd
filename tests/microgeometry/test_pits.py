import numpy as np
import pytest

from microgeometry.errors import InputError
from microgeometry.surfaces.caps import scatter
from microgeometry.surfaces.periodic import cut_to_tile
from tests.microgeometry.conftest import assert_closed, assert_height_field

ARRANGED = [("square", 0.78), ("square", 0.3), ("hexagonal", 0.9), ("hexagonal", 0.05), ("random", 0.45)]


@pytest.mark.parametrize("depth", [1, 0.3, 0.01])
@pytest.mark.parametrize(("arrangement", "cover"), ARRANGED)
def test_surface_is_closed_and_covers_the_tile_once(tile_of, arrangement, cover, depth):
    keys = {"arrangement": arrangement, "cover": cover, "depth": depth, "segments": 24}
    for seed in range(3):
        tile = tile_of("pits", seed, **keys)
        assert_closed(tile)
        assert_height_field(tile)


@pytest.mark.parametrize("depth", [1, 0.3])
@pytest.mark.parametrize(("arrangement", "cover"), ARRANGED)
def test_cover_depth_and_area(tile_of, arrangement, cover, depth):
    tile = tile_of("pits", arrangement=arrangement, cover=cover, depth=depth, radius=2, units="nm")
    stats = tile.statistics()
    assert stats.peak_to_valley == pytest.approx(2e-9 * depth, rel=2e-3)
    assert tile.vertices[:, 2].max() == 0
    # What is not plane: the polygons in the discs, (2 pi / 64)^2 / 6 = 0.16 % less at 64 segments. A crossing
    # with a face of the tile adds a vertex, or two to take the place of an even one: a little either way.
    areas = tile.facets()[1]
    plane = areas[(tile.vertices[tile.faces, 2] == 0).all(axis=1)].sum() / (tile.size[0] * tile.size[1])
    assert 1 - plane == pytest.approx(cover * (1 - 0.0016), rel=3e-4)
    # A cap 2 pi R h over a disc pi (2 R h - h^2), h = depth R: 2 / (2 - depth) of its base. The polyhedron
    # lacks what its rim lacks, and O(segments^-2) of its curvature: 0.2 % to 0.8 %, as the rings fall.
    excess = cover * (2 / (2 - depth) - 1)
    assert stats.area_ratio - 1 == pytest.approx(excess * (1 - 0.005), rel=0.003)


@pytest.mark.parametrize("kind", ["pits", "bosses"])
@pytest.mark.parametrize(("arrangement", "cover"), ARRANGED)
def test_labels_tell_the_plane_from_the_caps(tile_of, kind, arrangement, cover):
    # Also where caps and plane are cut at the faces of the tile. A facet of the plane is level at z = 0, which
    # no facet of a cap is.
    for seed in range(3):
        tile = tile_of(kind, seed, arrangement=arrangement, cover=cover, segments=16)
        level = (tile.vertices[tile.faces, 2] == 0).all(axis=1)
        assert tile.labels.dtype == np.uint8
        np.testing.assert_array_equal(tile.labels, level)


def test_polyhedron_converges_to_the_sphere(tile_of):
    # Twice the segments: a quarter of the error, within the scatter of the facets drawn.
    errors = []
    for segments in (16, 32, 64):
        keys = {"cover": 0.5, "arrangement": "square", "segments": segments}
        areas = [tile_of("pits", seed, **keys).statistics().area_ratio for seed in range(20)]
        errors.append(1.5 - np.mean(areas))
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.15)
    assert errors[1] / errors[2] == pytest.approx(4, rel=0.15)


def test_vertices_are_on_the_sphere(tile_of):
    tile = tile_of("pits", cover=0.4, arrangement="square", depth=0.6, units="m")
    inside = tile.vertices[tile.vertices[:, 2] < 0]
    centre = [tile.size[0] / 2, tile.size[1] / 2, 0.4]
    np.testing.assert_allclose(np.linalg.norm(inside - centre, axis=1), 1, rtol=1e-12)


def test_random_centres_keep_apart_and_are_spread_evenly():
    # Discs of diameter 1 on 0.42 of a periodic square. Over many draws every ninth of it holds a ninth.
    side = np.sqrt(36 * np.pi / 4 / 0.42)
    counts = []
    for seed in range(100):
        centres = scatter(np.random.default_rng(seed), 36, 1.0, side)
        apart = np.abs(centres[:, None] - centres)
        distances = np.linalg.norm(np.minimum(apart, side - apart), axis=2) + 9 * np.eye(36)
        assert distances.min() >= 1
        counts.append(np.histogram2d(*centres.T, bins=3, range=[[0, side], [0, side]])[0])
    std_error = np.std(counts, axis=0, ddof=1) / np.sqrt(100)
    assert (std_error < 0.15).all()
    assert (np.abs(np.mean(counts, axis=0) - 4) < 4 * std_error).all()


def test_seed_is_the_realisation(specimen_of):
    surface = specimen_of("pits", cover=0.3, arrangement="random", segments=16).surface
    first, again, other = (surface.realise(seed) for seed in (7, 7, 8))
    assert first.vertices.tobytes() == again.vertices.tobytes()
    assert first.vertices.shape != other.vertices.shape or not np.allclose(first.vertices, other.vertices)


@pytest.mark.parametrize("apex", [0.25, 0.0])  # 0: a corner on the plane of the cut
def test_cut_brings_in_what_stands_out(apex):
    # A triangle over the corner of a unit tile: its area and normal stay, all of it is inside. So does its
    # label, and that of one which is not cut.
    corner = np.array([(-0.5, -0.25, 0.0), (0.5, -0.25, 1.0), (apex, 0.5, 0.0)])
    inside = np.array([(0.75, 0.5, 0.0), (0.875, 0.5, 0.0), (0.75, 0.75, 0.0)])
    faces = np.array([(0, 1, 2), (3, 4, 5)])
    both = cut_to_tile(np.vstack((inside, corner)), faces, (1.0, 1.0), np.uint8([0, 1]))
    assert sorted(both.labels) == [0] + (len(both.faces) - 1) * [1]
    assert (both.vertices[both.faces[both.labels == 0][0]].mean(axis=0) == inside.mean(axis=0)).all()
    tile = cut_to_tile(corner, np.array([(0, 1, 2)]), (1.0, 1.0))
    assert tile.labels is None
    assert (tile.vertices[:, :2] >= 0).all()
    assert (tile.vertices[:, :2] <= 1).all()
    normals, areas = tile.facets()
    normal = np.cross(corner[1] - corner[0], corner[2] - corner[0])
    np.testing.assert_allclose(areas @ normals, normal / 2, rtol=1e-14)
    np.testing.assert_allclose(normals, np.tile(normal / np.linalg.norm(normal), (len(areas), 1)), atol=1e-14)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, "cover: missing"),
        ({"cover": 0.91}, "at least 0.01 and at most 0.9"),
        ({"cover": 0.8, "arrangement": "square"}, "at most 0.78"),
        ({"cover": 0.5, "arrangement": "random"}, "at most 0.45"),
        ({"cover": 0.5, "arrangement": "hexagon"}, "did you mean 'hexagonal'"),
        ({"cover": 0.5, "depth": 1.1}, "depth = 1.1: must be a finite number, at least 0.001 and at most 1"),
        ({"cover": 0.5, "radius": 0}, "above 0"),
        ({"cover": 0.5, "size": 1}, "size = 1: unknown key"),
    ],
)
def test_bad_keys(specimen_of, keys, message):
    with pytest.raises(InputError, match=message):
        specimen_of("pits", **keys)
