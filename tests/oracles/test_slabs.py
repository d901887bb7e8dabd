"""Smooth layers against closed forms: slabs, plates, varnish, films, dispersion."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gonio.core.films import film_amplitudes as film_kernel
from tests.oracles import fresnel
from tests.oracles.films import film_amplitudes, film_stack
from tests.oracles.measuring import (
    FLAT,
    INF,
    NONE,
    agrees,
    agrees_albedo,
    agrees_cells,
    batches_of,
    cell_means,
    glass,
    lambert,
    layer,
    ledger_adds_up,
    trace,
)

pytestmark = pytest.mark.compiled

ANGLES = [0, 45, 56.31, 75]
COSINES = np.cos(np.radians(ANGLES))


def slab(eta, below=1.0, **medium):
    return [layer(FLAT, glass(eta), thickness=1.0, **medium), layer(FLAT, glass(below))]


@pytest.mark.parametrize(("eta", "below"), [(1.5, 1.0), (2.4, 1.0), (1.33, 1.9), (0.8, 1.0)])
def test_lossless_slab(seed, eta, below):
    """s and p apart: by scalar light the slab of 1.5 would be 10 sigma off at 56.31 degrees."""
    angles = ANGLES if eta > 1 else [0, 30, 50]
    table = trace(slab(eta, below), 600_000, seed, theta_i_deg=angles)
    r, t = np.array([fresnel.slab(c, eta, n_below=below) for c in np.cos(np.radians(angles))]).mean(-1).T
    agrees_albedo(table, r, precision=2e-3)
    through = table.parts["transmission"]
    agrees_albedo(through, t, precision=2e-3)
    # all of it is delta terms, and no light is gained or lost
    assert table.specular == pytest.approx(table.row_albedo)
    assert through.specular == pytest.approx(through.row_albedo)
    assert table.row_albedo + through.row_albedo == pytest.approx(1.0, abs=1e-12)
    ledger_adds_up(table)


def test_orders_of_a_slab(seed):
    """A bounce is a meeting with an interface: reflected or refracted. Every order has its closed form."""
    cos_i = math.cos(math.radians(60))
    table = trace(slab(1.7), 400_000, seed, theta_i_deg=[60], orders=6)
    f = fresnel.reflectance(cos_i, 1.0, 1.7)
    up = {1: f, 3: (1 - f) ** 2 * f, 5: (1 - f) ** 2 * f**3}
    down = {2: (1 - f) ** 2, 4: (1 - f) ** 2 * f**2}
    for whole, orders in ((table, up), (table.parts["transmission"], down)):
        for k in range(1, 6):
            part = whole.parts[f"L{k}"]
            if k in orders:
                agrees(part.row_albedo, part.albedo_std_error, orders[k].mean(), batches_of(table), 2e-3)
            else:
                assert np.all(part.row_albedo == 0)


def test_absorbing_slab(seed):
    """Beer and Lambert along the refracted path, at three absorptions along one path."""
    tau = [0.05, 0.4, 3.0]
    table = trace(slab(1.6, sigma_a=tau), 400_000, seed, theta_i_deg=ANGLES, wavelengths_nm=[400, 500, 600])
    for channel, once in enumerate(tau):
        r, t = np.array([fresnel.slab(c, 1.6, once) for c in COSINES]).mean(-1).T
        agrees_albedo(table, r, 2e-3, channel)
        agrees_albedo(table.parts["transmission"], t, 2e-3, channel)
    ledger_adds_up(table)
    absorbed = table.ledger["absorbed: layer 1 medium"] / table.ledger["paths"]
    lost = 1 - np.mean([[np.mean(np.sum(fresnel.slab(c, 1.6, x), axis=0)) for x in tau] for c in COSINES])
    assert absorbed == pytest.approx(lost, abs=2e-3)
    # roulette takes and gives at surfaces: nothing on the average
    assert table.ledger["absorbed: layer 1 surface"] == pytest.approx(0, abs=1e-4 * table.ledger["paths"])


def test_units_of_a_medium(seed):
    table = trace(slab(1.5, sigma_a=2e-4, units="nm"), 100_000, seed, theta_i_deg=[0])
    # the thickness is 1 in the same units
    r, t = (x.mean() for x in fresnel.slab(1.0, 1.5, 2e-4))
    agrees_albedo(table, [r], 2e-3)
    agrees_albedo(table.parts["transmission"], [t], 2e-3)


@pytest.mark.parametrize(
    ("eta", "rho", "tau"), [(1.5, 0.5, 0.0), (1.5, 0.8, 0.0), (1.33, 0.6, 0.25), (2.2, 0.9, 0.1)]
)
def test_varnished_lambert(seed, eta, rho, tau):
    layers = [layer(FLAT, glass(eta), thickness=1.0, sigma_a=tau), layer(FLAT, lambert(rho))]
    table = trace(layers, 1_000_000, seed, theta_i_deg=ANGLES)
    expected = [fresnel.interfaced_lambert_albedo(c, eta, rho, tau) for c in COSINES]
    agrees_albedo(table, expected, precision=2e-3)
    mirror = [fresnel.unpolarised(c, 1.0, eta) for c in COSINES]
    agrees(table.specular[:, 0], table.specular_std_error[:, 0], mirror, batches_of(table))
    for row, mu_i in enumerate(COSINES[1:], start=1):

        def f(_, mu_o, phi, mu_i=mu_i):
            return fresnel.interfaced_lambert(mu_i, mu_o, eta, rho, tau) + 0 * phi

        expected_cells = np.zeros(table.values.shape[:3])
        expected_cells[row] = cell_means(f, table, points=12)
        this_row = np.zeros(table.values.shape[:3], bool)
        this_row[row] = True
        agrees_cells(table, expected_cells, where=this_row)
    ledger_adds_up(table)
    # what is not reflected is absorbed in the base and in the varnish
    if tau == 0:
        assert table.ledger["absorbed: layer 1 medium"] == 0
        absorbed = table.ledger["absorbed: layer 2 surface"] / table.ledger["paths"]
        assert absorbed == pytest.approx(1 - np.mean(table.row_albedo), abs=1e-9)


def test_flat_lambert_in_every_cell_at_normal_incidence(seed):
    """At theta_i = 0 the azimuth of incidence is as good as any other: every cell of the row is rho/pi."""
    table = trace(layer(FLAT, lambert(0.6)), 300_000, seed, theta_i_deg=[0])
    agrees_cells(table, 0.6 / math.pi, min_hits=0)


def test_light_from_a_base_under_glass_leaves_within_the_critical_angle_of_it_only():
    """From a Lambertian base below n = 0.7: what leaves is within asin(0.7) of the normal, all the rest returns."""
    critical = math.degrees(math.asin(0.7))  # 44.4
    layers = [layer(FLAT, glass(0.7), thickness=1.0), layer(FLAT, lambert(0.9))]
    table = trace(layers, 300_000, 1, theta_i_deg=[1, 30, 60], theta_step_deg=5)
    beyond = np.degrees(table.theta_r_edges[:-1]) > critical
    assert table.hits[:2, beyond].sum() == 0
    assert table.hits[:2, ~beyond].all()
    # at 60 degrees, beyond the critical angle, all is mirrored
    assert table.specular[2] == pytest.approx(1.0, abs=1e-12)
    expected = [fresnel.interfaced_lambert_albedo(math.cos(math.radians(a)), 0.7, 0.9) for a in (1, 30)]
    agrees(table.row_albedo[:2, 0], table.albedo_std_error[:2, 0], expected, batches_of(table), 2e-3)


def test_equal_indices_do_nothing(seed):
    table = trace(slab(1.0), 20_000, seed, theta_i_deg=[0, 89])
    assert np.all(table.row_albedo == 0)
    assert table.parts["transmission"].specular == pytest.approx(1.0, abs=1e-12)
    matched = [
        layer(FLAT, glass(1.5), thickness=1.0),
        layer(FLAT, glass(1.5), thickness=1.0),
        layer(FLAT, glass(1)),
    ]
    table = trace(matched, 300_000, seed, theta_i_deg=ANGLES)
    agrees_albedo(table, [fresnel.slab(c, 1.5)[0].mean() for c in COSINES], 2e-3)


def test_a_conductor_that_does_not_absorb_is_a_dielectric():
    """k -> 0: the same reflectance; what enters is absorbed instead of transmitted."""
    metal = trace(layer(FLAT, {"kind": "conductor", "eta": 1.5, "k": 0.0}), 20_000, 1, theta_i_deg=ANGLES)
    assert metal.row_albedo[:, 0] == pytest.approx(fresnel.unpolarised(COSINES, 1.0, 1.5), rel=1e-6)
    nearly = trace(layer(FLAT, {"kind": "conductor", "eta": 1.5, "k": 1e-9}), 20_000, 1, theta_i_deg=ANGLES)
    assert nearly.row_albedo == pytest.approx(metal.row_albedo, rel=1e-6)


@pytest.mark.parametrize("tau", [0.0, 0.2])
def test_plate_over_metal(seed, tau):
    """The plate polarises, the metal reflects what is polarised: per polarisation, then the mean."""
    metal = {"kind": "conductor", "eta": 0.5, "k": 1.2}
    layers = [layer(FLAT, glass(1.7), thickness=1.0, sigma_a=tau), layer(FLAT, metal)]
    table = trace(layers, 600_000, seed, theta_i_deg=[0, 50, 65, 80])
    cosines = np.cos(np.radians([0, 50, 65, 80]))
    expected = np.array([fresnel.plate_over_metal(c, 1.7, 0.5 + 1.2j, tau) for c in cosines])
    agrees_albedo(table, expected.mean(axis=1), precision=2e-3)
    ledger_adds_up(table)


FILMS = [(1.38, 0.0, 110.0), (2.3, 0.02, 70.0), (1.9, 0.0, 250.0)]
WAVELENGTHS = [420.0, 550.0, 680.0]


def coated(over, films=FILMS):
    return {
        "kind": "coated",
        "films": [{"eta": n, "k": k, "thickness_nm": d} for n, k, d in films],
        "over": over,
    }


def stack(films):
    return [(n + 1j * k, d) for n, k, d in films]


def test_films_on_metal_at_each_wavelength():
    over = {"kind": "conductor", "eta": [1.1, 0.3, 0.2], "k": [2.0, 2.5, 3.8]}
    table = trace(layer(FLAT, coated(over)), 20_000, 1, theta_i_deg=ANGLES, wavelengths_nm=WAVELENGTHS)
    for channel, wavelength in enumerate(WAVELENGTHS):
        below = over["eta"][channel] + 1j * over["k"][channel]
        for row, cos_i in enumerate(COSINES):
            r, _ = film_stack(cos_i, 1.0, stack(FILMS), below, wavelength)
            assert table.row_albedo[row, channel] == pytest.approx((np.abs(r) ** 2).mean(), rel=1e-6)


def test_films_on_glass_reflect_and_transmit(seed):
    """A single interface: what the films absorb is what is missing, and stands in the ledger as their layer's."""
    table = trace(
        layer(FLAT, coated(glass(1.52))), 400_000, seed, theta_i_deg=ANGLES, wavelengths_nm=WAVELENGTHS
    )
    missing = []
    for channel, wavelength in enumerate(WAVELENGTHS):
        expected = [film_stack(c, 1.0, stack(FILMS), 1.52, wavelength) for c in COSINES]
        r = [(np.abs(x[0]) ** 2).mean() for x in expected]
        t = [x[1].mean() for x in expected]
        agrees_albedo(table, r, 2e-3, channel)
        agrees_albedo(table.parts["transmission"], t, 2e-3, channel)
        missing.append(1 - np.mean(r) - np.mean(t))
    absorbed = table.ledger["absorbed: layer 1 surface"] / table.ledger["paths"]
    assert absorbed == pytest.approx(np.mean(missing), abs=1e-3)
    ledger_adds_up(table)


