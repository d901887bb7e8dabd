"""Scattering media against Chandrasekhar, single scattering, and polarised adding-doubling."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.oracles import fresnel, half_space, planar
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

ANGLES = [1, 30, 60, 80]
COSINES = np.cos(np.radians(ANGLES))
WAVELENGTHS = [450.0, 550.0, 650.0]


def isotropic(cosine):
    return np.ones_like(cosine)


def hg(g):
    return lambda cosine: half_space.henyey_greenstein(cosine, g)


def in_row(table, row, means):
    """An array of the table's shape with the means in one row, and a mask of that row."""
    expected = np.zeros(table.values.shape[:3])
    expected[row] = means
    mask = np.zeros(expected.shape, bool)
    mask[row] = True
    return expected, mask


@pytest.mark.parametrize("albedo", [0.5, 0.8, 0.99])
def test_half_space(seed, albedo):
    cloud = layer(FLAT, NONE, sigma_s=3 * albedo, sigma_a=3 * (1 - albedo), thickness=INF)
    table = trace(cloud, 400_000, seed, theta_i_deg=ANGLES)
    agrees_albedo(table, half_space.half_space_albedo(COSINES, albedo), precision=3e-3)
    for row, mu_i in enumerate(COSINES):

        def f(_, mu_o, phi, mu_i=mu_i):
            return half_space.half_space(mu_i, mu_o[..., 0, 0], albedo)[..., None, None] + 0 * phi

        expected, mask = in_row(table, row, cell_means(f, table))
        agrees_cells(table, expected, where=mask)
    ledger_adds_up(table)
    assert table.ledger["absorbed: layer 1 surface"] == 0


def test_half_spaces_of_several_albedos_along_one_path(seed):
    """Collisions are drawn for one wavelength and weighed for the others."""
    albedos = [0.3, 0.8, 0.95]
    cloud = layer(FLAT, NONE, sigma_s=[0.3, 1.6, 0.95], sigma_a=[0.7, 0.4, 0.05], thickness=INF)
    table = trace(cloud, 400_000, seed, theta_i_deg=ANGLES, wavelengths_nm=WAVELENGTHS)
    for channel, albedo in enumerate(albedos):
        agrees_albedo(table, half_space.half_space_albedo(COSINES, albedo), 5e-3, channel)
    ledger_adds_up(table)


@pytest.mark.parametrize(
    ("phase", "function"),
    [
        ({}, isotropic),
        ({"phase": "hg", "g": 0.6}, hg(0.6)),
        ({"phase": "hg", "g": -0.4}, hg(-0.4)),
        ({"phase": "rayleigh"}, half_space.rayleigh),
    ],
)
def test_single_scattering(seed, phase, function):
    """First order alone: Lommel and Seeliger in every cell, times the phase function."""
    albedo = 0.7
    cloud = layer(FLAT, NONE, sigma_s=albedo, sigma_a=1 - albedo, thickness=INF, **phase)
    table = trace(cloud, 1_000_000, seed, theta_i_deg=ANGLES, orders=2)
    once = table.parts["L1"]
    for row, mu_i in enumerate(COSINES):
        sin_i = math.sqrt(1 - mu_i**2)

        def f(_, mu_o, phi, mu_i=mu_i, sin_i=sin_i):
            # directions of travel: down and onwards, up and with azimuth pi - phi to it
            cosine = -mu_i * mu_o - sin_i * np.sqrt(1 - mu_o**2) * np.cos(phi)
            return half_space.single_scattering(mu_i, mu_o, albedo, phase=function(cosine))

        expected, mask = in_row(table, row, cell_means(f, table, points=8))
        agrees_cells(once, expected, where=mask)
    orders_add_up(table)


def orders_add_up(table):
    """Orders sum to their total, cell by cell, in reflection and transmission."""
    for whole in [table, *([table.parts["transmission"]] if "transmission" in table.parts else [])]:
        orders = [part for name, part in whole.parts.items() if name.startswith("L")]
        assert len(orders) >= 2
        assert sum(p.values for p in orders) == pytest.approx(whole.values, rel=1e-12, abs=1e-15)
        assert np.array_equal(sum(p.hits for p in orders), whole.hits)
        assert sum(p.row_albedo for p in orders) == pytest.approx(whole.row_albedo, rel=1e-12)
        assert sum(p.specular for p in orders) == pytest.approx(whole.specular, rel=1e-12, abs=1e-15)


