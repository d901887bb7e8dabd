"""Anisotropic tables: cells, interpolation, sampling, against a function known in closed form."""

import numpy as np
import pytest

from gonio.bench.anisotropic import beckmann
from gonio.core.directions import direction
from gonio.core.jit import disabled
from gonio.table.anisotropic import AnisotropicTable, tabulate_brdf
from gonio.table.tilts import from_tilts, slope_widths, tilt_edges, tilt_measures, to_tilts
from gonio.validation import check_sampling, validate
from microgeometry.errors import InputError
from microgeometry.grid import ANISOTROPIC_THETA_I_DEG

pytestmark = pytest.mark.skipif(disabled, reason="needs compiled kernels")

THETA_I = np.radians(ANISOTROPIC_THETA_I_DEG)


def table_of(alpha_x, alpha_y, n_phi=36, cells=65, theta_i=THETA_I, channels=("grey",)):
    def brdf(wi, wo):
        return beckmann(wi, wo, alpha_x, alpha_y) * np.linspace(1.0, 0.5, len(channels))

    edges = tilt_edges(alpha_x, cells), tilt_edges(alpha_y, cells)
    return tabulate_brdf(brdf, theta_i, n_phi, *edges, channels)


@pytest.fixture(scope="module")
def satin():
    return table_of(0.35, 0.15, cells=48, n_phi=24, channels=("a", "b"))


def test_tilts_and_back():
    rng = np.random.default_rng(1)
    u = rng.random((2, 500))
    wi, wo = (direction(np.arccos(rng.random(500)), 7 * v) for v in u)
    for i, o in zip(wi.tolist(), wo.tolist(), strict=True):
        for widths in ((0.3, 0.01), (0.01, 0.3), (1.0, 1.0)):
            x, y, density = to_tilts(tuple(i), tuple(o), widths)
            assert density > 0
            assert np.allclose(from_tilts(tuple(i), x, y, widths), o, atol=1e-9)


@pytest.mark.parametrize("widths", [(0.3, 0.01), (0.01, 0.3)])
@pytest.mark.parametrize(("theta_i", "theta_o"), [(0.0, 0.5), (1.1, 0.7), (1.5, 1.4)])
def test_density_of_tilts_is_the_derivative(widths, theta_i, theta_o):
    wi, wo = direction(theta_i, 0.4), direction(theta_o, 2.0)
    s = np.cross(wo, [0, 0, 1])
    s /= np.linalg.norm(s)
    t = np.cross(wo, s)
    h = 1e-5

    def at(a, b):
        w = wo + a * s + b * t
        return np.array(to_tilts(tuple(wi.tolist()), tuple((w / np.linalg.norm(w)).tolist()), widths)[:2])

    jacobian = np.column_stack([(at(h, 0) - at(-h, 0)), (at(0, h) - at(0, -h))]) / (2 * h)
    density = to_tilts(tuple(wi.tolist()), tuple(wo.tolist()), widths)[2]
    assert abs(np.linalg.det(jacobian)) == pytest.approx(density, rel=1e-5)


def test_a_highlight_keeps_its_place():
    """Slope 0 stays in the middle of the cells, to a fraction of a width, at any incidence."""
    widths = 0.28, 0.01
    for theta in np.radians([0, 30, 60, 80, 85]):
        for phi in np.radians([0, 40, 90]):
            wi = direction(theta, phi)
            x, y, _ = to_tilts(tuple(wi.tolist()), (-wi[0], -wi[1], wi[2]), widths)
            assert abs(y) < 0.2 * widths[1]
            # a wide one leans on the horizon
            assert abs(x) < (1.0 if theta > 1 else 0.2) * widths[0]


def test_widths_are_those_the_edges_were_made_for():
    for width, cells in ((0.28, 65), (0.01, 65), (0.5, 9), (1.0, 48)):
        assert slope_widths(tilt_edges(width, cells), tilt_edges(0.1, 33)) == pytest.approx((width, 0.1))


def test_every_direction_is_in_one_cell():
    """The cells of any row fill the hemisphere: their projected solid angles sum to pi."""
    edges = np.linspace(-np.pi / 2, np.pi / 2, 201)
    for theta in (0.0, 0.6, 1.3):
        _, areas = tilt_measures(direction(theta, 0.5), edges, edges)
        assert areas.sum() == pytest.approx(np.pi, rel=1e-3)


def error_between_rows(table, brdf, theta, phi, fine):
    """Compression's norm: relative, cosine-weighted."""
    wi = direction(theta, phi)
    wo, areas = tilt_measures(wi, *fine)
    wo, weight = wo.reshape(-1, 3), areas.ravel()
    exact = brdf(np.broadcast_to(wi, wo.shape), wo)
    difference = table.eval(wi, wo) - exact
    return np.sqrt((weight @ difference**2).sum() / (weight @ exact**2).sum())


def test_brushed_metal_within_one_percent_in_less_than_64_megabytes():
    """Slopes of widths 0.28 and 0.01, at incidences between the rows, to grazing ones."""
    alpha = 0.28, 0.01
    table = table_of(*alpha)
    rng = np.random.default_rng(2)
    fine = [tilt_edges(width, 160) for width in alpha]

    def brdf(wi, wo):
        return beckmann(wi, wo, *alpha)

    for theta in np.radians([5, 25, 45, 65, 75, 80, 83, 85]):
        for phi in rng.uniform(0, 2 * np.pi, 2):
            assert error_between_rows(table, brdf, theta + rng.uniform(-0.03, 0.03), phi, fine) < 0.01
    # three channels, as the renderer holds it: the mean and its sums are there once
    cells = table.energy.size
    assert table.pool.nbytes + 2 * 4 * cells < 64e6
    assert 3 * 4 * cells < 64e6  # and as it is stored


