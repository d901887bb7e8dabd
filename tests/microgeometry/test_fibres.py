import numpy as np
import pytest
from scipy.spatial import cKDTree

from microgeometry.errors import InputError
from tests.microgeometry.conftest import assert_closed, assert_height_field


@pytest.mark.parametrize("segments", [8, 64])
def test_surface_is_closed_and_covers_the_tile_once(tile_of, segments):
    for seed in range(5):
        tile = tile_of("fibres", seed, segments=segments)
        assert_closed(tile)
        assert_height_field(tile)


def enclosed(tile):
    """Volume within the closed bodies above the plane (labelled 1), and their surface."""
    normals, areas = tile.facets()
    body = tile.labels == 0
    heights = tile.vertices[tile.faces, 2].mean(axis=1)
    return np.sum((heights * normals[:, 2] * areas)[body]), areas[body].sum()


@pytest.mark.parametrize("pitch", [1.01, 3])
def test_parallel_fibres_apart_lie_on_a_plane(tile_of, pitch):
    for seed in range(3):
        tile = tile_of("fibres", seed, pitch=pitch, units="m")
        assert_closed(tile)
        assert tile.size == pytest.approx((2 * pitch, 2))
        np.testing.assert_array_equal(tile.labels, (tile.vertices[tile.faces, 2] == 0).all(axis=1))
        x, _, z = tile.vertices[tile.vertices[:, 2] > 0].T
        np.testing.assert_allclose(np.hypot(x - pitch, z - 1.001), 1, rtol=1e-12)
        # A polygon of 128 sides; positive, so the faces look out.
        volume, area = enclosed(tile)
        assert volume == pytest.approx(2 * 64 * np.sin(2 * np.pi / 128), rel=1e-12)
        assert area == pytest.approx(2 * 256 * np.sin(np.pi / 128), rel=1e-12)
        assert tile.facets()[0][tile.labels == 1, 2].min() == 1


def peirce_axis(pitch, bend):
    """Points of the axis of a fibre along x in Peirce's geometry, highest at x = 0, and its length.

    From the middle between two crossings to where it bends, the fibre is straight and tangent to the circle
    of radius `bend` about the other fibre's axis: the angle follows from the triangle between the two.
    """
    # Half a straight part is the leg of a right triangle, whose hypotenuse is from the middle (0, 0) between
    # crossings to the other fibre's axis, (pitch / 2, bend / 2) away.
    far = np.hypot(pitch, bend) / 2
    straight = np.sqrt(far**2 - bend**2)
    turn = np.arcsin(bend / far) - np.arctan(bend / pitch)
    arc = np.linspace(0, turn, 200)
    x = np.append(bend * np.sin(arc), np.linspace(bend * np.sin(turn), pitch / 2, 200))
    z = np.append(bend * (np.cos(arc) - 0.5), np.linspace(bend * (np.cos(turn) - 0.5), 0, 200))
    x = np.concatenate((x, pitch - x, pitch + x, 2 * pitch - x))
    z = np.concatenate((z, -z, -z, z))
    return np.column_stack((x, np.zeros(len(x)), z)), 4 * (bend * turn + straight)