def test_single_scattering_of_a_slab_both_ways(seed):
    tau, albedo = 0.8, 0.9
    slab = [layer(FLAT, NONE, sigma_s=albedo, sigma_a=1 - albedo, thickness=tau), layer(FLAT, NONE)]
    table = trace(slab, 400_000, seed, theta_i_deg=ANGLES, orders=3)
    through = table.parts["transmission"]
    agrees_albedo_of_unscattered = through.specular[:, 0], through.specular_std_error[:, 0]
    agrees(*agrees_albedo_of_unscattered, np.exp(-tau / COSINES), batches_of(table))
    for row, mu_i in enumerate(COSINES):

        def up(_, mu_o, phi, mu_i=mu_i):
            return half_space.single_scattering(mu_i, mu_o, albedo, tau) + 0 * phi

        def down(_, mu_o, phi, mu_i=mu_i):
            return half_space.single_transmission(mu_i, mu_o, albedo, tau) + 0 * phi

        expected, mask = in_row(table, row, cell_means(up, table))
        agrees_cells(table.parts["L1"], expected, where=mask)
        expected, mask = in_row(table, row, cell_means(down, table))
        agrees_cells(through.parts["L1"], expected, where=mask)
    orders_add_up(table)


def by_adding(angles, build, indices=(1.0,)):
    """Reflectance and transmittance of every angle from `build(nodes)`, a `planar.Slab`."""
    nodes = planar.make_nodes(indices, angles)
    stack = build(nodes)
    rows = range(len(angles))
    return (
        np.array([planar.albedo(stack.r, nodes, k) for k in rows]),
        np.array([planar.albedo(stack.t, nodes, k) for k in rows]),
    )


def test_slab_of_van_de_hulst(seed):
    """tau = 2, w = .9, g = .75: R .09739, T .66096 at normal incidence."""
    slab = [
        layer(FLAT, NONE, sigma_s=90.0, sigma_a=10.0, phase="hg", g=0.75, thickness=0.02),
        layer(FLAT, NONE),
    ]
    angles = [0, *ANGLES[1:]]
    table = trace(slab, 400_000, seed, theta_i_deg=angles)
    r, t = by_adding(angles, lambda nodes: planar.medium(nodes, 1.0, 2.0, 0.9, hg(0.75)))
    assert r[0] == pytest.approx(0.09739, abs=1e-5)
    agrees_albedo(table, r, precision=3e-3)
    agrees_albedo(table.parts["transmission"], t, precision=3e-3)
    ledger_adds_up(table)


def test_half_space_of_giovanelli(seed):
    """n = 1.5 over w = .9, isotropic; .2599 by adding-doubling, .2600 by Giovanelli at normal incidence."""
    paint = layer(FLAT, glass(1.5), sigma_s=9.0, sigma_a=1.0, thickness=INF)
    angles = [0, *ANGLES[1:]]
    table = trace(paint, 600_000, seed, theta_i_deg=angles)
    r, _ = by_adding(
        angles,
        lambda nodes: planar.interface(nodes, 1.0, 1.5).over(planar.medium(nodes, 1.5, 60.0, 0.9, isotropic)),
        (1.0, 1.5),
    )
    agrees_albedo(table, r, precision=3e-3)


@pytest.mark.parametrize("name", ["isotropic", "hg", "rayleigh"])
def test_turbid_plate(seed, name):
    """A scattering plate of n = 1.5 in air; Rayleigh's particles polarise, and so do the interfaces."""
    phase = {"isotropic": isotropic, "hg": hg(0.5), "rayleigh": None}[name]
    keys = {"phase": name, "g": 0.5} if name == "hg" else {"phase": name}
    plate = [
        layer(FLAT, glass(1.5), sigma_s=0.9, sigma_a=0.1, thickness=1.3, **keys),
        layer(FLAT, glass(1.0)),
    ]
    table = trace(plate, 600_000, seed, theta_i_deg=ANGLES)
    r, t = by_adding(
        ANGLES,
        lambda nodes: (
            planar.interface(nodes, 1.0, 1.5)
            .over(planar.medium(nodes, 1.5, 1.3, 0.9, phase))
            .over(planar.interface(nodes, 1.5, 1.0))
        ),
        (1.0, 1.5),
    )
    agrees_albedo(table, r, precision=3e-3)
    agrees_albedo(table.parts["transmission"], t, precision=3e-3)
    ledger_adds_up(table)


