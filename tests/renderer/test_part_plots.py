"""Plots of parts show what the parts hold."""

import numpy as np
import pytest

from gonio.table.parts import TRANSMISSION
from renderer import part_plots, plots
from tests.renderer.scenes import lambert_table
from tests.renderer.tables import with_parts


def lines(panel):
    return {line.get_label(): line.get_ydata() for line in panel.get_lines()}


def stack(panel):
    """Top of each layer of a stack plot by its name, in order."""
    return {area.get_label(): area.get_paths()[0].vertices[:, 1].max() for area in panel.collections}


def test_shares_of_energy_add_up_to_one():
    shares = part_plots.energy_shares(with_parts())
    assert sum(shares.values()) == pytest.approx(np.ones(18))
    expected = {
        "reflected": 0.35,
        "reflected, delta term": 0.0,
        "transmitted, delta term": 0.08,
        "transmitted": 0.25,
        "absorbed": 0.32,
    }
    assert list(shares) == list(expected)
    for name, share in shares.items():
        assert share == pytest.approx(expected[name], abs=1e-12), name


def test_energy_is_stacked_to_one():
    figure = part_plots.energy(with_parts())
    tops = stack(figure.axes[0])
    # no reflected delta term, so no layer of it
    assert list(tops) == ["reflected", "transmitted, delta term", "transmitted", "absorbed"]
    assert list(tops.values()) == pytest.approx([0.35, 0.43, 0.68, 1.0])


@pytest.mark.parametrize("transmitted", [False, True])
def test_orders_are_stacked_to_the_albedo(transmitted):
    table = with_parts()
    table = table.parts[TRANSMISSION] if transmitted else table
    panel = part_plots.orders_albedo(table, transmitted).axes[0]
    tops = [0.23, 0.33] if transmitted else [0.2, 0.3, 0.35]
    assert list(stack(panel).values()) == pytest.approx(tops)
    assert lines(panel)["all"] == pytest.approx(tops[-1])
    assert ("transmittance" in panel.get_ylabel()) == transmitted


def test_lobes_of_the_orders_add_up():
    figure = part_plots.orders_lobes(with_parts())
    assert len(figure.axes) == 3
    for panel in figure.axes:
        drawn = lines(panel)
        whole = drawn.pop("all")
        orders = {name: drawn[name] for name in ("L1", "L2", "L3+")}
        assert sum(orders.values()) == pytest.approx(whole)
        assert orders["L2"] == pytest.approx(0.1 / np.pi)


def test_orders_without_light_are_left_out():
    table = with_parts(transmitted=(0.0, 0.2, 0.1), delta=0.0).parts[TRANSMISSION]
    assert list(stack(part_plots.orders_albedo(table, True).axes[0])) == ["L2", "L3+"]
    assert set(lines(part_plots.orders_lobes(table).axes[0])) >= {"L2", "L3+", "all"}
    assert "L1" not in lines(part_plots.orders_lobes(table).axes[0])


def test_plots_of_transmission_say_so():
    below = with_parts().parts[TRANSMISSION]
    panel = plots.lobes(below, transmitted=True).axes[0]
    assert panel.get_ylabel() == "f_t (1/sr)"
    assert "straight on" in panel.get_xlabel()
    assert panel.get_title().endswith("and a delta term of 0.08")
    assert plots.hemisphere(below, transmitted=True).axes[0].get_title().startswith("f_t")
    above = plots.lobes(with_parts()).axes[0]
    assert above.get_ylabel() == "f_r (1/sr)"
    assert "delta" not in above.get_title()


def test_albedo_has_a_second_panel_for_transmittance():
    first, second = plots.albedo(with_parts()).axes
    assert first.get_ylabel() == "directional albedo"
    assert second.get_ylabel() == "directional transmittance"
    assert second.containers[0].lines[0].get_ydata() == pytest.approx(0.33)
    assert len(plots.albedo(lambert_table(0.5)).axes) == 1


def test_albedo_above_one_is_seen():
    """Linear sRGB of a colour outside its gamut has such a component."""
    (panel,) = plots.albedo(lambert_table(1.2)).axes
    assert panel.get_ylim()[1] > 1.2


def test_of_many_wavelengths_a_few_are_drawn_in_their_colours():
    grey = lambert_table(0.5, tint=(1.0,))
    nm = np.linspace(400, 700, 31)
    table = grey.replace(
        values=np.repeat(grey.values, 31, axis=-1),
        row_albedo=np.repeat(grey.row_albedo, 31, axis=-1),
        specular=np.zeros(()), specular_std_error=np.zeros(()), albedo_std_error=np.zeros(()),
        channels=tuple(f"{w:g} nm" for w in nm), wavelengths_nm=tuple(nm),
    )  # fmt: skip
    panel = plots.lobes(table).axes[0]
    drawn = [line for line in panel.get_lines() if line.get_label().endswith(" nm")]
    assert [line.get_label() for line in drawn] == [f"{w} nm" for w in (400, 460, 520, 580, 640, 700)]
    blue, red = (tuple(int(drawn[n].get_color()[i : i + 2], 16) for i in (1, 3, 5)) for n in (0, -1))
    assert blue[2] > blue[0]
    assert red[0] > red[2]
