"""Phase functions: normalised, of the stated mean cosine, and sampled as they are valued."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2

from gonio.core.phase import (
    HG,
    ISOTROPIC,
    RAYLEIGH,
    TABULATED,
    hg,
    phase_sample,
    phase_value,
    rayleigh_polarisation,
    sample_hg,
    tabulated_cdf,
)

NOTHING = np.empty(0)
NODES, WEIGHTS = np.polynomial.legendre.leggauss(16)


def table(cosines, shape):
    """Tabulated phase function (kind, g, cosines, values) of a shape not yet normalised."""
    cosines, shape = np.array(cosines, float), np.array(shape, float)
    area = math.pi * np.sum((shape[1:] + shape[:-1]) * np.diff(cosines))
    return TABULATED, 0.0, cosines, shape / area


CASES = {
    "isotropic": (ISOTROPIC, 0.0, NOTHING, NOTHING),
    "rayleigh": (RAYLEIGH, 0.0, NOTHING, NOTHING),
    **{f"hg {g}": (HG, g, NOTHING, NOTHING) for g in (0.0, 1e-9, 0.05, -0.3, 0.8, -0.95, 0.999, -0.999)},
    "line": table([-1, 1], [0, 1]),
    "flat": table([-1, 1], [1, 1]),
    "gap": table([-1, -0.5, -0.2, 0.1, 0.7, 1], [0, 0, 1, 0, 0, 3]),
    "peak": table(np.cos(np.linspace(math.pi, 0, 181)), 1e-3 + np.exp(-np.linspace(math.pi, 0, 181) / 0.05)),
}
every = pytest.mark.parametrize("name", CASES)


def sampler(case):
    cdf = tabulated_cdf(*case[2:]) if case[0] == TABULATED else NOTHING
    return lambda u: phase_sample(*case, cdf, u)


def fine_edges(case):
    """Bins from -1 to 1 that resolve every case: a peak at either end, the corners of a table."""
    ends = np.geomspace(1e-9, 1, 120)
    return np.unique(np.concatenate([[-1, 0, 1], ends - 1, 1 - ends, case[2]]))


def integrals(case, edges, power=0):
    """2 pi integral of cos^power p over each bin, by Gauss' rule: nothing but `phase_value`."""
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    cosines = middle[:, None] + half[:, None] * NODES
    values = np.array([phase_value(*case, c) for c in cosines.ravel()]).reshape(cosines.shape)
    return 2 * math.pi * half * ((values * cosines**power) @ WEIGHTS)


@every
def test_normalised(name):
    case = CASES[name]
    assert integrals(case, fine_edges(case)).sum() == pytest.approx(1.0, abs=1e-10)


@pytest.mark.parametrize("g", [0.0, 1e-9, 0.05, -0.3, 0.8, -0.95, 0.999, -0.999])
def test_g_is_the_mean_cosine(g):
    case = HG, g, NOTHING, NOTHING
    assert integrals(case, fine_edges(case), 1).sum() == pytest.approx(g, abs=1e-10)


@every
def test_sampling_inverts_the_cumulative_integral(name):
    case = CASES[name]
    edges = fine_edges(case)
    cumulative = np.concatenate([[0.0], np.cumsum(integrals(case, edges))])
    sample = sampler(case)
    previous = -1.0
    for u in (0.0, 1e-12, 1e-5, *np.linspace(0.001, 0.999, 97), 1 - 1e-5, 1 - 2**-53):
        c = sample(u)
        assert previous <= c <= 1.0
        previous = c
        i = int(np.clip(np.searchsorted(edges, c, side="right") - 1, 0, len(edges) - 2))
        below = integrals(case, np.array([edges[i], c]))[0] if c > edges[i] else 0.0
        # the peak of g = .999 has a density of 1e6: a rounding of the cosine moves u by 1e-10
        assert cumulative[i] + below == pytest.approx(u, abs=1e-9)


