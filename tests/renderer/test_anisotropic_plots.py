"""Plots of anisotropic tables show what the tables say."""

import numpy as np
import pytest

from gonio.core.directions import direction
from gonio.core.jit import disabled
from renderer import anisotropic_plots
from tests.table.test_anisotropic import table_of

pytestmark = [pytest.mark.skipif(disabled, reason="needs compiled kernels"), pytest.mark.compiled]


@pytest.fixture(scope="module")
def table():
    return table_of(0.35, 0.15, n_phi=12, cells=17, theta_i=np.radians([0, 45, 75]))


def test_lobes_are_lines_for_each_azimuth(table):
    figure = anisotropic_plots.lobes(table)
    assert len(figure.axes) == 3
    panel = figure.axes[1]
    assert panel.get_title() == "theta_i = 45°"
    lines = {line.get_label(): line for line in panel.lines}
    assert list(lines) == ["phi_i = 0°", "phi_i = 30°", "phi_i = 60°", "phi_i = 90°"]
    x, y = lines["phi_i = 30°"].get_data()
    at = np.argmin(abs(x - 45))
    mirror = direction(np.radians(x[at]), np.radians(210))
    assert y[at] == pytest.approx(table.eval(direction(np.radians(45), np.radians(30)), mirror)[0])


def test_hemispheres_have_x_to_the_right(table):
    figure = anisotropic_plots.hemispheres(table)
    panel = figure.axes[0]
    picture = panel.images[0].get_array()
    # light from +x at 45 degrees leaves to -x: left, half way up
    i, j = np.unravel_index(np.nanargmax(np.ma.filled(picture, np.nan)), picture.shape)
    assert j < 0.25 * picture.shape[1]
    assert abs(i - picture.shape[0] / 2) < 0.1 * picture.shape[0]
    (light,) = panel.lines
    assert light.get_xdata()[0] == pytest.approx(np.sqrt(0.5))


def test_albedo_is_the_rows(table):
    panel = anisotropic_plots.albedo(table).axes[0]
    assert np.allclose(panel.lines[3].get_ydata(), table.row_albedo[:, 3, 0])