def test_paint_of_two_layers(seed):
    """Varnish over a scattering coat of another index over a grey base."""
    paint = [
        layer(FLAT, glass(1.5), sigma_s=0.0, sigma_a=0.2, thickness=1.0),
        layer(FLAT, glass(1.7), sigma_s=3.0, sigma_a=0.1, phase="hg", g=0.3, thickness=0.5),
        layer(FLAT, lambert(0.4)),
    ]
    table = trace(paint, 600_000, seed, theta_i_deg=ANGLES)
    r, _ = by_adding(
        ANGLES,
        lambda nodes: (
            planar.interface(nodes, 1.0, 1.5)
            .over(planar.clear(nodes, 1.5, 0.2))
            .over(planar.interface(nodes, 1.5, 1.7))
            .over(planar.medium(nodes, 1.7, 1.55, 3.0 / 3.1, hg(0.3)))
            .over(planar.lambert(nodes, 1.7, 0.4))
        ),
        (1.0, 1.5, 1.7),
    )
    agrees_albedo(table, r, precision=3e-3)
    ledger_adds_up(table)


def rayleigh_modes(angles, edges, tau, rho, albedo=1.0, n=1.0, per_segment=8):
    """Modes 0 to 2 of Rayleigh's slab over a Lambertian base: nodes and operators."""
    result = []
    for mode in range(3):
        nodes = planar.make_nodes([1.0, n], angles, edges, per_segment, mode)
        stack = planar.medium(nodes, n, tau, albedo, None).over(planar.lambert(nodes, n, rho))
        if n != 1.0:
            stack = planar.interface(nodes, 1.0, n).over(stack)
        result.append((nodes, stack.r))
    return result


def test_rayleigh_slab_over_a_base_in_every_cell(seed):
    """The case of Natraj, Li & Yung (2009), tau = .5 and rho = .8, with polarisation, where phi matters.

    By scalar light, cells are off by up to 4 %.
    """
    step = 15.0
    edges = np.arange(step, 90, step)
    angles = [5, math.degrees(math.acos(0.2))]
    table = trace(
        [layer(FLAT, NONE, sigma_s=0.5, phase="rayleigh", thickness=1.0), layer(FLAT, lambert(0.8))],
        2_000_000, seed, theta_i_deg=angles,
    )  # fmt: skip
    for row in range(len(angles)):
        expected, mask = in_row(table, row, _ring_means(table, rayleigh_modes(angles, edges, 0.5, 0.8), row))
        agrees_cells(table, expected, where=mask)
    ledger_adds_up(table)


def _ring_means(table, modes, source):
    """Cell means of a BRDF in Fourier modes, by the quadrature nodes within each ring."""
    nodes = modes[0][0]
    outside = nodes.w * (nodes.p < 1.0)  # the others are trapped by total reflection
    ring = np.searchsorted(np.sin(table.theta_r_edges[1:-1]), nodes.p)
    means = np.zeros(table.values.shape[1:3])
    phi = table.delta_phi_edges
    for m, (_, operator) in enumerate(modes):
        stokes = 2 if m == 0 else 4
        kernel = operator.k[0::stokes, stokes * source]
        per_ring = np.bincount(ring, outside * kernel, len(table.theta_r_edges) - 1)
        per_ring /= np.bincount(ring, outside, len(table.theta_r_edges) - 1)
        if m == 0:
            means += per_ring[:, None] / (2 * math.pi)
        else:  # mean of cos m (pi - phi) over the cell
            wave = np.diff(np.sin(m * phi)) / (m * np.diff(phi)) * (-1) ** m
            means += per_ring[:, None] * wave / math.pi
    return means


