"""Pits and bosses against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.oracles import cavities
from tests.oracles.measuring import BLACK, MIRROR, agrees, batches_of, lambert, layer, trace

pytestmark = pytest.mark.compiled


def caps(kind, cover, depth=1.0, segments=128, plane=BLACK, **keys):
    return {"kind": kind, "cover": cover, "depth": depth, "segments": segments, "plane": plane, **keys}


def enclosed(segments):
    """Of a disc's area, what a polygon of so many sides encloses."""
    x = 2 * math.pi / segments
    return math.sin(x) / x


@pytest.mark.parametrize(("depth", "rho"), [(1.0, 0.8), (1.0, 0.4), (0.6, 0.7), (0.2, 0.9)])
def test_pits(seed, depth, rho):
    """rho (1-s)/(1 - rho s) at every angle, and each order; the plane between them black.

    A pit is a polyhedron with 128 corners on its rim, whose walls exchange light a little less than a sphere's:
    by parts of the order of its missing area, 4e-4. That is the tolerance.
    """
    angles = [0, 30, 60, 80]
    cover = 0.6
    table = trace(
        layer(caps("pits", cover, depth), lambert(rho)), 600_000, seed, theta_i_deg=angles, orders=4
    )
    mouth = cover * enclosed(128)
    shares = [cavities.pit_order(depth, rho, k) for k in (1, 2, 3)]
    shares.append(cavities.pit_albedo(depth, rho) - sum(shares))
    for name, share in zip(("L1", "L2", "L3", "L4+"), shares, strict=True):
        part = table.parts[name]
        error = np.hypot(part.albedo_std_error[:, 0], 4e-4 * share)
        agrees(part.row_albedo[:, 0], error, mouth * share, batches_of(table), precision=2e-3)
    error = np.hypot(table.albedo_std_error[:, 0], 4e-4 * mouth)
    agrees(table.row_albedo[:, 0], error, mouth * cavities.pit_albedo(depth, rho), batches_of(table), 2e-3)


def test_half_of_the_light_in_a_white_hemisphere_goes_on_at_every_bounce(seed):
    table = trace(
        layer(caps("pits", 0.9, plane=lambert(1.0)), lambert(1.0)),
        300_000,
        seed,
        theta_i_deg=[0, 50],
        orders=6,
    )
    assert table.row_albedo == pytest.approx(1.0, abs=1e-9)
    mouth = 0.9 * enclosed(128)
    for k in range(2, 6):  # the plane's own light leaves after one
        part = table.parts[f"L{k}"]
        agrees(
            part.row_albedo[:, 0],
            np.hypot(part.albedo_std_error[:, 0], 4e-4),
            mouth * 0.5**k,
            batches_of(table),
        )


@pytest.mark.parametrize("plane", [lambert(0.3), MIRROR], ids=["grey", "mirror"])
def test_the_plane_is_of_its_own_material(seed, plane):
    """Pits share no light with the plane between them: reflectances add by area."""
    rho, cover = 0.5, 0.4
    table = trace(layer(caps("pits", cover, plane=plane), lambert(rho)), 300_000, seed, theta_i_deg=[0, 70])
    mouth = cover * enclosed(128)
    flat = 1.0 if plane is MIRROR else 0.3
    expected = mouth * cavities.pit_albedo(1.0, rho) + (1 - mouth) * flat
    agrees(
        table.row_albedo[:, 0],
        np.hypot(table.albedo_std_error[:, 0], 4e-4),
        expected,
        batches_of(table),
        2e-3,
    )
    if plane is MIRROR:
        agrees(
            table.specular[:, 0], np.hypot(table.specular_std_error[:, 0], 1e-6), 1 - mouth, batches_of(table)
        )


def test_sparse_mirror_bosses(seed):
    """Normal incidence: f cos(theta_r) = a/(4 pi) in every cell; near the horizon bosses hide each other."""
    cover = 0.01
    table = trace(
        layer(caps("bosses", cover, segments=128), MIRROR), 2_000_000, seed, theta_i_deg=[0],
        theta_step_deg=5, phi_step_deg=180,
    )  # fmt: skip
    a = cover * enclosed(128)
    low, high = table.theta_r_edges[:-1], table.theta_r_edges[1:]
    # mean of 1/cos over a ring, weighted by projected solid angle: 2 (cos low - cos high)/(sin^2 high - sin^2 low)
    mean = 2 * (np.cos(low) - np.cos(high)) / (np.sin(high) ** 2 - np.sin(low) ** 2)
    expected = (a / (4 * math.pi) * mean)[None, :, None] * np.ones(table.values.shape[:3])
    clear = np.broadcast_to((np.degrees(high) <= 75)[None, :, None], expected.shape)
    # facets of a polyhedron turn light by twice their own steps: rings of 5 degrees smooth that to 1e-3
    agrees(
        table.values[..., 0][clear],
        np.hypot(table.std_error[..., 0], 1e-3 * expected)[clear],
        expected[clear],
        batches_of(table),
    )


def test_sparse_lambert_bosses_are_lambert_spheres(seed):
    """Half-spheres, lit along z and seen as whole ones are: f cos(theta_r) = a rho p(theta_r)/(4 pi).

    One bounce only: what falls on the black plane, or on another boss, is not of the first order.
    """
    cover, rho = 0.01, 0.8
    table = trace(
        layer(caps("bosses", cover, segments=128), lambert(rho)), 2_000_000, seed, theta_i_deg=[0], orders=2,
        theta_step_deg=5, phi_step_deg=180,
    )  # fmt: skip
    a = cover * enclosed(128)
    expected = np.zeros(table.values.shape[:3])
    for k, (low, high) in enumerate(zip(table.theta_r_edges[:-1], table.theta_r_edges[1:], strict=True)):
        g, w = cavities.gauss(low, high, 8)
        mean = 2 * (w * np.sin(g)) @ cavities.lambert_sphere(g) / (np.sin(high) ** 2 - np.sin(low) ** 2)
        expected[:, k] = a * rho / (4 * math.pi) * mean
    clear = np.broadcast_to(np.degrees(table.theta_r_edges[1:])[None, :, None] <= 75, expected.shape)
    once = table.parts["L1"]
    agrees(
        once.values[..., 0][clear],
        np.hypot(once.std_error[..., 0], 1e-3 * expected)[clear],
        expected[clear],
        batches_of(table),
    )


@pytest.mark.parametrize("kind", ["pits", "bosses"])
@pytest.mark.parametrize("material", [MIRROR, lambert(1.0)], ids=["mirror", "lambert"])
def test_white_caps_keep_all_light(seed, kind, material):
    surface = {"kind": kind, "cover": 0.7, "segments": 32}
    table = trace(layer(surface, material), 100_000, seed, theta_i_deg=[0, 60, 89.9])
    assert table.row_albedo == pytest.approx(1.0, abs=1e-9)
