"""The interpolant: exact albedo, exact sampling, right at pole and horizon."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.core.directions import direction
from gonio.core.jit import disabled
from gonio.table import interpolation
from gonio.table.pool import pool_tables, trapezoid_weights
from gonio.table.table import Table
from gonio.validation import Quadrature, seed_from, validate
from tests.table.tables import asymmetric, grid, lambert, make, peak

N = 2_000 if disabled else 200_000
UNEVEN = (
    np.array([0.0, 0.05, 0.2, 0.6, 1.0, np.pi / 2]),
    np.array([0.0, 0.01, 0.3, 0.31, 0.9, 1.5, np.pi / 2]),
    np.array([0.0, 0.5, 0.52, 2.0, 3.0, np.pi]),
)
CASES = {
    "lambert": make(lambert),
    "asymmetric": make(asymmetric),
    "uneven edges": make(asymmetric, UNEVEN),
    "peak": make(peak(), grid(45, 45, 90), cell_points=4),
    "exact rows": make(asymmetric, theta_i=np.radians([0.0, 30.0, 60.0])),
    "one row": make(asymmetric, theta_i=np.array([0.7])),
    "one cell": make(lambert, grid(1, 1, 1)),
    "one channel": make(peak(0.3), tint=(0.9,)),
}


def uniform_directions(rng, n):
    return direction(np.arccos(rng.random(n)), rng.uniform(0, 2 * np.pi, n))


@pytest.mark.compiled
@pytest.mark.compiled
@pytest.mark.parametrize("name", CASES)
def test_kit(name):
    table = CASES[name]
    angles = [0.0, 0.3, 0.7, 1.2, 1.55]
    quadrature = Quadrature((64, 128), 8_000_000) if name == "peak" else Quadrature()
    report = validate(
        table.eval, table.sample, table.pdf, f"interpolation {name}", angles, N, False, True, None, quadrature
    )
    # the furnace is not this module's: a synthetic peak may reflect more than it receives
    failed = [o for o in report.outcomes if not o.passed and "furnace" not in o.name]
    assert not failed, report.lines()


@pytest.mark.parametrize("name", CASES)
def test_rows_reintegrate_to_albedo(name):
    """The trapezoid sum over (u, phi) is the interpolant's exact integral; eval() itself is summed here."""
    table = CASES[name]
    u_edges = np.sin(table.theta_r_edges) ** 2
    u = np.concatenate([[0.0], 0.5 * (u_edges[1:] + u_edges[:-1]), [1.0]])
    phi = np.concatenate([[0.0], table.delta_phi, [np.pi]])
    wo = direction(np.arcsin(np.sqrt(u))[:, None], phi)
    rows = table.theta_i
    if table.theta_i_edges is not None:
        edges = np.sin(table.theta_i_edges) ** 2
        rows = np.arcsin(np.sqrt(0.5 * (edges[1:] + edges[:-1])))
    weights = np.outer(trapezoid_weights(u), trapezoid_weights(phi))
    for row in range(0, len(rows), 1 if not disabled else 10):
        values = table.eval(direction(rows[row]), wo)
        # at the pole direction() forgets the azimuth, but the node is the same for all
        np.testing.assert_allclose(np.einsum("up,upc->c", weights, values), table.row_albedo[row], rtol=1e-10)
        np.testing.assert_allclose(table.albedo(rows[row]), table.row_albedo[row], rtol=1e-10)


def test_albedo_leaves_the_delta_term_out():
    plain, mirror = make(asymmetric), make(asymmetric, specular=0.25)
    rng = np.random.default_rng(seed_from("delta"))
    wi, wo = uniform_directions(rng, 50), uniform_directions(rng, 50)
    np.testing.assert_allclose(mirror.eval(wi, wo), plain.eval(wi, wo), rtol=1e-12)
    np.testing.assert_allclose(mirror.pdf(wi, wo), plain.pdf(wi, wo), rtol=1e-12)
    theta = np.array([0.0, 0.4, np.pi / 2])
    np.testing.assert_allclose(mirror.albedo(theta), plain.albedo(theta) + 0.25)


def test_lambert_is_constant_with_pole_and_horizon():
    angles = np.array([0.0, 1e-9, 1e-3, 0.5, np.pi / 2 - 1e-9, np.pi / 2])
    directions = direction(angles[:, None], np.array([0.0, 1.0, np.pi, 5.0])).reshape(-1, 3)
    directions[:, 2] = np.maximum(directions[:, 2], 0.0)
    table = CASES["lambert"]
    values = table.eval(directions[:, None], directions)
    expected = 0.5 / np.pi * np.array([1.0, 0.8, 0.5])
    np.testing.assert_allclose(values, np.broadcast_to(expected, values.shape), rtol=1e-12)
    np.testing.assert_allclose(
        table.pdf(directions[:, None], directions),
        np.broadcast_to(directions[:, 2] / np.pi, (24, 24)),
        atol=1e-7,
    )


def test_below_the_horizon_nothing():
    table = CASES["asymmetric"]
    above, below = direction(0.5, 1.0), direction(np.pi - 0.5, 1.0)
    for wi, wo in ((above, below), (below, above), (below, below)):
        assert np.all(table.eval(wi, wo) == 0)
        assert table.pdf(wi, wo) == 0
    assert table.sample(below, [0.3, 0.3, 0.3])[1] == 0
    assert np.all(table.albedo(2.0) == 0)