def test_glass_full_of_rayleigh_scatterers(seed):
    """As above under glass: the interface refracts, polarises, and shifts phases where it reflects totally."""
    edges = np.arange(15.0, 90, 15.0)
    angles = [40, 70]
    table = trace(
        [
            layer(FLAT, glass(1.5), sigma_s=0.9, sigma_a=0.1, phase="rayleigh", thickness=1.0),
            layer(FLAT, lambert(0.2)),
        ],
        2_000_000, seed, theta_i_deg=angles,
    )  # fmt: skip
    modes = rayleigh_modes(angles, edges, 1.0, 0.2, 0.9, 1.5)
    for row in range(len(angles)):
        expected, mask = in_row(table, row, _ring_means(table, modes, row))
        agrees_cells(table, expected, where=mask)
    mirror = [fresnel.unpolarised(c, 1.0, 1.5) for c in np.cos(np.radians(angles))]
    agrees(table.specular[:, 0], table.specular_std_error[:, 0], mirror, batches_of(table))


def test_tabulated_phase_function(seed, tmp_path):
    """A table of Henyey and Greenstein's function, dense enough, is that function; a coarse one is itself."""
    theta = np.linspace(0, 180, 721)
    _write(tmp_path / "hg.csv", theta, half_space.henyey_greenstein(np.cos(np.radians(theta)), 0.6))
    theta = np.array([0.0, 40.0, 100.0, 180.0])
    coarse = np.array([5.0, 1.0, 0.2, 0.7])
    _write(tmp_path / "coarse.csv", theta, coarse)
    cosines = np.cos(np.radians(theta))[::-1]
    scale = np.trapezoid(coarse[::-1], cosines) / 2

    def piecewise(cosine):
        return np.interp(cosine, cosines, coarse[::-1] / scale)

    for file, phase in (("hg.csv", hg(0.6)), ("coarse.csv", piecewise)):
        slab = [
            layer(FLAT, NONE, sigma_s=0.95, sigma_a=0.05, phase="table", file=file, thickness=2.0),
            layer(FLAT, NONE),
        ]
        table = trace(slab, 400_000, seed, folder=tmp_path, theta_i_deg=ANGLES)
        r, t = by_adding(ANGLES, lambda nodes, phase=phase: planar.medium(nodes, 1.0, 2.0, 0.95, phase))
        agrees_albedo(table, r, precision=3e-3)
        agrees_albedo(table.parts["transmission"], t, precision=3e-3)


def _write(file, theta, values):
    rows = [f"{t:.17g},{v:.17g}" for t, v in zip(theta, values, strict=True)]
    file.write_text("\n".join(["theta_deg,value", *rows]) + "\n")


def test_white_clouds_keep_all_light(seed):
    """Scattering without absorption, open below and over white: R + T = 1, and R = 1."""
    cloud = {"sigma_s": 2.0, "phase": "hg", "g": 0.5, "thickness": 3.0}
    for material in (NONE, glass(1.4)):
        below = layer(FLAT, glass(1.0)) if material is not NONE else layer(FLAT, NONE)
        table = trace([layer(FLAT, material, **cloud), below], 100_000, seed, theta_i_deg=[0, 60, 89.9])
        both = table.row_albedo + table.parts["transmission"].row_albedo
        assert both == pytest.approx(1.0, abs=1e-9)
        white = trace([layer(FLAT, material, **cloud), layer(FLAT, lambert(1.0))], 100_000, seed,
                      theta_i_deg=[0, 60, 89.9])  # fmt: skip
        assert white.row_albedo == pytest.approx(1.0, abs=1e-9)
        ledger_adds_up(white)


def test_media_without_light_or_without_matter(seed):
    """No scattering and no absorption is nothing; absorption alone is Beer and Lambert; a thick one is black."""
    for sigma_a, expected in ((0.0, 1.0), (0.7, np.exp(-0.7 / COSINES)), (1e4, 0.0)):
        slab = [layer(FLAT, NONE, sigma_a=sigma_a, thickness=1.0), layer(FLAT, NONE)]
        table = trace(slab, 20_000, seed, theta_i_deg=ANGLES)
        through = table.parts["transmission"].row_albedo[:, 0]
        assert through == pytest.approx(np.broadcast_to(expected, 4), abs=1e-12)
        assert np.all(table.row_albedo == 0)
        ledger_adds_up(table)


