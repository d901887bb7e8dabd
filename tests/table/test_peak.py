"""A highlight on a grid of its own: evaluated, sampled, measured, filed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from gonio import Table
from gonio.bench.peak import relative_error, rough_metal, tabulated
from gonio.core.directions import direction
from gonio.formats.hdf5_content import stored_bytes
from gonio.formats.losses import common_losses
from gonio.table import compress
from gonio.table.checks import check, relative_noise
from gonio.table.compress import highlight
from gonio.table.peak import Peak, grid_of, reached
from gonio.table.pool import pool_tables
from gonio.table.row_quantities import albedo_table
from gonio.trace.measure import measure
from gonio.validation import check_sampling, check_weights
from microgeometry.errors import InputError
from microgeometry.specimen import parse_specimen

pytestmark = pytest.mark.compiled

ALPHA = 0.02
ROWS = np.arange(0, 91, 3)


@pytest.fixture(scope="module")
def metal():
    """Of 3-degree rows, so that it is quick; its peak has the cells of a 1-degree table."""
    return tabulated(ALPHA, ROWS, grid_of([ALPHA], 1.0))


@pytest.fixture(scope="module")
def glossy():
    spec = parse_specimen(
        {
            "surface": {"kind": "gaussian", "alpha": 0.005, "samples": 256},
            "material": {"kind": "mirror"},
            "grid": {"theta_step_deg": 3, "phi_step_deg": 3, "orders": 2},
        }
    )
    return measure(spec, rays=600_000)


@pytest.mark.parametrize("alpha", [0.005, 0.04, 0.1, 0.3])
@pytest.mark.parametrize("angle", [20, 75, 85])
def test_a_peak_of_any_width_is_represented_like_a_wide_one(alpha, angle):
    """As well as cells of one degree do at alpha 0.5 and 85 degrees."""
    rows = np.arange(angle - 2, angle + 3)
    error = relative_error(tabulated(alpha, rows, grid_of([alpha], 1.0)), alpha, angle)
    assert error < 0.0115
    if angle == 85:  # what the grid is for
        assert relative_error(tabulated(alpha, rows, None), alpha, angle) > 2 * error


def test_cells_of_one_degree_do_for_a_wide_highlight():
    rows = np.arange(83, 88)
    assert relative_error(tabulated(0.5, rows, None), 0.5, 85) < 0.0115


def plane_angles(wo):
    """Angles in the plane of incidence from the normal away from the light, and out of it; d omega = cos b da db."""
    return np.arctan2(-wo[..., 0], wo[..., 2]), np.arcsin(wo[..., 1])


def masses(table, theta_i, bins=16, points=40):
    """Integral of pdf over bins of `plane_angles` around the mirror direction, and the bins' edges.

    The kit's quadrature over the hemisphere does not see peaks as narrow as these.
    """
    reach = 2.2 * table.peak.extent
    a = np.linspace(theta_i - reach, min(theta_i + reach, 0.5 * np.pi), bins + 1)
    b = np.linspace(-1.0, 1.0, bins + 1) * reach * np.cos(theta_i)
    at = (np.arange(points) + 0.5) / points
    along, across = np.meshgrid(
        *((e[:-1, None] + np.diff(e)[:, None] * at).ravel() for e in (a, b)), indexing="ij"
    )
    wo = np.stack([-np.sin(along) * np.cos(across), np.sin(across), np.cos(along) * np.cos(across)], axis=-1)
    density = table.pdf(direction(theta_i), wo) * np.cos(across)
    area = (a[1] - a[0]) * (b[1] - b[0])
    return density.reshape(bins, points, bins, points).mean(axis=(1, 3)) * area, a, b


# at grazing angles rows differ and the disc of slopes is cut
@pytest.mark.parametrize("degrees", [0.0, 31.0, 70.2, 86.0])
def test_samples_follow_the_density(metal, degrees):
    rng, n = np.random.default_rng(int(degrees)), 50_000
    theta_i = np.radians(degrees)
    wi = np.broadcast_to(direction(theta_i), (n, 3))
    wo, density = metal.sample(wi, rng.random((n, 3)))
    np.testing.assert_allclose(density, metal.pdf(wi, wo), rtol=1e-9)
    expected, a, b = masses(metal, theta_i)
    observed = np.histogram2d(*plane_angles(wo), (a, b))[0]
    many = n * expected > 10
    observed, expected = observed[many], n * expected[many]
    observed, expected = np.append(observed, n - observed.sum()), np.append(expected, n - expected.sum())
    # the rest may hold nothing
    chi2 = np.sum((observed - expected) ** 2 / np.maximum(expected, 5.0))
    assert stats.chi2.sf(chi2, len(expected) - 1) > 1e-4


@pytest.mark.parametrize("degrees", [3.0, 50.5, 89.7])
def test_validation_kit(metal, degrees):
    rng = np.random.default_rng(int(degrees))
    for outcome in check_sampling(metal.sample, metal.pdf, np.radians(degrees), rng, 50_000):
        assert outcome.passed, f"{outcome.name}: {outcome.detail}"
    for outcome in check_weights(metal.eval, metal.sample, np.radians(degrees), rng):
        assert outcome.passed, f"{outcome.name}: {outcome.detail}"


def test_nothing_is_lost_below_the_horizon():
    """Beyond the last row of a table the energy drawn reaches below the horizon: what it has there comes up again."""
    table = tabulated(ALPHA, np.array([52, 56, 60]), grid_of([ALPHA], 1.0))
    for degrees in (85.0, 88.0):
        theta_i = np.radians(degrees)
        below = 1.0 - masses(table, theta_i, 8, 200)[0].sum()
        assert abs(below) < 1e-3
        wi = np.broadcast_to(direction(theta_i), (20_000, 3))
        wo, pdf = table.sample(wi, np.random.default_rng(5).random((20_000, 3)))
        weight = table.eval(wi, wo)[:, 0] * wo[:, 2] / pdf
        assert weight.max() < 4 * weight.mean()
        assert weight.mean() < 1.0


# between rows and on them; with alpha 0.3 the disc of slopes is cut at every angle
@pytest.mark.parametrize(("alpha", "rows"), [(ALPHA, np.arange(76, 91)), (0.3, np.arange(0, 91, 6))])
def test_weights_add_up_to_the_albedo(alpha, rows):
    table = tabulated(alpha, rows, grid_of([alpha], 1.0))
    rng, n = np.random.default_rng(2), 200_000
    for degrees in (5.0, 45.0, 70.0, 82.0) if rows[0] == 0 else (78.0, 82.5, 86.3):
        wi = np.broadcast_to(direction(np.radians(degrees), 0.7), (n, 3))
        wo, pdf = table.sample(wi, rng.random((n, 3)))
        weight = table.eval(wi, wo)[:, 0] * wo[:, 2] / pdf
        albedo = table.albedo(np.radians(degrees))[0]
        sigma = max(weight.std() / np.sqrt(n), 2e-5 * albedo)  # of the albedo's own, 1e-4 at most
        assert abs(weight.mean() - albedo) < 4 * sigma
        assert weight.max() < 1.5 * albedo


@pytest.mark.parametrize("last", [60, 81, 90])
@pytest.mark.parametrize("alpha", [0.002, ALPHA])
def test_energy_up_to_grazing_incidence(alpha, last):
    """Beyond the last row's middle it is what `albedo` says, though facets hide ever more of each other."""
    table = tabulated(alpha, np.arange(last - 9, last + 1, 3), grid_of([alpha], 1.0))
    rng, n = np.random.default_rng(6), 100_000
    for degrees in (0.5 * (last + 90), 89.3, 89.7, 89.9, 90.0):
        wi = np.broadcast_to(direction(np.radians(degrees), 0.7), (n, 3))
        wo, pdf = table.sample(wi, rng.random((n, 3)))
        weight = table.eval(wi, wo)[:, 0] * wo[:, 2] / pdf
        albedo = table.albedo(np.radians(degrees))[0]
        assert abs(weight.mean() - albedo) < 4 * weight.std() / np.sqrt(n) + 0.005 * albedo
    assert albedo == pytest.approx(table.row_albedo[-1, 0], rel=1e-6)