@pytest.mark.parametrize("pitch", [1.75, 2, 6])
def test_plain_weave(tile_of, pitch):
    segments = 16
    # Touching but for the gap and for a chord's height over its arc.
    bend = 2 * (1.001 + (np.pi / segments) ** 2 / 8)
    axis, length = peirce_axis(2 * pitch, bend)
    axes = []
    for k in range(
        4
    ):  # weft at y = 0 and one pitch, then warp; of both the one above where the other is below
        points = axis * (1, 1, -1 if k in (1, 2) else 1) + (0, (k % 2) * 2 * pitch, 0)
        points = points if k < 2 else points[:, [1, 0, 2]]
        shifts = 4 * pitch * np.array([(a, b, 0) for a in (-1, 0, 1) for b in (-1, 0, 1)])
        axes.append(cKDTree((points[:, None] + shifts).reshape(-1, 3)))
    tile = tile_of("fibres", 3, weave="plain", pitch=pitch, segments=segments, units="m")
    assert_closed(tile)
    assert tile.size == pytest.approx((4 * pitch, 4 * pitch))
    normals, areas = tile.facets()
    bodies = tile.faces[tile.labels == 0]
    # All vertices are on one fibre and in none, and no facet is within another fibre than its own.
    corners = tile.vertices[np.unique(bodies)]
    distances = np.array([tree.query(corners)[0] for tree in axes])
    # (A vertex at a face of the tile may be where an edge was cut, within the round fibre.)
    within = ((corners[:, :2] > 0) & (corners[:, :2] < tile.size)).all(axis=1)
    np.testing.assert_allclose(distances.min(axis=0)[within], 1, atol=1e-4)
    middles = tile.vertices[bodies].mean(axis=1)
    assert (np.sum([tree.query(middles)[0] < 1 for tree in axes], axis=0) <= 1).all()
    # Below all of them the plane, all of it one.
    lowest = tile.vertices[:, 2].min()
    assert lowest < corners[:, 2].min() < lowest + 0.01
    np.testing.assert_array_equal(tile.labels, (tile.vertices[tile.faces, 2] == lowest).all(axis=1))
    assert areas[tile.labels == 1].sum() == pytest.approx(16 * pitch**2)
    assert normals[tile.labels == 1, 2].min() == 1
    # Pappus: a bent fibre has the volume and the surface of a straight one; the polyhedron a little less.
    volume, area = enclosed(tile)
    assert volume == pytest.approx(4 * np.pi * length, rel=0.015)
    assert area == pytest.approx(8 * np.pi * length, rel=0.015)


def test_fibre_is_round(tile_of):
    tile = tile_of("fibres", radius=3, units="nm")
    assert tile.size == pytest.approx((6e-9, 6e-9))
    x, _, z = tile.vertices.T
    np.testing.assert_allclose(np.hypot(x - 3e-9, z), 3e-9, rtol=1e-12)
    assert (z >= 0).all()
    stats = tile.statistics()
    assert stats.n_facets == 2 * 65
    # Half a circle over its diameter, pi / 2; each chord is (pi / 64)^2 / 24 shorter than its arc.
    assert stats.area_ratio == pytest.approx(np.pi / 2 * (1 - (np.pi / 64) ** 2 / 24), rel=3e-6)
    assert stats.peak_to_valley == pytest.approx(3e-9, rel=(np.pi / 64) ** 2 / 8)


def test_facets_take_every_inclination(tile_of):
    # Equal angles hold equal areas: in ten bins of 18 degrees a tenth each, over the seeds.
    shares = []
    for seed in range(40):
        normals, areas = tile_of("fibres", seed).facets()
        assert np.abs(normals[:, 1]).max() < 1e-12
        angles = np.arctan2(normals[:, 2], normals[:, 0])
        shares.append(np.histogram(angles, 10, (0, np.pi), weights=areas)[0] / areas.sum())
    std_error = np.std(shares, axis=0, ddof=1) / np.sqrt(40)
    assert (std_error < 0.002).all()
    assert (np.abs(np.mean(shares, axis=0) - 0.1) < 4 * std_error + 1e-6).all()


@pytest.mark.parametrize("keys", [{}, {"pitch": 2}, {"weave": "plain"}])
def test_seed_is_the_realisation(specimen_of, keys):
    surface = specimen_of("fibres", **keys).surface
    first, again, other = (surface.realise(seed).vertices for seed in (7, 7, 8))
    assert first.tobytes() == again.tobytes() != other.tobytes()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"radius": 0}, "above 0"),
        ({"segments": 7}, "at least 8"),
        ({"size": 1}, "unknown key"),
        ({"pitch": 0.9}, "at least 1 and at most 10"),
        ({"weave": "plain", "pitch": 1.7}, "at least 1.75 and at most 10"),
        ({"weave": "plain", "segments": 15}, "at least 16"),
        ({"weave": "twill"}, "must be one of 'parallel', 'plain'"),
    ],
)
def test_bad_keys(specimen_of, keys, message):
    with pytest.raises(InputError, match=message):
        specimen_of("fibres", **keys)
