import numpy as np
import pytest
from scipy import stats

from microgeometry.errors import InputError
from tests.microgeometry.conftest import assert_drawn_from


@pytest.mark.parametrize("slope_deg", [0, 5, 45, 85, 89.9])
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


def drawn_slopes(surface, seeds):
    """Slopes of all grooves, degrees, a row for each seed."""
    assert surface.is_random
    slopes = []
    for seed in seeds:
        tile = surface.realise(seed)
        hx, hy = tile.slopes()
        assert not hy.any()
        # Both walls of a groove are inclined alike, all grooves are of one width, all ridges at height 0.
        np.testing.assert_allclose(hx[:, 0::2], -hx[:, 1::2], rtol=1e-9)
        assert not tile.heights[0::2].any()
        assert tile.heights.shape == (128, 1)
        slopes.append(np.rad2deg(np.arctan(-hx[0, 0::2, 0])))
    return np.array(slopes)


@pytest.mark.parametrize(("mean", "std"), [(40, 5), (0, 20), (80, 10)])
def test_slopes_are_drawn_from_the_normal_distribution(specimen_of, mean, std):
    surface = specimen_of("v_groove", slope_deg=mean, slope_std_deg=std).surface
    slopes = drawn_slopes(surface, range(100))
    wrong = (
        stats.norm(mean, 1.03 * std) if mean < 80 else stats.norm(mean, 1.1 * std)
    )  # half cut off: less sharp
    assert_drawn_from(slopes, stats.norm(mean, std).pdf, wrong.pdf, 0, 89.9)
    if mean == 40:
        assert slopes.mean() == pytest.approx(40, abs=0.02)
        assert slopes.std() == pytest.approx(5, abs=0.02)
    assert surface.realise(3).heights.tobytes() == surface.realise(3).heights.tobytes()
    assert not specimen_of("v_groove", slope_deg=mean, slope_std_deg=0).surface.is_random


@pytest.mark.parametrize("std", [10, 30, 60])
def test_oren_nayar_slopes(specimen_of, std):
    # The slope-area distribution of the 1994 paper: projected area per solid angle goes as exp(-theta^2 / (2 std^2)).
    surface = specimen_of("v_groove", distribution="oren_nayar", slope_std_deg=std).surface
    slopes = drawn_slopes(surface, range(100))

    def density(std):
        return lambda t: np.sin(np.deg2rad(t)) * np.exp(-((t / std) ** 2) / 2)

    # Of 60 degrees much lies beyond 90, where it cannot be seen.
    wrong = density((1.03 if std < 60 else 1.1) * std)
    assert_drawn_from(slopes, density(std), wrong, 0, 90)


def test_oren_nayar_slopes_give_their_constant(specimen_of):
    # Light and eye along the normal, single reflection: each facet, cos long in projection, contributes cos^2,
    # so f pi / rho = <cos theta>, over projected area. Their fit of it is C1 = 1 - 0.5 s^2 / (s^2 + 0.33), good
    # to some 0.02; without the factor sin(theta) in the distribution <cos theta> would be 0.07 higher.
    for std in (20, 30, 40):
        surface = specimen_of("v_groove", distribution="oren_nayar", slope_std_deg=std).surface
        squared = np.deg2rad(std) ** 2
        mean = np.cos(np.deg2rad(drawn_slopes(surface, range(40)))).mean()
        assert mean == pytest.approx(1 - 0.5 * squared / (squared + 0.33), abs=0.025)
    flat = specimen_of("v_groove", distribution="oren_nayar", slope_std_deg=0).surface.realise(0)
    assert not flat.heights.any()


@pytest.mark.parametrize("name", ["beckmann", "ggx"])
def test_grooves_from_a_distribution_of_normals_are_those_of_ndf(tile_of, tmp_path, name):
    # Whose distributions test_ndf tests.
    groove, ndf = (tile_of(kind, 7, distribution=name, alpha=0.4) for kind in ("v_groove", "ndf"))
    np.testing.assert_array_equal(groove.heights, ndf.heights)
    (tmp_path / "d.csv").write_text("30,1\n31,1\n")
    slopes = np.rad2deg(np.arctan(np.abs(tile_of("v_groove", distribution="d.csv").slopes()[0])))
    assert slopes.min() >= 30
    assert slopes.max() <= 31


@pytest.mark.parametrize("slope_deg", [-1, 90, float("nan"), "30", True])
def test_bad_slope(tile_of, slope_deg):
    with pytest.raises(InputError, match=r"\[surface\] slope_deg = .*at least 0 and at most 89.9"):
        tile_of("v_groove", slope_deg=slope_deg)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, "slope_deg: missing"),
        ({"slope_std_deg": 20}, 'give the mean slope beside slope_std_deg, or distribution = "oren_nayar"'),
        ({"slope_deg": 20, "slope_std_deg": 31}, "at least 0 and at most 30"),
        ({"slope_deg": 20, "alpha": 0.3}, "is of a distribution"),
        ({"slope_deg": 20, "distribution": "ggx"}, "not both"),
        ({"distribution": "ggx", "slope_std_deg": 20}, "the distribution 'ggx' has none"),
        ({"distribution": "oren_nayar", "alpha": 1}, "the distribution 'oren_nayar' has none"),
        ({"distribution": "oren_nayar"}, "slope_std_deg: missing"),
        ({"distribution": "oren_nayar", "slope_std_deg": 61}, "at most 60"),
        ({"distribution": "oren-nayar"}, "did you mean 'oren_nayar'"),
    ],
)
def test_bad_keys(specimen_of, keys, message):
    with pytest.raises(InputError, match=message):
        specimen_of("v_groove", **keys)
