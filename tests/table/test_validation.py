"""The validation kit itself: a correct model passes, each kind of mistake fails."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.quadrature import Quadrature
from gonio.validation import check_furnace, check_reciprocity, seed_from, sidak, validate

EXPONENT = 20.0


def spread(wo):
    """Density of a power-cosine lobe about the normal."""
    return np.where(wo[..., 2] > 0, (EXPONENT + 1) / (2 * np.pi) * np.maximum(wo[..., 2], 0) ** EXPONENT, 0.0)


def axis(wi):
    """A lobe's axis that depends on wi, so that wi and wo cannot be exchanged: wi bent to the normal."""
    bent = wi + np.array([0.0, 0.0, 1.0])
    return bent / np.linalg.norm(bent, axis=-1, keepdims=True)


def local(wi):
    """Orthonormal frames about the lobe's axis, shape (..., 3, 3): rows are tangents and axis."""
    n = axis(wi)
    helper = np.where(np.abs(n[..., 2:]) > 0.99, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    s = np.cross(helper, n)
    s /= np.linalg.norm(s, axis=-1, keepdims=True)
    return np.stack([s, np.cross(n, s), n], axis=-2)


def pdf(wi, wo):
    cos = np.sum(axis(wi) * wo, axis=-1)
    density = (EXPONENT + 1) / (2 * np.pi) * np.maximum(cos, 0) ** EXPONENT
    return np.where((wo[..., 2] > 0) & (wi[..., 2] >= 0), density, 0.0)


def sample(wi, u):
    cos = u[..., 0] ** (1 / (EXPONENT + 1))
    sin, phi = np.sqrt(1 - cos**2), 2 * np.pi * u[..., 1]
    lobe = np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=-1)
    wo = np.einsum("...ij,...i->...j", local(wi), lobe)
    return wo, pdf(wi, wo)


def brdf(wi, wo):
    """f cos_o proportional to the density: constant weight."""
    return (0.7 * pdf(wi, wo) / np.maximum(wo[..., 2], 1e-9))[..., None] * np.array([1.0, 0.5])


def run(eval=brdf, sample=sample, pdf=pdf, theta_i=(0.3, 1.0), **options):
    return validate(eval, sample, pdf, "the kit", theta_i, 50_000, reciprocal=False, exact=True, **options)


def failures(report):
    return [o.name for o in report.outcomes if not o.passed]


def test_correct_model_passes():
    report = run()
    assert report.passed, report.lines()
    assert len(report.lines()) == len(report.outcomes)


@pytest.mark.parametrize("factor", [0.98, 1.02])
def test_pdf_off_by_two_percent(factor):
    """Consistently wrong, in pdf() and in what sample() returns."""

    def wrong(wi, wo):
        return factor * pdf(wi, wo)

    def drawn(wi, u):
        wo, density = sample(wi, u)
        return wo, factor * density

    assert any(name.startswith("integral") for name in failures(run(pdf=wrong, sample=drawn)))


def test_reflectance_off_by_two_percent_where_pdf_is_right():
    """Values that are not what is sampled: the weight is constant no more."""

    def wrong(wi, wo):
        return brdf(wi, wo) * (1 + 0.02 * (wo[..., :1] > 0))

    assert any(name.startswith("weight of the channel mean") for name in failures(run(eval=wrong)))


def test_sampled_density_differs_from_pdf():
    def drawn(wi, u):
        wo, density = sample(wi, u)
        return wo, 1.02 * density

    assert any(name.startswith("pdf of sample") for name in failures(run(sample=drawn)))


def test_tilted_frame():
    c, s = np.cos(0.05), np.sin(0.05)
    tilt = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])

    def tilted_pdf(wi, wo):
        return pdf(wi @ tilt.T, wo @ tilt.T)

    def tilted_sample(wi, u):
        wo, density = sample(wi @ tilt.T, u)
        return wo @ tilt, density

    names = failures(run(lambda wi, wo: brdf(wi @ tilt.T, wo @ tilt.T), tilted_sample, tilted_pdf))
    assert "nothing below the horizon" in names
    assert "values after a turn about the normal" in names
    assert "densities after a turn about the normal" in names


def test_wi_and_wo_flipped():
    assert any("chi^2" in name for name in failures(run(pdf=lambda wi, wo: pdf(wo, wi))))
    assert any(
        "weight of the channel mean" in name for name in failures(run(eval=lambda wi, wo: brdf(wo, wi)))
    )
    assert any(
        "above the horizon" in name
        for name in failures(run(sample=lambda wi, u: (-sample(wi, u)[0], sample(wi, u)[1])))
    )


def test_inward_wi():
    """The light's direction taken as that of propagation."""
    report = run(lambda wi, wo: brdf(-wi, wo), lambda wi, u: sample(-wi, u), lambda wi, wo: pdf(-wi, wo))
    assert "nothing below the horizon" in failures(report)


def test_nan_and_negative_values_fail():
    names = failures(run(eval=lambda wi, wo: np.where(wo[..., 2:] > 0.9, np.nan, brdf(wi, wo))))
    assert any("finite" in name for name in names)
    names = failures(run(eval=lambda wi, wo: brdf(wi, wo) - 1e-3 * (wo[..., 2:] > 0)))
    assert any(name.startswith("furnace") for name in names)


def test_too_much_energy():
    assert not check_furnace(lambda wi, wo: np.full((*wo.shape[:-1], 1), 1.01 / np.pi), 0.4).passed
    assert check_furnace(lambda wi, wo: np.full((*wo.shape[:-1], 1), 1.0 / np.pi), 0.4).passed


def test_reciprocity():
    rng = np.random.default_rng(seed_from("reciprocity of the kit"))
    assert not check_reciprocity(brdf, rng).passed
    assert check_reciprocity(lambda wi, wo: wi[..., 2:] * wo[..., 2:], rng).passed


def test_bounded_weights():
    assert run(max_weight=0.71).passed
    assert not run(max_weight=0.69).passed


def test_quadrature_converges():
    """The integral of cos^2 over the hemisphere is 2 pi/3."""
    integrals, errors = Quadrature((4, 4)).integrate(lambda w: w[:, 2] ** 2)
    np.testing.assert_allclose(integrals.sum(), 2 * np.pi / 3, atol=3 * errors.sum() + 1e-12)
    assert errors.sum() < 1e-3


def test_false_alarms_have_the_rate_stated():
    assert 1 - (1 - sidak(1e-3, 200)) ** 200 == pytest.approx(1e-3)


def test_chi_squared_p_values_are_uniform():
    """p-values of the coarse bins over repeated runs of a correct sampler: Kolmogorov-Smirnov."""
    from scipy import stats

    from gonio.validation import check_sampling

    rng = np.random.default_rng(seed_from("uniform p"))
    p = [
        outcome.p_value
        for _ in range(60)
        for outcome in check_sampling(sample, pdf, 0.6, rng, 5000, Quadrature((16, 32)))
        if outcome.p_value is not None and "coarse" in outcome.name
    ]
    assert stats.kstest(p, "uniform").pvalue > 1e-3