@every
@pytest.mark.parametrize("bins", [6, 300])
def test_samples_are_distributed_as_the_values(name, bins):
    """chi^2 of independent samples on coarse and on fine bins, the fine ones merged to 20 expected samples."""
    case, count = CASES[name], 40_000
    rng = np.random.default_rng([bins, *name.encode()])
    sample = sampler(case)
    samples = np.array([sample(u) for u in rng.random(count)])
    edges = fine_edges(case)
    expected = count * integrals(case, edges)
    # merge neighbours into bins of equal expectation, at least 20 samples each
    target = max(20.0, count / bins)
    group = np.minimum((np.cumsum(expected) - 0.5 * expected) // target, count // target - 1).astype(int)
    _, group = np.unique(group, return_inverse=True)
    seen = np.bincount(group, np.histogram(samples, edges)[0])
    hoped = np.bincount(group, expected)
    statistic = np.sum((seen - hoped) ** 2 / np.maximum(hoped, 1e-300))
    assert len(hoped) > 3
    assert chi2.sf(statistic, len(hoped) - 1) > 1e-4


@pytest.mark.parametrize("g", [1e-300, 1e-17, 1e-9, 1e-5, -1e-5])
def test_hg_near_isotropic_does_not_cancel(g):
    # p = (1 + 3 g cos) / (4 pi) + O(g^2), so cdf = (1 + c)/2 + 3/4 g (c^2 - 1) = u and c = x + 3/2 g (1 - x^2)
    for u in (0.0, 0.1, 0.5, 0.77, 1.0):
        x = 2 * u - 1
        assert sample_hg(g, u) == pytest.approx(x + 1.5 * g * (1 - x * x), abs=3e-16 + 5 * g * g)
        assert hg(g, x) == pytest.approx((1 + 3 * g * x) / (4 * math.pi), abs=1e-16 + 5 * g * g)


def test_hg_peak_to_full_precision():
    # (1 + g) / (4 pi (1 - g)^2) straight ahead
    g = 1 - 2**-30
    assert hg(g, 1.0) == pytest.approx((1 + g) * 2.0**60 / (4 * math.pi), rel=1e-14)
    assert hg(-g, -1.0) == hg(g, 1.0)
    assert sample_hg(g, 0.0) == -1.0
    assert sample_hg(g, 1.0) == 1.0


def test_hg_zero_is_isotropic():
    assert [sample_hg(0.0, u) for u in (0.0, 0.25, 0.9)] == [-1.0, -0.5, 0.8]
    assert hg(0.0, 0.3) == 0.25 / math.pi


@pytest.mark.parametrize("cosine", [-1.0, -0.4, 0.0, 1.0])
def test_rayleigh_is_its_polarised_mean(cosine):
    a_s2, a_p2, cross = rayleigh_polarisation(cosine)
    assert phase_value(RAYLEIGH, 0.0, NOTHING, NOTHING, cosine) == pytest.approx(
        3 / (16 * math.pi) * (1 + cosine**2), rel=1e-15
    )
    assert a_s2 + a_p2 == pytest.approx(2.0, rel=1e-15)
    assert (a_p2, cross) == pytest.approx((a_s2 * cosine**2, a_s2 * cosine), rel=1e-15)


def test_table_goes_through_its_points_and_straight_between():
    _, _, cosines, values = case = table([-1, -0.5, 0.25, 1], [1, 4, 2, 8])
    for c, v in zip(cosines, values, strict=True):
        assert phase_value(*case, c) == pytest.approx(v, rel=1e-15)
    assert phase_value(*case, -0.75) == pytest.approx(0.5 * (values[0] + values[1]), rel=1e-15)
    assert phase_value(*case, 0.4) == pytest.approx(0.8 * values[2] + 0.2 * values[3], rel=1e-15)


def test_table_never_scatters_into_its_gaps():
    sample = sampler(CASES["gap"])
    for u in np.linspace(0, 1, 10001):
        c = sample(u)
        assert -0.5 <= c <= 0.1 or 0.7 <= c <= 1.0


def test_rounding_at_the_corners_of_a_table_leads_nowhere_else():
    rng = np.random.default_rng(9)
    for _ in range(300):
        corners = np.sort(np.concatenate([[-1, 1], rng.uniform(-1, 1, 4)]))
        case = table(corners, rng.uniform(0, 1, 6) * rng.integers(0, 2, 6) + [0, 0, 1e-3, 1, 0, 0])
        cdf = tabulated_cdf(*case[2:])
        for i in range(5):
            for u in (cdf[i], np.nextafter(cdf[i], 1.0), np.nextafter(cdf[i + 1], 0.0)):
                if cdf[i] <= u < cdf[i + 1]:
                    assert corners[i] <= phase_sample(*case, cdf, float(u)) <= corners[i + 1]


def test_cdf_ends_at_one():
    cdf = tabulated_cdf(*CASES["peak"][2:])
    assert (cdf[0], cdf[-1]) == (0.0, 1.0)
    assert np.all(np.diff(cdf) > 0)
