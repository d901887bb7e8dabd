import numpy as np
import pytest

from microgeometry.errors import InputError
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
    ],
)
def test_bad_keys(specimen_of, keys, message):
    with pytest.raises(InputError, match=message):
        specimen_of("spheres", **keys)