def test_albedo_holds_table_and_peak(metal):
    expected = metal.row_albedo[:, 0]
    # the row stands at the middle of its interval of sin^2 theta_i
    middle = np.sqrt(0.5 * (np.sin(metal.theta_i_edges[1:]) ** 2 + np.sin(metal.theta_i_edges[:-1]) ** 2))
    np.testing.assert_allclose(metal.albedo(np.arcsin(middle))[:, 0], expected, rtol=1e-6)
    out = np.empty(1)
    albedo_table(metal.pool, 0, -0.5, out)
    assert out[0] == 0


def test_azimuth_of_slopes():
    """Light that leaves nearer to the normal than the mirror direction comes off facets that lean to the light."""
    peak = tabulated(ALPHA, np.arange(44, 47), grid_of([ALPHA], 1.0)).peak
    values = np.zeros_like(peak.values)
    values[:, :, : values.shape[2] // 2] = 1.0  # psi < pi/2
    table = tabulated(ALPHA, np.arange(44, 47), None)
    energy = np.einsum("isqc,sq->ic", values, peak.areas)
    table = table.replace(values=0 * table.values, row_albedo=energy, peak=replace(peak, values=values))
    wi = direction(np.radians(45.0), 1.1)
    steep, flat = (direction(np.radians(t), 1.1 + np.pi) for t in (43.0, 47.0))
    assert table.eval(wi, steep)[0] > 0
    assert table.eval(wi, flat)[0] == 0


def test_smooth_light_around_a_peak_is_continuous_at_its_rim():
    """A constant BRDF has no peak: none is made of it, wherever the disc of slopes ends."""
    table = tabulated(ALPHA, np.arange(20, 80, 2), grid_of([ALPHA], 1.0))
    peak, each = table.peak, np.ones((len(table.theta_i), 1, 1, 1))
    rows = zip(table.theta_i_edges[:-1], table.theta_i_edges[1:], strict=True)
    reflected = np.stack([peak.visible(row).projected_solid_angles for row in rows])
    lambert = (reflected / peak.areas / np.pi)[..., None]
    dull = table.replace(
        values=each * np.ones_like(table.values) / np.pi,
        row_albedo=np.ones_like(table.row_albedo),
        peak=replace(peak, values=lambert),
    )
    wi = direction(np.radians(50.3))
    wo = direction(np.radians(np.linspace(20, 80, 241)), np.pi)
    np.testing.assert_allclose(dull.eval(wi, wo)[:, 0], 1 / np.pi, rtol=0.003)


def test_cells_that_a_disc_of_slopes_reaches():
    theta, phi = np.radians(np.linspace(0, 90, 31)), np.radians(np.linspace(0, 180, 37))
    bounds = np.radians([30.0, 33.0])
    inside = reached(tuple(bounds), theta, phi, 0.1)
    rng = np.random.default_rng(0)
    wi = direction(rng.uniform(*bounds, 200_000))
    angle = rng.uniform(0, np.pi / 2, 200_000), rng.uniform(0, np.pi, 200_000)
    h = wi + direction(*angle)
    met = np.hypot(h[:, 0], h[:, 1]) < 0.098 * h[:, 2]  # but for slivers
    found = np.histogram2d(*(a[met] for a in angle), (theta, phi))[0] > 0
    assert found.any()
    assert np.all(inside[found])
    assert inside.sum() < 1.5 * found.sum()


def test_trace_finds_the_peak(glossy):
    peak = glossy.peak
    assert peak is not None
    energy = np.einsum("isqc,sq->ic", peak.values, peak.areas)
    # half vectors of a single bounce are the facets' normals: but for shadows, all are in the disc
    np.testing.assert_allclose(energy, glossy.row_albedo, rtol=1e-9)
    # P(s) = exp(-s^2/alpha^2) / (pi alpha^2) at normal incidence, by the surface's own alpha
    alpha = glossy.provenance["surface"]["alpha"]
    ring = peak.slope_edges[:-1] ** 2, peak.slope_edges[1:] ** 2
    share = np.exp(-ring[0] / alpha**2) - np.exp(-ring[1] / alpha**2)
    row = (peak.values[0, ..., 0] * peak.areas).sum(axis=1)
    error = np.sqrt(((peak.std_error[0, ..., 0] * peak.areas) ** 2).sum(axis=1))
    # the realisations' alphas differ as well
    assert np.all(np.abs(row - share)[:12] < 4 * error[:12] + 0.03 * share[:12])
    single = glossy.parts["L1"].peak
    np.testing.assert_allclose(
        single.values + glossy.parts["L2+"].peak.values, peak.values, rtol=1e-12, atol=1e-9
    )


def test_half_vectors_fill_the_peak():
    """Single bounces by half vectors, the rest counted: together they are all light of smooth mirrors."""
    surface = {"kind": "gaussian", "alpha": 0.1, "samples": 128}
    grid = {"theta_step_deg": 10, "phi_step_deg": 10, "orders": 2, "theta_i_deg": [10, 60, 80]}
    spec = parse_specimen({"surface": surface, "material": {"kind": "mirror"}, "grid": grid})
    table = measure(spec, rays=200_000)
    assert table.provenance["estimator"] == "half-vector"
    energy = np.einsum("isqc,sq->ic", table.peak.values, table.peak.areas)
    np.testing.assert_allclose(energy, table.row_albedo, rtol=2e-3)
    single, rest = (table.parts[name].peak.values for name in ("L1", "L2+"))
    np.testing.assert_allclose(single + rest, table.peak.values, rtol=1e-12)
    assert rest.max() > 0
    bright = table.peak.values > 0.1 * table.peak.values.max()
    assert np.all(table.peak.std_error[bright] < 0.1 * table.peak.values[bright])


def test_checks_know_the_peak(glossy):
    found = {c.name: c for c in check(glossy).checks}
    assert "cells of its own" in found["resolution"].detail
    assert found["resolution"].numbers["narrow_rows"] == 0
    assert relative_noise(glossy).max() > relative_noise(glossy.replace(peak=None)).max()


@pytest.mark.parametrize(
    ("surface", "material"),
    [
        ({"kind": "gaussian", "alpha": 0.5}, {"kind": "mirror"}),
        ({"kind": "v_groove", "slope_deg": 10}, {"kind": "mirror"}),
        ({"kind": "gaussian", "alpha": 0.01}, {"kind": "lambert", "albedo": 0.5}),
        ({"kind": "flat"}, {"kind": "mirror"}),
    ],
)
def test_no_peak_where_none_is(surface, material):
    grid = {"theta_step_deg": 10, "phi_step_deg": 10}
    table = measure(parse_specimen({"surface": surface, "material": material, "grid": grid}), rays=10_000)
    assert table.peak is None


def test_coat_over_pigment_has_its_gloss(tmp_path):
    """Stacks of layers are traced by another kernel; what passes through the coat is no peak of it."""
    spec = parse_specimen(
        {
            "layer": [
                {
                    "surface": {"kind": "gaussian", "alpha": 0.01, "samples": 128},
                    "material": {"kind": "dielectric", "eta": 1.5},
                    "medium": {"thickness": 1.0, "sigma_a": 0.0, "sigma_s": 0.0},
                },
                {"surface": {"kind": "flat"}, "material": {"kind": "lambert", "albedo": 0.5}},
            ],
            "grid": {"theta_step_deg": 10, "phi_step_deg": 10},
        }
    )
    table = measure(spec, rays=200_000)
    assert "transmission" not in table.parts
    wi = direction(np.radians(30.0))
    gloss, aside = table.eval(wi, direction(np.radians([30.0, 60.0]), np.pi))[:, 0]
    # F / (4 pi alpha^2 cos^2 theta) of the coat's mirror direction, beside the pigment's
    assert gloss == pytest.approx(aside + 0.0415 / (4 * np.pi * 0.01**2 * 0.75), rel=0.15)
    assert aside < 0.2


def test_file_keeps_the_peak(glossy, tmp_path):
    glossy.save(tmp_path / "t.h5")
    again = Table.load(tmp_path / "t.h5")
    for name in ("values", "std_error", "slope_edges", "psi_edges"):
        np.testing.assert_array_equal(getattr(again.peak, name), getattr(glossy.peak, name))
    np.testing.assert_array_equal(again.parts["L1"].peak.values, glossy.parts["L1"].peak.values)
    assert "fine grid" in " ".join(common_losses(glossy, "MERL"))


def test_compressed_file_keeps_the_peak(glossy, tmp_path):
    compress.compress(glossy, tmp_path / "c.h5", 0.01)
    again = Table.load(tmp_path / "c.h5")
    assert again.peak.std_error is None
    for part, other in ((glossy, again), (glossy.parts["L1"], again.parts["L1"])):
        errors = highlight.errors(part.peak, other.peak.values)
        assert np.all(errors <= compress.row_bounds(part, 0.01))
        assert errors.max() > 0.002  # it is not kept in full


def test_compressed_peak_is_small_and_held_to_the_bound(metal):
    bounds = np.full((len(metal.theta_i), 1), 0.01)
    content = highlight.encode(metal.peak, bounds)
    decoded = highlight.decode(content, metal.peak.areas, bounds.shape)
    assert 0.003 < highlight.errors(metal.peak, decoded).max() <= 0.01
    assert stored_bytes(content) < 4 * metal.peak.values.size / 10


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"values": np.full((1, 2, 3, 1), np.nan)}, "NaN"),
        ({"values": np.zeros((1, 3, 2, 1))}, "shape"),
        ({"slope_edges": [0.0, 0.2, 0.1]}, "increase"),
        ({"slope_edges": [0.1, 0.2, 0.3]}, "from 0"),
        ({"psi_edges": [0.0, 1.0, 2.0, 3.0]}, "pi"),
        ({"std_error": np.full((1, 2, 3, 1), -1.0)}, ">= 0"),
    ],
)
def test_damaged_peak(changes, word):
    good = {
        "values": np.zeros((1, 2, 3, 1)),
        "slope_edges": [0.0, 0.1, 0.2],
        "psi_edges": [0.0, 1.0, 2.0, np.pi],
    }
    Peak(**good)
    with pytest.raises(InputError, match=word):
        Peak(**{**good, **changes})


