"""Anisotropic tables, traced."""

import numpy as np
import pytest
from scipy import stats

from gonio.bench.anisotropic import beckmann
from gonio.core.directions import direction
from gonio.core.jit import disabled
from gonio.table.checks.anisotropic import check_anisotropic
from gonio.table.tilts import slope_widths, tilt_edges, tilt_measures
from gonio.trace.measure import measure
from gonio.trace.measurement import Measurement
from microgeometry.errors import InputError
from microgeometry.specimen import parse_specimen

pytestmark = pytest.mark.skipif(disabled, reason="needs compiled kernels")

MIRROR = {"kind": "mirror"}


def specimen(surface, material=MIRROR, **grid):
    return parse_specimen({"surface": surface, "material": material, "grid": grid})


def anisotropic(surface, material=MIRROR, **grid):
    return specimen(surface, material, anisotropic=True, **grid)


def finer(edges, n):
    return np.append((edges[:-1, None] + np.diff(edges)[:, None] * np.arange(n) / n).ravel(), edges[-1])


def joined(a, n):
    """Sums over blocks of n x n cells."""
    return a.reshape(a.shape[0] // n, n, a.shape[1] // n, n).sum(axis=(1, 3))


@pytest.fixture(scope="module")
def brushed():
    surface = {"kind": "gaussian", "alpha": 0.2, "correlation_length": [1, 6], "samples": 256}
    return measure(
        anisotropic(surface, theta_i_deg=[0, 20, 40, 60], phi_i_step_deg=30, tilt_cells=33), rays=1_500_000
    )


def test_lossless_mirrors_lose_nothing(brushed):
    """In every row, and cell by cell."""
    assert brushed.row_albedo == pytest.approx(1.0, abs=1e-12)
    assert brushed.energy.sum(axis=(2, 3)) == pytest.approx(1.0, abs=1e-5)
    assert brushed.energy.shape == (4, 12, 33, 33, 1)
    assert brushed.albedo(0.5, 1.0) == pytest.approx(1.0, abs=1e-9)


def test_checks_hold(brushed):
    report = check_anisotropic(brushed)
    assert report.passed, "\n".join(report.lines())
    assert all(check.passed for check in report.checks if check.name in ("reciprocity", "energy", "ledger"))


def test_what_is_not_reciprocal_fails(brushed):
    """Mutation: rows made brighter on one side."""
    factor = 1 + 0.5 * np.cos(brushed.phi_i)[None, :, None]
    wrong = brushed.replace(
        energy=brushed.energy * factor[..., None, None], row_albedo=brushed.row_albedo * factor
    )
    failed = {check.name for check in check_anisotropic(wrong).checks if check.passed is False}
    assert failed == {"reciprocity", "energy"}


def test_highlight_is_wide_across_the_grooves(brushed):
    """Slopes are measured from the cells at normal incidence: of the half vectors of their middles."""
    energy = brushed.energy[0, 0, :, :, 0].astype(float)
    half = brushed.cells(0, 0)[0] + [0, 0, 1]
    for axis, name in enumerate(("alpha_x", "alpha_y")):
        alpha = brushed.provenance["surface"][name]
        slopes = half[..., axis] / half[..., 2]
        inside = np.abs(slopes) < 3.5 * alpha
        width = np.sqrt(2 * np.sum((energy * slopes**2)[inside]))
        assert width == pytest.approx(alpha, rel=0.03)


def test_an_isotropic_specimen_gives_the_isotropic_table():
    """Expected energy of each block of cells, from the isotropic table of the same angle: chi^2."""
    # 4096 correlation areas: what one realisation has more of than the next is common to all cells, and no sum of
    # their variances holds it; with 256 areas it is 1.7 %
    surface = {"kind": "gaussian", "alpha": 0.4, "samples": 512, "samples_per_correlation_length": 8}
    theta = [30, 60]
    plain = measure(specimen(surface, theta_i_deg=theta), rays=4_000_000, seed=1)
    table = measure(
        anisotropic(surface, theta_i_deg=theta, phi_i_step_deg=90, tilt_cells=35), rays=1_000_000, seed=2
    )
    edges = finer(table.tilt_x_edges, 4), finer(table.tilt_y_edges, 4)
    widths = slope_widths(table.tilt_x_edges, table.tilt_y_edges)
    chi2, blocks = 0.0, 0
    for a in range(2):
        for b in range(4):
            wi = direction(table.theta_i[a], table.phi_i[b])
            wo, areas = tilt_measures(wi, *edges, widths)
            f = plain.eval(wi, wo)[..., 0] * areas
            expected = joined(f, 20)
            found = joined(table.energy[a, b, :, :, 0].astype(float), 5)
            variance = joined(table.std_error[a, b, :, :, 0].astype(float) ** 2, 5)
            lit = expected > 1e-3
            # the isotropic table's own error, and what its interpolation smears
            allowed = variance + (0.01 * expected) ** 2
            chi2 += np.sum(((found - expected) ** 2 / allowed)[lit])
            blocks += np.count_nonzero(lit)
    assert blocks > 100
    assert stats.chi2.sf(chi2, blocks) > 1e-4
    # a table that has its azimuths wrong would not pass
    assert np.abs(table.energy[1, 0] - table.energy[1, 1]).max() > 10 * table.std_error[1, 0].max()


def test_grooves_have_mirror_planes():
    """Grooves along y: x and -x, y and -y are the same, x and y are not."""
    table = measure(
        anisotropic(
            {"kind": "v_groove", "slope_deg": 25}, {"kind": "lambert", "albedo": 0.9},
            theta_i_deg=[0, 50], phi_i_step_deg=45, tilt_cells=25,
        ),
        rays=2_000_000,
    )  # fmt: skip
    energy, variance = table.energy[1, ..., 0].astype(float), table.std_error[1, ..., 0].astype(float) ** 2
    phi = np.arange(8)
    for turned, flip in (((4 - phi) % 8, np.s_[:, ::-1]), (-phi % 8, np.s_[:, :, ::-1])):
        other, error = energy[turned][flip], variance[turned][flip]
        lit = energy > 1e-4
        z = ((energy - other) / np.sqrt(variance + error + 1e-30))[lit]
        assert np.mean(z**2) < 1.2
        assert np.mean(z**2) > 0.5  # error bars that are not far too large
    # across the grooves against along them
    along, across = energy[2].T, energy[0]
    z = (along - across) / np.sqrt(variance[2].T + variance[0] + 1e-30)
    assert np.mean(z[across > 1e-4] ** 2) > 5


def test_what_goes_through_is_a_part():
    surface = {"kind": "gaussian", "alpha": 0.2, "correlation_length": [1, 3], "samples": 128}
    table = measure(
        anisotropic(
            surface, {"kind": "dielectric", "eta": 1.5}, theta_i_deg=[0, 40], phi_i_step_deg=90, tilt_cells=9
        ),
        rays=50_000,
    )
    below = table.parts["transmission"]
    assert table.row_albedo + below.row_albedo == pytest.approx(1.0, abs=1e-9)
    # refracted light goes nearly straight on: near tilt 0, where the mirror direction is
    middle = below.energy[0, 0, 2:-2, 2:-2].sum()
    assert middle > 0.9 * below.row_albedo[0, 0, 0]


def test_what_cannot_be_is_refused():
    groove = {"kind": "v_groove", "slope_deg": 25, "orientation": "random"}
    with pytest.raises(InputError, match="one orientation"):
        measure(anisotropic(groove), rays=1000)
    with pytest.raises(InputError, match="half-vector does not do for anisotropic"):
        measure(anisotropic({"kind": "gaussian", "alpha": 0.2}), rays=1000, estimator="half-vector")


def test_goes_on_to_the_same_bits_and_to_a_target():
    given = anisotropic(
        {"kind": "gaussian", "alpha": 0.3, "samples": 512},
        theta_i_deg=[0, 40],
        phi_i_step_deg=120,
        tilt_cells=9,
    )
    straight, first, second = (Measurement(given, 50_000, seed=5) for _ in range(3))
    for _ in range(6):
        straight.add_batch()
    for _ in range(3):
        first.add_batch()
    second.restore({name: np.array(a) for name, a in first.state().items()})
    for _ in range(3):
        second.add_batch()
    assert np.array_equal(straight.table().energy, second.table().energy)
    assert np.array_equal(straight.table().std_error, second.table().std_error)
    table = measure(given, rays=2_000_000, target_error=0.1)
    assert table.provenance["target_met"] is True
    assert table.ledger["paths"] < 2_000_000


@pytest.mark.slow
def test_traced_brushed_metal_is_within_one_percent_of_the_closed_form():
    """Slopes so small that nothing is shadowed; the product of two runs' errors holds no noise.

    Incidences between the rows, the norm compression's.
    """
    surface = {"kind": "gaussian", "alpha": 0.07, "correlation_length": [1, 28]}
    given = anisotropic(surface, theta_i_deg=[0, 25, 50], phi_i_step_deg=60)
    runs = [measure(given, rays=6_000_000, seed=seed) for seed in (1, 2)]
    alpha = [np.mean([run.provenance["surface"][name] for run in runs]) for name in ("alpha_x", "alpha_y")]
    edges = [tilt_edges(width, 130) for width in alpha]
    for theta in (0.1, 0.3, 0.6, 0.8):
        wi = direction(theta, 1.0 + theta)
        wo, areas = tilt_measures(wi, *edges)
        wo, areas = wo.reshape(-1, 3), areas.ravel()
        exact = beckmann(np.broadcast_to(wi, wo.shape), wo, *alpha)[:, 0]
        one, other = (run.eval(wi, wo)[:, 0] - exact for run in runs)
        assert abs(np.sum(areas * one * other)) < 0.01**2 * np.sum(areas * exact**2)
        assert np.sum(areas * (one - other) ** 2) < 2 * 0.03**2 * np.sum(
            areas * exact**2
        )  # or it says nothing
