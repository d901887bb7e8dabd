import numpy as np
import pytest

from microgeometry.colour import rgb_matrix
from microgeometry.errors import InputError
from microgeometry.grid import ANISOTROPIC_THETA_I_DEG
from microgeometry.specimen import parse_specimen

MIRROR = {"kind": "mirror"}
GOLD = {"kind": "conductor", "name": "Au"}
PAINT = {"kind": "lambert", "albedo": [0.8, 0.5, 0.2]}


def grid_of(material=MIRROR, grid=None, **tables):
    surface = {"kind": "flat"}
    return parse_specimen({"surface": surface, "material": material, "grid": grid or {}, **tables}).grid


def test_defaults_and_steps():
    default = grid_of()
    assert (default.theta_i_deg, default.theta_step_deg, default.phi_step_deg) == (None, 1.0, 1.0)
    assert (default.orders, default.n_samples) == (1, 1)
    keys = {"theta_i_deg": [0, 30, 89.9], "theta_step_deg": 0.7031250, "phi_step_deg": 22.5, "orders": 4}
    given = grid_of(grid=keys)
    assert given.theta_i_deg == (0.0, 30.0, 89.9)
    assert (given.theta_step_deg, given.phi_step_deg, given.orders) == (90 / 128, 22.5, 4)
    assert grid_of(grid={"theta_i_deg": 45}).theta_i_deg == (45.0,)


@pytest.mark.parametrize(
    ("material", "keys", "channels", "wavelengths", "samples"),
    [
        (MIRROR, {}, ("grey",), None, None),
        (MIRROR, {"channels": "rgb"}, ("R", "G", "B"), None, None),
        (PAINT, {}, ("R", "G", "B"), None, None),
        ({"kind": "lambert", "albedo": [0.8]}, {}, ("grey",), None, None),
        (GOLD, {"wavelengths_nm": [600, 500]}, ("600 nm", "500 nm"), (600.0, 500.0), (600.0, 500.0)),
        (MIRROR, {"wavelengths_nm": 500.5}, ("500.5 nm",), (500.5,), (500.5,)),
    ],
)
def test_channels_that_are_the_samples(material, keys, channels, wavelengths, samples):
    grid = grid_of(material, keys)
    assert (grid.channels, grid.wavelengths_nm, grid.samples_nm) == (channels, wavelengths, samples)
    assert grid.to_channels is None
    assert grid.n_samples == len(channels)


@pytest.mark.parametrize("keys", [{}, {"channels": "rgb"}, {"illuminant": "A"}, {"wavelength_step_nm": 5}])
def test_colours_of_spectra(keys):
    grid = grid_of(GOLD, keys)
    assert (grid.channels, grid.wavelengths_nm) == (("R", "G", "B"), None)
    samples = np.linspace(405, 705, 61 if "wavelength_step_nm" in keys else 21)
    assert grid.n_samples == len(samples)
    assert grid.samples_nm == pytest.approx(samples, rel=1e-12)
    assert np.array(grid.to_channels) == pytest.approx(rgb_matrix(samples, keys.get("illuminant", "D65")))
    assert np.sum(grid.to_channels, axis=1) == pytest.approx((1, 1, 1), abs=1e-12)