@pytest.mark.parametrize("cos_i", [1.0, 0.8, 0.3])
def test_amplitudes_of_films(cos_i):
    """The kernel's complex amplitudes, phases between s and p too, which intensities hardly show."""
    index = np.array([[n, k] for n, k, _ in FILMS])
    thickness = np.array([d for *_, d in FILMS])
    for above, below in ((1.0, 1.52), (1.52, 1.0), (1.0, 0.2 + 3.0j)):
        r_s, r_p, t_s, t_p, cross = film_kernel(
            cos_i, above, index, thickness, complex(below).real, complex(below).imag, 550.0
        )
        r, t = film_amplitudes(cos_i, above, stack(FILMS), below, 550.0)
        assert [r_s, r_p] == pytest.approx(list(r), abs=1e-12)
        if not np.iscomplex(below):
            assert [t_s, t_p] == pytest.approx(list(np.abs(t) ** 2), abs=1e-12)
            assert cross == pytest.approx(t[0] * np.conj(t[1]), abs=1e-12)


def test_slab_coated_on_both_sides(seed):
    """Films are seen from within the glass too, in reverse order; s and p apart, incoherent between the faces."""
    top, bottom = [(1.38, 0.0, 100.0), (2.1, 0.0, 60.0)], [(2.0, 0.03, 80.0), (1.46, 0.0, 150.0)]
    layers = [
        layer(FLAT, coated(glass(1.6), top), thickness=50.0),
        layer(FLAT, coated(glass(1.0), bottom)),
    ]
    table = trace(layers, 600_000, seed, theta_i_deg=ANGLES, wavelengths_nm=[550.0])
    reflected, transmitted = [], []
    for cos_i in COSINES:
        cos_t = fresnel.refracted_cosine(cos_i, 1.0, 1.6)
        r1, t1 = film_stack(cos_i, 1.0, stack(top), 1.6, 550.0)
        back, out = film_stack(cos_t, 1.6, stack(top)[::-1], 1.0, 550.0)
        r2, t2 = film_stack(cos_t, 1.6, stack(bottom), 1.0, 550.0)
        series = 1 / (1 - np.abs(back * r2) ** 2)
        reflected.append((np.abs(r1) ** 2 + t1 * np.abs(r2) ** 2 * out * series).mean())
        transmitted.append((t1 * t2 * series).mean())
    agrees_albedo(table, reflected, 2e-3)
    agrees_albedo(table.parts["transmission"], transmitted, 2e-3)