def test_values_at_cell_centres_are_the_cells():
    """On a fine grid scaling is close to 1, and f at a node is the cell: delta phi 0 is retro-reflection."""
    table = make(asymmetric, grid(30, 60, 90), theta_i=np.radians([10.0, 50.0]))
    u_edges = np.sin(table.theta_r_edges) ** 2
    wo = direction(np.arcsin(np.sqrt(0.5 * (u_edges[1:] + u_edges[:-1])))[:, None], table.delta_phi)
    # rows 10 deg: scaled by albedo/integral, within 1e-3 of 1 for a smooth function on 1.5 degree cells
    np.testing.assert_allclose(table.eval(direction(table.theta_i[0]), wo), table.values[0], rtol=2e-3)
    retro, mirror = table.eval(direction(0.87), direction(0.87, [0.1, np.pi - 0.1]))
    assert np.all(retro > 2 * mirror)


def test_reciprocal_cells_stay_reciprocal():
    """With equal axes the interpolant is symmetric up to the rows' scaling, which is 1e-3 here."""
    table = make(peak(0.4), grid(45, 45, 60))
    rng = np.random.default_rng(seed_from("reciprocal"))
    wi, wo = uniform_directions(rng, 200), uniform_directions(rng, 200)
    forward, backward = table.eval(wi, wo), table.eval(wo, wi)
    inside = (wi[:, 2] > 0.1) & (wo[:, 2] > 0.1)
    np.testing.assert_allclose(forward[inside], backward[inside], rtol=1e-2)


def test_isotropic_at_normal_incidence():
    """A noisy first row has no azimuth to keep at exactly normal incidence."""
    rng = np.random.default_rng(seed_from("noisy"))
    for table in (CASES["asymmetric"], CASES["exact rows"]):
        noisy = table.replace(values=table.values * rng.uniform(0.5, 1.5, table.values.shape))
        values = noisy.eval(direction(0.0), direction(0.6, np.linspace(0, 6, 7)))
        np.testing.assert_allclose(values, np.broadcast_to(values[0], values.shape), rtol=1e-6)
        np.testing.assert_allclose(noisy.albedo(0.0), noisy.row_albedo[0], rtol=1e-12)


def test_zero_and_partly_zero_tables():
    dark = make(lambda wi, wo: 0.0 * lambert(wi, wo))
    rng = np.random.default_rng(seed_from("dark"))
    wi, u = uniform_directions(rng, 20), rng.random((20, 3))
    assert np.all(dark.eval(wi, wi) == 0)
    assert np.all(dark.sample(wi, u)[1] == 0)
    assert np.all(dark.pdf(wi, wi) == 0)
    # one lit row between dark ones, one lit cell in it
    values = np.zeros((3, 4, 5, 1))
    values[1, 2, 3] = 2.0
    edges = np.linspace(0, np.pi / 2, 4), np.linspace(0, np.pi / 2, 5), np.linspace(0, np.pi, 6)
    lit = make(lambert, edges, tint=(1.0,)).replace(values=values, row_albedo=[[0.0], [0.3], [0.0]])
    wo, pdf = lit.sample(direction(0.8), rng.random((500, 3)))
    assert np.all(pdf > 0)
    np.testing.assert_allclose(lit.eval(direction(0.8), wo)[:, 0] * wo[:, 2] / pdf, lit.albedo(0.8)[0])


def test_extreme_uniforms():
    for table in CASES.values():
        for u in ([0.0, 0.0, 0.0], [1 - 2**-53] * 3, [0.0, 1 - 2**-53, 0.5]):
            wo, pdf = table.sample(direction([0.0, 0.3, np.pi / 2 - 1e-12]), u)
            assert np.all(np.isfinite(wo))
            assert np.all(np.isfinite(pdf))
            assert np.all(wo[:, 2] >= 0)
            np.testing.assert_allclose(np.linalg.norm(wo, axis=1), 1, rtol=1e-12)


def test_negative_values_count_as_zero():
    table = make(asymmetric)
    values = table.values.copy()
    values[:, 3, 4] = -1.0
    assert np.all(
        table.replace(values=values).eval(direction(0.5), direction(np.linspace(0, 1.5, 50), 0.4)) >= 0
    )


def test_pool_of_several_tables():
    tables = list(CASES.values())
    pool = pool_tables(tables)
    wi, wo = (0.6, 0.0, 0.8), (0.0, 0.28, 0.96)
    for t, table in enumerate(tables):
        out = np.empty(len(table.channels))
        interpolation.eval_table(pool, t, wi, wo, out)
        np.testing.assert_array_equal(out, table.eval(wi, wo))
        assert interpolation.pdf_table(pool, t, wi, wo) == table.pdf(wi, wo)
        direction_, density = interpolation.sample_table(pool, t, wi, 0.3, 0.6, 0.9)
        expected = table.sample(wi, [0.3, 0.6, 0.9])
        np.testing.assert_array_equal(direction_, expected[0])
        assert density == expected[1]
    assert len(pool_tables([]).header) == 0


def test_wrong_shape_of_directions():
    with pytest.raises(ValueError, match=r"\(\.\.\., 3\)"):
        CASES["lambert"].eval(np.zeros((4, 2)), np.zeros((4, 2)))


def test_pool_type_is_the_same_for_every_table():
    """One compiled kernel serves all: no dtype may depend on the table."""
    empty = pool_tables([])
    for table in CASES.values():
        assert [a.dtype for a in table.pool] == [a.dtype for a in empty]
        assert [a.ndim for a in table.pool] == [a.ndim for a in empty]
    assert isinstance(CASES["lambert"], Table)
