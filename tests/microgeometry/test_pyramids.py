import numpy as np
import pytest

from microgeometry.errors import InputError
from tests.microgeometry.conftest import assert_closed, assert_height_field


@pytest.mark.parametrize("slope_deg", [0, 10, 54.7356, 89.9])
@pytest.mark.parametrize("arrangement", ["regular", "random"])
def test_every_facet_has_the_slope_asked_for(tile_of, arrangement, slope_deg):
    for seed in range(3):
        tile = tile_of("pyramids", seed, slope_deg=slope_deg, arrangement=arrangement)
        assert_closed(tile)
        assert_height_field(tile)
        normals = tile.facets()[0]
        slope = np.deg2rad(slope_deg)
        np.testing.assert_allclose(normals[:, 2], np.cos(slope), rtol=1e-9)
        # To +-x or +-y, never between.
        np.testing.assert_allclose(np.abs(normals[:, :2]).max(axis=1), np.sin(slope), atol=1e-9)
        stats = tile.statistics()
        assert stats.alpha == pytest.approx(np.tan(slope), abs=1e-12)
        assert stats.area_ratio == pytest.approx(1 / np.cos(slope))


def test_regular_pyramid(specimen_of):
    surface = specimen_of("pyramids", slope_deg=45, size=2, units="m").surface
    assert not surface.is_random
    tile = surface.realise(0)
    stats = tile.statistics()
    assert tile.size == (2, 2)
    # A top 1 above the base, the tile of 2 x 2: 8 triangles; rms of 1 - max(|x|, |y|) is 1 / sqrt(18).
    assert (stats.n_facets, stats.peak_to_valley) == (8, pytest.approx(1))
    assert stats.rms_height == pytest.approx(1 / np.sqrt(18))
    # A quarter of the area looks each way.
    normals, areas = tile.facets()
    for axis in (0, 1):
        for sign in (-1, 1):
            assert areas[sign * normals[:, axis] > 0.5].sum() / areas.sum() == pytest.approx(0.25)


def test_random_pyramids_have_random_heights_and_no_preferred_side(specimen_of):
    surface = specimen_of("pyramids", slope_deg=45, arrangement="random", units="m").surface
    assert surface.is_random
    sides, spread = [], []
    for seed in range(40):
        tile = surface.realise(seed)
        normals, areas = tile.facets()
        sides.append([areas[side > 0.5].sum() / areas.sum() for side in (*normals.T[:2], *-normals.T[:2])])
        # Heights are steps of 8 / 64.
        z = np.sort(tile.vertices[:, 2])
        spread.append(len(np.unique(np.round(z * 8))))
    assert tile.size == (8, 8)
    std_error = np.std(sides, axis=0, ddof=1) / np.sqrt(40)
    assert (std_error < 0.005).all()
    # Opposite sides of a closed surface are equal at one slope: what can differ is x from y.
    np.testing.assert_allclose(np.subtract(*np.transpose(sides)[[0, 2]]), 0, atol=1e-9)
    assert (np.abs(np.mean(sides, axis=0) - 0.25) < 4 * std_error).all()
    assert min(spread) > 6
    assert surface.realise(3).vertices.tobytes() == surface.realise(3).vertices.tobytes()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, "slope_deg: missing"),
        ({"slope_deg": 90}, "at least 0 and at most 89.9"),
        ({"slope_deg": 45, "arrangement": "square"}, "must be one of 'regular', 'random'"),
    ],
)
def test_bad_keys(specimen_of, keys, message):
    with pytest.raises(InputError, match=message):
        specimen_of("pyramids", **keys)