def test_film_limits(seed):
    """No thickness is no film; a film of the substrate's index is none either, of any thickness."""
    bare = trace(layer(FLAT, {"kind": "conductor", "eta": 0.3, "k": 3.0}), 20_000, 1, theta_i_deg=ANGLES)
    over = {"kind": "conductor", "eta": 0.3, "k": 3.0}
    for films in ([(2.0, 0.5, 0.0)], [(0.3, 3.0, 40.0)], [(0.3, 3.0, 4e6)]):
        table = trace(layer(FLAT, coated(over, films)), 20_000, 1, theta_i_deg=ANGLES, wavelengths_nm=[550.0])
        assert table.row_albedo == pytest.approx(bare.row_albedo, rel=1e-6)


def test_averaged_over_its_thickness_a_film_is_the_incoherent_slab():
    """Seven wavelengths that put phases evenly over a period, in one path."""
    n, d = 1.6, 5000.0
    cos_i = math.cos(math.radians(50))
    cos_t = fresnel.refracted_cosine(cos_i, 1.0, n)
    wavelengths = [2 * n * d * cos_t / (26 + (k + 0.5) / 7) for k in range(7)]
    table = trace(
        layer(FLAT, coated({"kind": "conductor", "eta": 1.0, "k": 1e-12}, [(n, 0.0, d)])),
        20_000, 1, theta_i_deg=[50], wavelengths_nm=wavelengths,
    )  # fmt: skip
    assert table.row_albedo.mean() == pytest.approx(fresnel.slab(cos_i, n)[0].mean(), rel=1e-4)


