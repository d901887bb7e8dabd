import numpy as np
import pytest

from microgeometry.errors import InputError


@pytest.mark.parametrize("slope_deg", [0, 10, 45, 85, 89.9])
def test_walls_have_the_slope_asked_for(tile_of, slope_deg):
    tile = tile_of("v_groove", slope_deg=slope_deg, size=2, units="nm")
    normals, _ = tile.facets()
    slope = np.deg2rad(slope_deg)
    # Going from the ridge at x = 0 the surface falls: the first wall looks to +x, the second to -x.
    np.testing.assert_allclose(sorted(normals[:, 0]), np.repeat((-1, 1), 2) * np.sin(slope), atol=1e-14)
    np.testing.assert_allclose(normals[0], (np.sin(slope), 0.0, np.cos(slope)), atol=1e-14)
    stats = tile.statistics()
    # alpha^2 = <hx^2 + 0>; area 1/cos; depth (period/2) tan, a triangle wave's rms is depth / sqrt(12).
    assert stats.alpha == pytest.approx(np.tan(slope), abs=1e-15)
    assert stats.area_ratio == pytest.approx(1 / np.cos(slope))
    assert stats.peak_to_valley == pytest.approx(1e-9 * np.tan(slope))
    assert stats.rms_height == pytest.approx(1e-9 * np.tan(slope) / np.sqrt(12))


def test_ridge_at_zero_valley_in_the_middle(tile_of):
    tile = tile_of("v_groove", slope_deg=30)
    assert tile.heights.shape == (2, 1)
    assert tile.heights[0, 0] > tile.heights[1, 0]


@pytest.mark.parametrize("slope_deg", [-1, 90, float("nan"), "30", True])
def test_bad_slope(tile_of, slope_deg):
    with pytest.raises(InputError, match=r"\[surface\] slope_deg = .*at least 0 and at most 89.9"):
        tile_of("v_groove", slope_deg=slope_deg)
