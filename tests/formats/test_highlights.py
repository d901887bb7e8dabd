"""Measured highlights narrower than the cells: found, and resampled on a grid of their own."""

from __future__ import annotations

import numpy as np
import pytest

from gonio import formats
from gonio.bench.peak import relative_error, rough_metal
from gonio.core.directions import direction
from gonio.formats import merl
from gonio.formats.cells import average_cells, table_of
from gonio.formats.highlights import highlight_alpha, resampling_error, resolved
from gonio.table.table import Table

pytestmark = pytest.mark.compiled

ROWS = 30


def metal(alpha):
    """A rough metal as files give it: from angles to f."""
    return lambda theta_i, theta_o, phi: rough_metal(direction(theta_i), direction(theta_o, phi), alpha)[
        :, None
    ]


def sampled(brdf, rows=ROWS):
    """What a reader makes of it: cells of 3 degrees."""
    edges = np.linspace(0, np.pi / 2, rows + 1)
    middles, sectors = 0.5 * (edges[1:] + edges[:-1]), np.linspace(0, np.pi, 2 * rows + 1)

    def look(row, theta_o, phi):
        return brdf(float(middles[row]), theta_o, phi), np.ones(len(phi), bool)

    values, gaps = average_cells(look, rows, edges, sectors, 1)
    return table_of(values, gaps, middles, edges, sectors, ("Y",), theta_i_edges=edges)


@pytest.mark.parametrize("alpha", [0.003, 0.02, 0.1, 0.4])
def test_the_width_is_found(alpha):
    assert highlight_alpha(metal(alpha)) == pytest.approx(alpha, rel=0.12)


def slopes(theta_i, theta_o, phi):
    """Of the half vector, along the plane of incidence and across it."""
    x, y, z = np.moveaxis(direction(theta_i) + direction(theta_o, phi), -1, 0)
    return x / z, y / z


def test_what_is_no_highlight_is_wide():
    assert highlight_alpha(lambda theta_i, theta_o, phi: np.ones((len(phi), 1))) > 0.4
    # darkest in the mirror direction
    assert highlight_alpha(lambda *angles: np.hypot(*slopes(*angles))[:, None] ** 2) == 1.0


@pytest.mark.parametrize("alpha", [0.005, 0.02])
def test_a_narrow_highlight_gets_a_grid_of_its_own(alpha):
    table = sampled(metal(alpha))
    fine = resolved(table, metal(alpha))
    for degrees in (20, 45, 70):
        assert relative_error(table, alpha, degrees) > 0.5
        assert relative_error(fine, alpha, degrees) < 0.03
    # the cells hold the same light
    areas = fine.projected_solid_angles
    energy = np.einsum("isqc,sq->ic", fine.peak.values, fine.peak.areas)
    np.testing.assert_allclose(fine.row_albedo[:20], energy[:20], rtol=1e-3)
    np.testing.assert_allclose(np.einsum("irpc,rp->ic", fine.values, areas), fine.row_albedo, rtol=1e-12)


def test_wide_highlights_and_coarse_tables_stay_as_they_are():
    wide, narrow = sampled(metal(0.3)), sampled(metal(0.02), 20)
    assert resolved(wide, metal(0.3)) is wide
    assert resolved(narrow, metal(0.02)) is narrow
    # neither by what the table says alone, nor by the function alone
    assert resolved(wide, metal(0.02)) is wide
    fine = sampled(metal(0.02))
    assert resolved(fine, metal(0.3)) is fine


def spike(theta_i, theta_o, phi):
    """Near normal incidence five times as bright in the mirror direction, within a tenth of the width."""
    x, y = slopes(theta_i, theta_o, phi)
    more = 4 * np.exp(-((theta_i / 0.2) ** 2) - np.hypot(x, y) / 0.0012)
    return (np.exp(-(x**2 + y**2) / 0.012**2) * (1 + more) / np.cos(theta_i) / np.cos(theta_o))[:, None]


def streak(theta_i, theta_o, phi):
    """Eight times as wide across the plane of incidence."""
    x, y = slopes(theta_i, theta_o, phi)
    return (np.exp(-((x / 0.012) ** 2) - (y / 0.1) ** 2) / np.cos(theta_i) / np.cos(theta_o))[:, None]


@pytest.mark.parametrize(("brdf", "worst"), [(spike, 0.035), (streak, 0.045)])
def test_what_measured_highlights_have_besides(brdf, worst):
    assert resampling_error(resolved(sampled(brdf), brdf), brdf)[1] < worst


def test_the_error_of_resampling():
    """None for what cells hold exactly; of twice the values, 1; the grid of its own takes most of it away."""
    even = sampled(lambda theta_i, theta_o, phi: np.full((len(phi), 1), 0.2))
    assert resampling_error(even, lambda theta_i, theta_o, phi: np.full((len(phi), 1), 0.2))[1] < 1e-6
    half = resampling_error(even, lambda theta_i, theta_o, phi: np.full((len(phi), 1), 0.1))
    assert half[:2] == pytest.approx((1.0, 1.0), rel=1e-6)
    # weighted with the cosine: half of it beyond 60 degrees is a square of 1/8 of all, of which it keeps a quarter
    grazing = resampling_error(even, lambda theta_i, theta_o, phi: 0.1 * (2 - (theta_o > np.pi / 3))[:, None])
    assert grazing[0] == pytest.approx(np.sqrt((1 / 8) / (4 * 7 / 8 + 1 / 8)), rel=0.06)
    table = sampled(metal(0.02))
    before, after = (resampling_error(t, metal(0.02)) for t in (table, resolved(table, metal(0.02))))
    assert before[0] > 0.5
    assert after[0] < 0.02
    assert after[1] < 0.05


@pytest.mark.slow
def test_a_merl_file(tmp_path):
    """Bins of 0.01 degree at the mirror direction hold highlights that cells of a degree do not."""
    merl.write_function(lambda wi, wo: rough_metal(wi, wo, 0.01)[:, None], tmp_path / "t.binary")
    table = merl.read(tmp_path / "t.binary")
    assert table.peak is not None
    assert resampling_error(table, merl.brdf_of(tmp_path / "t.binary"))[0] < 0.12  # its steps
    assert resampling_error(table.replace(peak=None), merl.brdf_of(tmp_path / "t.binary"))[0] > 0.3


@pytest.mark.slow
def test_a_measured_one(real_data, tmp_path):
    """Light blue chrome: between cells of 1 degree the file's f was off by a third to all of it."""
    source = real_data / "rgl" / "chm_light_blue_rgb.bsdf"
    done = formats.convert(source, tmp_path / "t.h5")
    assert "differs from the file's by 1." in done.lost[-1]
    assert Table.load(tmp_path / "t.h5").peak is not None