def test_peak_of_another_table(metal):
    with pytest.raises(InputError, match="peak/values"):
        metal.replace(peak=replace(metal.peak, values=metal.peak.values[1:]))


def test_pool_of_tables_with_and_without(metal):
    plain = tabulated(0.5, np.arange(40, 43), None)
    pool = pool_tables([plain, metal, plain, metal])
    out = np.empty(1)
    from gonio.table.interpolation import eval_table

    wi, wo = direction(0.7), direction(0.71, np.pi)
    for t, table in enumerate((plain, metal, plain, metal)):
        eval_table(pool, t, tuple(wi), tuple(wo), out)
        np.testing.assert_array_equal(out, table.eval(wi, wo))
    assert rough_metal(wi, wo, ALPHA) == pytest.approx(metal.eval(wi, wo)[0], rel=0.03)


def test_compressed_peak_of_negative_colours(metal, tmp_path):
    """Outside the gamut a channel of the highlight is negative, and stays it; one that is not gets no negative cell."""
    tint = np.array([1.0, 0.4, -0.05])
    outside = metal.replace(
        values=metal.values[..., :1] * tint,
        **{name: getattr(metal, name)[:, :1] * tint for name in ("row_albedo", "specular")},
        **{name: np.zeros((len(metal.theta_i), 3)) for name in ("albedo_std_error", "specular_std_error")},
        std_error=None,
        channels=("R", "G", "B"),
        peak=replace(metal.peak, values=metal.peak.values[..., :1] * tint, std_error=None),
    )
    bounds = compress.row_bounds(outside, 0.01)
    compress.compress(outside, tmp_path / "c.h5", 0.01, "tree")
    decoded = Table.load(tmp_path / "c.h5").peak.values
    assert np.all(highlight.errors(outside.peak, decoded) <= bounds)
    # of all that is there, not the average of cells that are 0
    np.testing.assert_allclose(
        np.einsum("isqc,sq->ic", decoded, outside.peak.areas)[:, 2],
        np.einsum("isqc,sq->ic", outside.peak.values, outside.peak.areas)[:, 2],
        rtol=0.02,
    )
    inside = replace(outside.peak, values=np.abs(outside.peak.values))
    assert highlight.decode(highlight.encode(inside, bounds), inside.areas, bounds.shape).min() >= 0