def test_diffuse_light_is_followed_to_the_horizon():
    """Where cells are wide and the horizon leaves slivers of them, no cell outshines its neighbours."""
    edges = tilt_edges(1.0, 65)

    def lambert(wi, wo):
        return np.full((len(wi), 1), 1 / np.pi)

    table = tabulate_brdf(lambert, np.radians([57, 63, 82, 84]), 36, edges, edges, ("grey",))
    fine = [tilt_edges(1.0, 120)] * 2
    for theta, most in ((60, 0.03), (83, 0.05)):
        for phi in (0.0, 0.8, 1.48):
            assert error_between_rows(table, lambert, np.radians(theta), phi, fine) < most


def test_no_seam_where_a_row_ends_at_its_horizon():
    """Rows at 60 and 80 degrees that disagree: seen from 70, the latter's horizon stands at theta_r = 80."""
    table = table_of(0.35, 0.35, n_phi=4, cells=33, theta_i=np.radians([60, 80]))
    factor = np.array([3.0, 1.0])[:, None, None]
    table = table.replace(energy=table.energy * factor[..., None, None], row_albedo=table.row_albedo * factor)
    wi = direction(np.radians(70), 0.0)
    before, after = table.eval(wi, direction(np.radians([79.99, 80.01]), np.pi))[:, 0]
    assert before == pytest.approx(after, rel=0.01)


def test_sampling_and_density(satin):
    report = validate(
        satin.eval, satin.sample, satin.pdf, "satin", (0.3, 0.9, 1.3), 100_000, reciprocal=False,
        isotropic=False, max_weight=20.0,
    )  # fmt: skip
    assert report.passed, "\n".join(str(o) for o in report.outcomes if not o.passed)


def test_a_wrong_density_fails(satin):
    """Mutation: a pdf off by 2 % must be seen."""
    rng = np.random.default_rng(3)
    outcomes = check_sampling(satin.sample, lambda i, o: 1.02 * satin.pdf(i, o), 0.7, rng, 100_000)
    assert not all(o.passed for o in outcomes)


def test_weights_are_nearly_constant(satin):
    rng = np.random.default_rng(4)
    for theta in (0.2, 0.8, 1.2):
        wi = np.broadcast_to(direction(theta, 0.7), (20_000, 3))
        wo, pdf = satin.sample(wi, rng.random((20_000, 3)))
        weight = satin.eval(wi, wo).mean(axis=1) * wo[:, 2] / pdf
        assert weight.std() < 0.1 * weight.mean()


def test_rows_reintegrate_to_their_albedo(satin):
    fine = [np.linspace(-np.pi / 2, np.pi / 2, 401)] * 2
    for a, b in ((0, 0), (6, 5), (12, 9)):
        wi = direction(satin.theta_i[a], satin.phi_i[b])
        wo, areas = tilt_measures(wi, *fine)
        total = np.einsum("nc,n->c", satin.eval(wi, wo.reshape(-1, 3)), areas.ravel())
        assert np.allclose(total, satin.row_albedo[a, b], rtol=3e-3)
        assert np.allclose(satin.albedo(satin.theta_i[a], satin.phi_i[b]), satin.row_albedo[a, b])


def test_azimuths_are_the_specimens(satin):
    """The function turned by 90 degrees is another, and the table knows which is which."""
    wi, wo = direction(0.9, 0.1), direction(0.4, 3.1)
    turned = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    exact = beckmann(wi[None], wo[None], 0.35, 0.15)[0, 0]
    other = beckmann((wi @ turned.T)[None], (wo @ turned.T)[None], 0.35, 0.15)[0, 0]
    assert abs(exact / other - 1) > 0.5
    assert satin.eval(wi, wo)[0] == pytest.approx(exact, rel=0.02)
    assert satin.eval(wi @ turned.T, wo @ turned.T)[0] == pytest.approx(other, rel=0.05)


def test_delta_term():
    table = table_of(0.3, 0.3, n_phi=4, cells=8, theta_i=np.radians([0, 60]))
    with_mirror = table.replace(specular=np.full((2, 4, 1), 0.1), row_albedo=table.row_albedo + 0.1)
    assert with_mirror.albedo(0.5, 1.0) - table.albedo(0.5, 1.0) == pytest.approx(0.1)
    assert with_mirror.directional_specular(0.5, 1.0) == pytest.approx(0.1)
    wi, wo = direction(0.5, 1.0), direction(0.4, 3.0)
    assert with_mirror.eval(wi, wo) == pytest.approx(table.eval(wi, wo), rel=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"energy": np.zeros((2, 4, 8, 8))}, "energy: shape"),
        ({"energy": np.full((2, 4, 8, 8, 1), np.nan)}, "energy: contains NaN"),
        ({"phi_i": np.array([0.0, 1.0, 2.0, 3.0])}, "evenly around"),
        ({"theta_i": np.array([0.0, 1.6])}, "theta_i: must increase"),
        ({"tilt_x_edges": np.linspace(0, 1, 9)}, "tilt_x_edges: must increase"),
        ({"channels": ("a", "b")}, "2 names for 1"),
        ({"std_error": np.full((2, 4, 8, 8, 1), -1.0)}, "negative"),
        ({"parts": {"transmission": 1}}, "parts/transmission"),
    ],
)
def test_what_is_no_table_is_refused(changes, message):
    table = table_of(0.3, 0.3, n_phi=4, cells=8, theta_i=np.radians([0, 60]))
    assert isinstance(table, AnisotropicTable)
    with pytest.raises(InputError, match=message):
        table.replace(**changes)
