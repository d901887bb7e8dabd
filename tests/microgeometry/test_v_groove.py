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


def test_orientation_is_the_instruments_business(tile_of):
    fixed, turned = (tile_of("v_groove", slope_deg=30, orientation=word) for word in ("fixed", "random"))
    np.testing.assert_array_equal(fixed.heights, turned.heights)
    with pytest.raises(InputError, match="must be one of 'fixed', 'random'"):
        tile_of("v_groove", slope_deg=30, orientation="x")


def test_slopes_are_drawn_from_the_normal_distribution(specimen_of):
    surface = specimen_of("v_groove", slope_deg=40, slope_std_deg=5).surface
    assert surface.is_random
    assert not specimen_of("v_groove", slope_deg=40).surface.is_random
    slopes = []
    for seed in range(20):
        tile = surface.realise(seed)
        hx, hy = tile.slopes()
        assert not hy.any()
        # Both walls of a groove are inclined alike, and all ridges are at height 0.
        np.testing.assert_allclose(hx[:, 0::2], -hx[:, 1::2], rtol=1e-9)
        assert not tile.heights[0::2].any()
        slopes.append(np.rad2deg(np.arctan(-hx[0, 0::2, 0])))
    slopes = np.concatenate(slopes)
    n = len(slopes)
    assert n == 20 * 256
    # Standard errors of the mean and of the standard deviation: 0.07 and 0.05 degrees.
    assert abs(slopes.mean() - 40) < 4 * 5 / np.sqrt(n)
    assert abs(slopes.std() - 5) < 4 * 5 / np.sqrt(2 * n)
    assert surface.realise(3).heights.tobytes() == surface.realise(3).heights.tobytes()


@pytest.mark.parametrize("slope_deg", [0, 89.9])
def test_drawn_slopes_stay_within_what_is_allowed(tile_of, slope_deg):
    hx, _ = tile_of("v_groove", slope_deg=slope_deg, slope_std_deg=30).slopes()
    assert np.rad2deg(np.arctan(np.abs(hx))).max() <= 89.9
    assert (hx[0, 0::2] <= 0).all()


@pytest.mark.parametrize("slope_deg", [-1, 90, float("nan"), "30", True])
def test_bad_slope(tile_of, slope_deg):
    with pytest.raises(InputError, match=r"\[surface\] slope_deg = .*at least 0 and at most 89.9"):
        tile_of("v_groove", slope_deg=slope_deg)