@pytest.mark.parametrize("thickness", [1e-6, 1e4])
def test_only_optical_thickness_counts(seed, thickness):
    slab = [
        layer(FLAT, NONE, sigma_s=0.8 / thickness, sigma_a=0.2 / thickness, thickness=thickness),
        layer(FLAT, NONE),
    ]
    table = trace(slab, 200_000, seed, theta_i_deg=ANGLES)
    r, t = by_adding(ANGLES, lambda nodes: planar.medium(nodes, 1.0, 1.0, 0.8, isotropic))
    agrees_albedo(table, r, precision=4e-3)
    agrees_albedo(table.parts["transmission"], t, precision=4e-3)


def test_a_thick_slab_is_a_half_space(seed):
    slab = [layer(FLAT, NONE, sigma_s=0.8, sigma_a=0.2, thickness=1e4), layer(FLAT, NONE)]
    table = trace(slab, 200_000, seed, theta_i_deg=ANGLES)
    agrees_albedo(table, half_space.half_space_albedo(COSINES, 0.8), precision=4e-3)
    assert np.all(table.parts["transmission"].row_albedo == 0)


def test_absorbed_energy_stands_with_its_layer(seed):
    """Two absorbing media and a grey base: each takes what differences of adding-doubling say."""
    layers = [
        layer(FLAT, glass(1.5), sigma_a=0.3, thickness=1.0),
        layer(FLAT, glass(1.3), sigma_s=1.0, sigma_a=0.2, thickness=1.0),
        layer(FLAT, lambert(0.6)),
    ]
    table = trace(layers, 600_000, seed, theta_i_deg=[30])
    ledger, paths = table.ledger, table.ledger["paths"]
    names = [f"absorbed: layer {k} {part}" for k in (1, 2, 3) for part in ("surface", "medium")]
    shares = dict.fromkeys(names, 0.0) | {
        n: e / paths for n, e in ledger.items() if n.startswith("absorbed:")
    }
    expected = _absorbed_by_layers()
    for name, share in expected.items():
        # of independent paths, each absorbed or not, the largest error
        assert shares[name] == pytest.approx(share, abs=5 * math.sqrt(0.25 / paths)), name


def _absorbed_by_layers():
    """Shares of light of 30 degrees absorbed in the two media and the base: differences of net fluxes."""
    nodes = planar.make_nodes((1.0, 1.3, 1.5), [30])
    top = planar.interface(nodes, 1.0, 1.5).over(planar.clear(nodes, 1.5, 0.3))
    cloud = planar.interface(nodes, 1.5, 1.3).over(planar.medium(nodes, 1.3, 1.2, 1.0 / 1.2, isotropic))
    base = planar.lambert(nodes, 1.3, 0.6)
    below = cloud.over(base)
    down = (top.r_below @ below.r).resolvent() @ top.t  # just above the second interface
    onto_cloud = planar.albedo(down, nodes, 0) - planar.albedo(below.r @ down, nodes, 0)
    above = top.over(cloud)
    onto_base = planar.albedo((above.r_below @ base.r).resolvent() @ above.t, nodes, 0)
    return {
        "absorbed: layer 1 surface": 0.0,
        "absorbed: layer 1 medium": 1 - planar.albedo(top.over(below).r, nodes, 0) - onto_cloud,
        "absorbed: layer 2 surface": 0.0,
        "absorbed: layer 2 medium": onto_cloud - 0.4 * onto_base,
        "absorbed: layer 3 surface": 0.4 * onto_base,
    }


def test_light_from_a_cloud_enters_glass_within_the_critical_angle(seed):
    """Total reflection backwards: no light in the glass is beyond asin(1/1.5) of the normal."""
    layers = [layer(FLAT, NONE, sigma_s=1.0, thickness=1.0), layer(FLAT, glass(1.5))]
    table = trace(layers, 200_000, seed, theta_i_deg=[20, 70], theta_step_deg=1, phi_step_deg=180)
    through = table.parts["transmission"]
    beyond = np.sin(through.theta_r_edges[:-1]) > 1 / 1.5
    assert through.hits[:, beyond].sum() == 0
    r, t = by_adding(
        [20, 70],
        lambda nodes: planar.medium(nodes, 1.0, 1.0, 1.0, isotropic).over(planar.interface(nodes, 1.0, 1.5)),
        (1.0, 1.5),
    )
    agrees_albedo(table, r, precision=4e-3)
    agrees_albedo(through, t, precision=4e-3)
