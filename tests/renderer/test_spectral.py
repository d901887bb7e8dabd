"""Materials of many wavelengths, rendered through the CIE's observer."""

from dataclasses import replace

import numpy as np
import pytest

from fitting.result import Fit, FittedLobe
from gonio.bench.peak import tabulated
from gonio.core.directions import direction
from gonio.table.peak import grid_of
from microgeometry.colour import rgb_matrix
from microgeometry.errors import InputError
from renderer.scene import Material
from renderer.spectral import rgb_table, rgb_weights
from tests.renderer.scenes import assert_within, constant, lambert_table, mean, simple, square

NM = (650.0, 450.0, 550.0, 500.0, 600.0)  # in no order
ALBEDO = (0.8, 0.1, 0.5, 0.2, 0.7)
NAMES = tuple(f"{nm:g} nm" for nm in NM)


def expected():
    order = np.argsort(NM)
    return rgb_matrix(np.array(NM)[order], "D65") @ np.array(ALBEDO)[order]


def spectral_table():
    grey = lambert_table(1.0, tint=(1.0,))
    return grey.replace(
        values=grey.values * ALBEDO,
        row_albedo=grey.row_albedo * ALBEDO,
        specular=np.zeros(()),
        specular_std_error=np.zeros(()),
        albedo_std_error=np.zeros(()),
        channels=NAMES,
        wavelengths_nm=NM,
    )


@pytest.mark.parametrize("kind", ["tabulated", "analytic"])
def test_a_spectrum_is_rendered_in_its_colour(kind):
    lobe = FittedLobe("lambert", {}, {"albedo": dict(zip(NAMES, ALBEDO, strict=True))})
    values = {"table": spectral_table(), "fit": Fit("lambert", (lobe,), NAMES, NM)}
    scene = simple([square(material=Material(kind, values))], constant())
    radiance, error = mean(scene, 16)
    assert_within(radiance, expected(), error)


def test_a_spectrum_that_is_white_is_white():
    assert rgb_weights(NAMES, NM, "") @ np.ones(5) == pytest.approx(np.ones(3))


def test_rgb_and_grey_stay_as_they_are():
    for table in (lambert_table(0.5), lambert_table(0.5, tint=(1.0,))):
        assert rgb_table(table, "") is table
    assert rgb_weights(("R", "G", "B"), (630, 532, 467), "") is None
    assert rgb_weights(("a", "b", "c"), None, "") is None


def test_a_colour_outside_the_gamut_is_cut_off():
    table = spectral_table()
    only = np.array([0, 0, 0, 1, 0])  # 500 nm alone: red would be negative
    rgb = rgb_table(table.replace(values=table.values * only, row_albedo=table.row_albedo * only), "")
    assert rgb.values[..., 0].max() == 0
    assert rgb.values[..., 1].min() > 0


@pytest.mark.parametrize("channels", [("R", "G", "B"), ("a", "b", "c")])
def test_a_delta_term_outside_the_gamut_is_cut_off(channels):
    """A soap film's red at 60 degrees; what else the table reflects stays."""
    table = lambert_table(0.5)
    outside = np.array([-0.04, 0.09, 0.2])
    table = table.replace(
        specular=np.broadcast_to(outside, table.specular.shape),
        row_albedo=table.row_albedo + outside,
        channels=channels,
    )
    rgb = rgb_table(table, "")
    np.testing.assert_array_equal(rgb.specular, np.maximum(table.specular, 0))
    np.testing.assert_allclose(rgb.row_albedo - rgb.specular, table.row_albedo - table.specular)
    wi, wo = direction(0.5), direction(0.7, 1.0)
    np.testing.assert_allclose(rgb.eval(wi, wo), table.eval(wi, wo), rtol=1e-6)


def test_a_highlight_of_its_own_is_mixed_like_the_rest():
    grey = tabulated(0.02, np.arange(0, 91, 15), grid_of([0.02], 1.0))
    table = grey.replace(
        **{name: getattr(grey, name) * ALBEDO for name in ("values", "row_albedo", "specular")},
        **dict.fromkeys(("albedo_std_error", "specular_std_error"), np.zeros(())),
        std_error=None,
        channels=NAMES,
        wavelengths_nm=NM,
        peak=replace(grey.peak, values=grey.peak.values * ALBEDO),
    )
    wi, wo = direction(0.5), direction(0.51, np.pi)
    np.testing.assert_allclose(rgb_table(table, "").eval(wi, wo), expected() * grey.eval(wi, wo), rtol=1e-5)


def test_channels_that_are_no_colours_are_refused():
    with pytest.raises(InputError, match=r"T\.h5: has 4 channels without wavelengths; one"):
        rgb_weights(("a", "b", "c", "d"), None, "T.h5")