def test_what_holds_a_spectrum(tmp_path):
    (tmp_path / "phase.csv").write_text("theta_deg,value\n0,1\n180,1\n")
    (tmp_path / "facet.h5").write_text("")
    np.save(tmp_path / "map.npy", np.zeros((3, 3)))
    film = {
        "kind": "coated",
        "films": [{"eta": 1.5, "thickness_nm": 9}],
        "over": {"kind": "dielectric", "eta": 2},
    }
    phase = {"phase": "table", "file": "phase.csv", "sigma_s": 1, "thickness": float("inf")}
    flat, pits = {"kind": "flat"}, {"kind": "pits", "cover": 0.1}
    heights = {"kind": "heightmap", "file": "map.npy", "units": "um", "size": [1, 1]}
    space = {"thickness": 1}
    none, glass = {"kind": "none"}, {"kind": "dielectric", "name": "BK7"}
    for layers, samples in (
        ([{"surface": {**pits, "plane": GOLD}, "material": MIRROR}], 21),
        ([{"surface": flat, "material": film}], 21),
        ([{"surface": flat, "material": none, "medium": space}, {"surface": flat, "material": GOLD}], 21),
        ([{"surface": flat, "material": glass, "medium": space}, {"surface": flat, "material": MIRROR}], 21),
        ([{"surface": flat, "material": none, "medium": {**phase, "sigma_a": [1, 2, 3]}}], 3),
        # Files and lists of three that are no spectra.
        ([{"surface": flat, "material": none, "medium": phase}], 1),
        ([{"surface": flat, "material": {"kind": "table", "file": "facet.h5"}}], 1),
        ([{"surface": heights, "material": MIRROR}], 1),
    ):
        assert parse_specimen({"layer": layers}, tmp_path).grid.n_samples == samples


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        ({"theta_step": 1}, "did you mean 'theta_step_deg'"),
        ({"theta_step_deg": 0.7}, "must divide 90 degrees evenly"),
        ({"phi_step_deg": 50}, "must divide 180 degrees evenly"),
        ({"theta_step_deg": 0}, "at least 0.01"),
        ({"theta_step_deg": 180}, "at most 90"),
        ({"theta_i_deg": [0, 90]}, "below 90"),
        ({"theta_i_deg": [-1]}, "at least 0"),
        ({"theta_i_deg": [30, 0]}, "must increase"),
        ({"theta_i_deg": [30, 30]}, "must increase"),
        ({"theta_i_deg": []}, "empty"),
        ({"theta_i_deg": "all"}, "finite number"),
        ({"wavelengths_nm": [0]}, "above 0"),
        ({"wavelengths_nm": [500, 500]}, "twice"),
        ({"wavelengths_nm": [500], "channels": "rgb"}, "not both"),
        ({"channels": "RGB"}, "must be one of 'rgb', 'grey' .did you mean 'rgb'"),
        ({"channels": 3}, "must be one of"),
        ({"orders": 0}, "whole number, at least 1 and at most 16"),
        ({"orders": 1.5}, "whole number"),
        ({"illuminant": "D65"}, "illuminant = 'D65': only for channels = \"rgb\" with spectra"),
        ({"wavelength_step_nm": 5, "channels": "rgb"}, "wavelength_step_nm = 5: only for"),
    ],
)
def test_bad_grid(grid, message):
    with pytest.raises(InputError, match=message) as caught:
        grid_of(grid=grid)
    assert str(caught.value).startswith("[grid] ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        ({"illuminant": "D50"}, "must be one of 'D65', 'A', 'E'"),
        ({"wavelength_step_nm": 7}, "must divide 300 nm evenly, as 6.976744186 does"),
        ({"wavelength_step_nm": 0.5}, "at least 1 and at most 300"),
        ({"wavelength_step_nm": 5, "wavelengths_nm": [500]}, "only for channels"),
        ({"illuminant": "A", "wavelengths_nm": [500]}, "only for channels"),
    ],
)
def test_bad_colours(grid, message):
    with pytest.raises(InputError, match=message):
        grid_of(GOLD, grid)


def test_anisotropic():
    grid = grid_of(grid={"anisotropic": True})
    assert (grid.anisotropic, grid.phi_i_step_deg, grid.tilt_cells) == (True, 10.0, 65)
    assert grid.theta_i_deg == ANISOTROPIC_THETA_I_DEG
    assert grid.n_rows == 17 * 36
    given = grid_of(
        grid={"anisotropic": True, "theta_i_deg": [0, 45], "phi_i_step_deg": 90, "tilt_cells": 33}
    )
    assert (given.theta_i_deg, given.phi_i_step_deg, given.tilt_cells) == ((0, 45), 90.0, 33)
    assert given.n_rows == 8
    assert (grid_of().anisotropic, grid_of().n_rows) == (False, 90)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"anisotropic": 1}, "must be true or false"),
        ({"anisotropic": True, "phi_step_deg": 1}, "phi_step_deg.*no such cells"),
        ({"anisotropic": True, "theta_step_deg": 1}, "theta_step_deg.*no such cells"),
        ({"phi_i_step_deg": 10}, "phi_i_step_deg.*add anisotropic = true"),
        ({"anisotropic": True, "phi_i_step_deg": 7}, "divide 360"),
        ({"anisotropic": True, "tilt_cells": 64}, "must be odd"),
        ({"anisotropic": True, "tilt_cells": 3}, "at least 9"),
    ],
)
def test_anisotropic_keys_are_checked(keys, message):
    with pytest.raises(InputError, match=message):
        grid_of(grid=keys)
