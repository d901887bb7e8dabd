"""White furnaces: lossless specimens keep all light, at all angles; the ledger and the orders add up."""

from __future__ import annotations

import numpy as np
import pytest

from tests.oracles.measuring import (
    FLAT,
    MIRROR,
    NONE,
    agrees,
    batches_of,
    gaussian,
    glass,
    groove,
    keeps_all_light,
    lambert,
    layer,
    ledger_adds_up,
    trace,
)
from tests.oracles.test_media import orders_add_up

pytestmark = pytest.mark.compiled

ANGLES = [0, 40, 75, 89.9]
WHITE = layer(FLAT, lambert(1.0))
CLEAR_FILMS = {
    "kind": "coated",
    "films": [{"eta": 1.38, "thickness_nm": 100}, {"eta": 2.3, "thickness_nm": 60}],
    "over": glass(1.5),
}


SURFACES = {
    "flat": FLAT,
    "smooth": gaussian(0.1),
    "rough": gaussian(0.5),
    "very rough": gaussian(1.0),
    "exponential": {
        "kind": "exponential",
        "rms_height": 0.1,
        "correlation_length": 1,
        "samples": 64,
        "size": 8,
    },
    "grooves": groove(60),
    "pyramids": {"kind": "pyramids", "slope_deg": 54.74, "arrangement": "random"},
    "pits": {"kind": "pits", "cover": 0.7, "segments": 32},
    "bosses": {"kind": "bosses", "cover": 0.7, "segments": 32},
    "fibres": {"kind": "fibres", "segments": 32},
    "spread fibres": {"kind": "fibres", "segments": 16, "pitch": 1.5},
    "woven": {"kind": "fibres", "weave": "plain", "segments": 16},
    "spheres": {"kind": "spheres", "cover": 0.5, "subdivisions": 2},
    "packed spheres": {"kind": "spheres", "arrangement": "packed", "layers": 2, "subdivisions": 2},
}
NAMES = [pytest.param(n, marks=pytest.mark.slow if n == "packed spheres" else ()) for n in SURFACES]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("material", [MIRROR, lambert(1.0)], ids=["mirror", "lambert"])
def test_opaque_surfaces(seed, name, material):
    table = trace(layer(SURFACES[name], material), 30_000, seed, theta_i_deg=ANGLES)
    keeps_all_light(table)


@pytest.mark.parametrize("name", NAMES)
def test_glass_surfaces_over_white(seed, name):
    """Any shape of glass over a white base: spheres and fibres stand on their own base of glass."""
    table = trace(
        [layer(SURFACES[name], glass(1.5), thickness=20.0), WHITE], 30_000, seed, theta_i_deg=ANGLES
    )
    keeps_all_light(table)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "eta", [1.5, pytest.param(0.7, marks=pytest.mark.slow), 4.0, pytest.param(0.25, marks=pytest.mark.slow)]
)
def test_glass_surfaces_reflect_or_transmit_all(seed, name, eta):
    table = trace(layer(SURFACES[name], glass(eta)), 30_000, seed, theta_i_deg=ANGLES)
    keeps_all_light(table, trapped=1e-3)


@pytest.mark.parametrize("alpha", [0.0, 0.1, 0.5, 1.0])
def test_films_on_glass_over_white(seed, alpha):
    """Films that do not absorb; three wavelengths share a path, and each keeps its light on the average."""
    surface = gaussian(alpha) if alpha else FLAT
    layers = [layer(surface, CLEAR_FILMS, thickness=10.0), WHITE]
    one = trace(layers, 30_000, seed, theta_i_deg=ANGLES, wavelengths_nm=[550.0])
    keeps_all_light(one)
    three = trace(layers, 30_000, seed, theta_i_deg=ANGLES, wavelengths_nm=[430.0, 550.0, 670.0])
    ledger_adds_up(three)
    agrees(three.row_albedo, three.albedo_std_error, 1.0, batches_of(three), precision=4e-2)
    # the energy of the channels together is kept path by path
    assert three.row_albedo.mean(axis=1) == pytest.approx(1.0, abs=1e-9)