def test_dispersion_is_as_if_each_wavelength_were_traced_alone(seed):
    """Channels that refract apart, in a plate of absorbing glass on glass."""
    etas = [1.3, 1.5, 1.9]
    layers = [layer(FLAT, glass(etas), thickness=1.0, sigma_a=0.3), layer(FLAT, glass([1.0, 1.2, 1.0]))]
    table = trace(layers, 1_000_000, seed, theta_i_deg=ANGLES, wavelengths_nm=WAVELENGTHS)
    for channel, (eta, below) in enumerate(zip(etas, [1.0, 1.2, 1.0], strict=True)):
        r, t = np.array([fresnel.slab(c, eta, 0.3, n_below=below) for c in COSINES]).mean(-1).T
        agrees_albedo(table, r, 4e-3, channel)
        agrees_albedo(table.parts["transmission"], t, 4e-3, channel)
    ledger_adds_up(table)


def test_a_thick_absorber_and_an_infinite_one_are_the_same(seed):
    for thickness in (1e6, INF):
        table = trace(
            layer(FLAT, glass(1.5), thickness=thickness, sigma_a=1.0) if thickness == INF
            else [layer(FLAT, glass(1.5), thickness=thickness, sigma_a=1.0), layer(FLAT, glass(1.0))],
            200_000, seed, theta_i_deg=ANGLES,
        )  # fmt: skip
        agrees_albedo(table, fresnel.unpolarised(COSINES, 1.0, 1.5), 2e-3)
        ledger_adds_up(table)


def test_grazing_light(seed):
    """89.9 degrees: through a slab of thickness 1, reflected light is 99 %, and nothing is lost."""
    table = trace(slab(1.5), 100_000, seed, theta_i_deg=[89.9])
    r = fresnel.slab(math.cos(math.radians(89.9)), 1.5)[0].mean()
    agrees_albedo(table, [r], 2e-3)
    ledger_adds_up(table)


def test_a_stack_of_none_is_nothing(seed):
    layers = [layer(FLAT, NONE, thickness=2.0), layer(FLAT, NONE, thickness=0.1), layer(FLAT, lambert(0.5))]
    table = trace(layers, 200_000, seed, theta_i_deg=[1, 70])
    assert table.row_albedo == pytest.approx(0.5, abs=1e-12)
    agrees_cells(table, 0.5 / math.pi)