def test_rough_slab_between_films(seed):
    """Closed films on both rough sides of a plate: R + T = 1."""
    below = {**CLEAR_FILMS, "over": glass(1.0)}
    layers = [layer(gaussian(0.5), CLEAR_FILMS, thickness=10.0), layer(gaussian(0.3), below)]
    table = trace(layers, 30_000, seed, theta_i_deg=ANGLES, wavelengths_nm=[550.0])
    keeps_all_light(table)


@pytest.mark.parametrize("alpha", [0.1, 0.5, 1.0])
def test_rough_slabs(seed, alpha):
    layers = [layer(gaussian(alpha), glass(1.5), thickness=10.0), layer(gaussian(alpha), glass(1.0))]
    keeps_all_light(trace(layers, 30_000, seed, theta_i_deg=ANGLES))


def test_rough_layers_of_everything(seed):
    """Rough glass, a white cloud, rough glass of another index, white grooves."""
    layers = [
        layer(gaussian(0.4), glass(1.5), sigma_s=0.3, phase="hg", g=0.7, thickness=5.0),
        layer(gaussian(0.7), glass(1.2), sigma_s=0.1, phase="rayleigh", thickness=5.0),
        layer(groove(50), lambert(1.0)),
    ]
    table = trace(layers, 30_000, seed, theta_i_deg=ANGLES)
    ledger_adds_up(table)
    # Rayleigh scattering of polarised light weighs paths: kept on the average only
    agrees(table.row_albedo, table.albedo_std_error, 1.0, batches_of(table), precision=1e-2)


def test_dispersive_rough_glass_keeps_all_light_on_the_average(seed):
    layers = [layer(gaussian(0.5), glass([1.45, 1.5, 1.6]), thickness=10.0), WHITE]
    table = trace(layers, 200_000, seed, theta_i_deg=[0, 60], wavelengths_nm=[430.0, 550.0, 670.0])
    ledger_adds_up(table)
    agrees(table.row_albedo, table.albedo_std_error, 1.0, batches_of(table))
    assert table.row_albedo.mean(axis=1) == pytest.approx(1.0, abs=1e-9)


def test_an_idle_surface_does_nothing(seed):
    """Rough interfaces of equal indices, and of no material: light goes straight on."""
    for top in (layer(gaussian(1.0), glass(1.0), thickness=10.0), layer(gaussian(1.0), NONE, thickness=10.0)):
        table = trace([top, layer(FLAT, MIRROR)], 30_000, seed, theta_i_deg=ANGLES)
        assert table.specular == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("orders", [2, 5])
def test_orders_add_up_for_glass_and_metal(seed, orders):
    glassy = [
        layer(gaussian(0.7), glass(1.5), sigma_s=0.1, sigma_a=0.01, thickness=10.0),
        layer(FLAT, glass(1.0)),
    ]
    metal = layer(gaussian(0.7), {"kind": "conductor", "eta": 0.4, "k": 1.1})
    for layers in (glassy, metal):
        orders_add_up(trace(layers, 30_000, seed, theta_i_deg=ANGLES, orders=orders))


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [0.1, 0.5, 1.0])
def test_ten_million_paths_through_rough_glass_over_white(alpha):
    layers = [layer(gaussian(alpha, 256, 16), glass(1.5), thickness=10.0), WHITE]
    table = trace(layers, 10_000_000, 1, theta_i_deg=list(range(0, 90, 3)))
    ledger = table.ledger
    assert ledger["lost"] <= 1e-6 * ledger["paths"]
    assert np.sum([ledger[k] for k in ("reflected", "absorbed", "killed", "lost")]) == pytest.approx(
        ledger["paths"], rel=1e-12
    )
    assert ledger["reflected"] == pytest.approx(ledger["paths"] - ledger["lost"] - ledger["killed"], rel=1e-9)
