"""The validation kit: what every BRDF that can be evaluated and sampled must satisfy.

It runs on any three functions, vectorised over arrays of directions in the local frame (z the normal,
`wi` to the light, `wo` to the detector, both away from the surface):

- ``eval(wi, wo)``: f_r in 1/sr without cosine, shape (..., C); 0 where either direction has z < 0.
- ``sample(wi, u)``: from numbers uniform in [0, 1), shape (..., 3), to ``wo`` and its density ``pdf`` per
  solid angle; pdf = 0 marks a sample to be discarded.
- ``pdf(wi, wo)``: that density, shape (...).

Analytic models, tables and format adapters are all held to it; `validate` runs everything. A p-value is
judged against a level corrected for the number of tests made (Sidak), so a correct model fails one run of
`validate` in a thousand, however many directions are asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gonio.core.directions import direction
from gonio.outcomes import FALSE_ALARM, Outcome, Report, chi_squared, close, finite, join, seed_from, sidak
from gonio.quadrature import Quadrature

Array = NDArray[np.float64]
Eval = Callable[[Array, Array], Array]
Sample = Callable[[Array, Array], tuple[Array, Array]]
Pdf = Callable[[Array, Array], Array]

__all__ = [
    "FALSE_ALARM",
    "Outcome",
    "Quadrature",
    "Report",
    "check_frame",
    "check_furnace",
    "check_reciprocity",
    "check_sampling",
    "check_weights",
    "seed_from",
    "sidak",
    "validate",
]


def check_sampling(
    sample: Sample,
    pdf: Pdf,
    theta_i: float,
    rng: np.random.Generator,
    n: int = 200_000,
    quadrature: Quadrature | None = None,
) -> list[Outcome]:
    """Samples against their density: chi^2 on fine and coarse bins, integral, agreement of the two densities.

    Parameters
    ----------
    sample, pdf : callable
        As described at the top of this module.
    theta_i : float
        Radians; the azimuth is drawn from `rng`.
    rng : Generator
    n : int
        Samples drawn.
    quadrature : Quadrature, optional
        Its bins are the fine ones; the coarse ones join 4 x 4 of them.

    Returns
    -------
    list of Outcome
        The chi^2 tests carry p-values; bins expected to hold fewer than 5 samples are pooled, and samples
        discarded are a bin of their own.
    """
    quadrature = quadrature or Quadrature()
    at = f"at theta_i = {np.degrees(theta_i):.4g} deg"
    wi = direction(theta_i, rng.uniform(0.0, 2.0 * np.pi))
    wo, density = sample(np.broadcast_to(wi, (n, 3)), rng.random((n, 3)))
    kept = density > 0
    outcomes = [
        finite(f"samples finite {at}", wo, density),
        Outcome(
            f"samples above the horizon {at}",
            bool(np.all(wo[kept, 2] >= 0)),
            f"{np.count_nonzero(wo[kept, 2] < 0)} of {n} below",
        ),
        close(
            f"pdf of sample and pdf() {at}", density[kept], pdf(np.broadcast_to(wi, wo[kept].shape), wo[kept])
        ),
    ]
    integrals, errors = quadrature.integrate(lambda w: pdf(np.broadcast_to(wi, w.shape), w))
    total, accepted = float(integrals.sum()), np.count_nonzero(kept) / n
    # Deterministic where nothing is discarded; else against the fraction that survived
    allowed = 1e-3 + 2 * abs(float(errors.sum())) + 5 * np.sqrt(accepted * (1 - accepted) / n)
    outcomes.append(
        Outcome(
            f"integral of pdf {at}", abs(total - accepted) <= allowed, f"{total:.6f}, expected {accepted:.6f}"
        )
    )
    theta = np.arctan2(np.hypot(wo[kept, 0], wo[kept, 1]), wo[kept, 2])
    phi = np.arctan2(wo[kept, 1], wo[kept, 0]) % (2 * np.pi)
    counts = np.histogram2d(theta, phi, quadrature.bins, [[0, 0.5 * np.pi], [0, 2 * np.pi]])[0]
    for label, side in (("fine", 1), ("coarse", 4)):
        observed = np.append(join(counts, side), n - np.count_nonzero(kept))
        expected = np.append(join(n * integrals, side), max(0.0, n * (1.0 - total)))
        blur = np.append(join(n * errors, side), n * errors.sum())
        chi2, dof = chi_squared(observed, expected, blur)
        p = float(stats.chi2.sf(chi2, dof)) if dof > 0 else 1.0
        outcomes.append(
            Outcome(f"chi^2 on {label} bins {at}", p > FALSE_ALARM, f"{chi2:.1f} for {dof}, p = {p:.3g}", p)
        )
    return outcomes


def check_weights(
    eval: Eval,
    sample: Sample,
    theta_i: float,
    rng: np.random.Generator,
    n: int = 100_000,
    exact: bool = False,
    max_weight: float | None = None,
    quadrature: Quadrature | None = None,
) -> list[Outcome]:
    """Importance-sampled reflectance against quadrature, and the size of the weights f cos/pdf.

    Parameters
    ----------
    eval, sample : callable
        As described at the top of this module.
    theta_i : float
        Radians.
    rng : Generator
    n : int
        Samples drawn.
    exact : bool
        Demand that the weight of the channel mean is the same for every sample.
    max_weight : float, optional
        Demand that no channel's weight exceeds this.
    quadrature : Quadrature, optional

    Returns
    -------
    list of Outcome
    """
    at = f"at theta_i = {np.degrees(theta_i):.4g} deg"
    wi = direction(theta_i, rng.uniform(0.0, 2.0 * np.pi))
    wo, density = sample(np.broadcast_to(wi, (n, 3)), rng.random((n, 3)))
    kept = density > 0
    weights = np.zeros((n, eval(wi, wo[:1]).shape[-1]))
    values = eval(np.broadcast_to(wi, wo[kept].shape), wo[kept])
    weights[kept] = values * (wo[kept, 2] / density[kept])[:, None]
    integrals, errors = (quadrature or Quadrature()).integrate(
        lambda w: eval(np.broadcast_to(wi, w.shape), w) * w[:, 2:]
    )
    albedo, blur = integrals.sum(axis=(0, 1)), errors.sum(axis=(0, 1))
    estimate = weights.mean(axis=0)
    sigma = np.sqrt(weights.var(axis=0) / n + (blur + 1e-6 * albedo) ** 2) + np.finfo(float).tiny
    z = float(np.max(np.abs(estimate - albedo) / sigma))
    p = float(-np.expm1(len(albedo) * np.log1p(-2 * stats.norm.sf(z)))) if z > 0 else 1.0
    outcomes = [
        finite(f"weights finite {at}", weights),
        Outcome(
            f"reflectance by samples {at}",
            p > FALSE_ALARM,
            f"{np.round(estimate, 6)}, by quadrature {np.round(albedo, 6)}, z = {z:.2f}",
            p,
        ),
    ]
    if exact and np.any(kept):
        mean = weights.mean(axis=1)
        outcomes.append(close(f"weight of the channel mean constant {at}", mean[kept], np.median(mean[kept])))
    if max_weight is not None:
        largest = float(weights.max())
        outcomes.append(
            Outcome(f"weights bounded {at}", largest <= max_weight, f"{largest:.4g} of {max_weight:.4g}")
        )
    return outcomes


def check_reciprocity(eval: Eval, rng: np.random.Generator, n: int = 2000, rtol: float = 1e-6) -> Outcome:
    """f(wi, wo) = f(wo, wi) at random pairs of directions, relative to the larger of the two."""
    wi, wo = _hemisphere(rng, n), _hemisphere(rng, n)
    return close("reciprocity", eval(wi, wo), eval(wo, wi), rtol)


def check_furnace(eval: Eval, theta_i: float, quadrature: Quadrature | None = None) -> Outcome:
    """Energy: no channel reflects more than it receives, nothing is negative, NaN or infinite."""
    wi = direction(theta_i)
    lowest = []

    def reflected(wo: Array) -> Array:
        values = eval(np.broadcast_to(wi, wo.shape), wo)
        lowest.append(float(values.min()))
        return values * wo[:, 2:]

    integrals, errors = (quadrature or Quadrature()).integrate(reflected)
    albedo, blur = integrals.sum(axis=(0, 1)), errors.sum(axis=(0, 1))
    passed = bool(np.all(albedo <= 1 + 1e-3 + 2 * blur) and min(lowest) >= 0)
    return Outcome(
        f"furnace at theta_i = {np.degrees(theta_i):.4g} deg",
        passed,
        f"albedo {np.round(albedo, 6)}, lowest value {min(lowest):.3g}",
    )


def check_frame(
    eval: Eval,
    pdf: Pdf,
    rng: np.random.Generator,
    n: int = 2000,
    rtol: float = 1e-6,
    isotropic: bool = True,
) -> list[Outcome]:
    """The local frame: z is the normal and the sense is outward, nothing depends on the absolute azimuth.

    Values and densities vanish where either direction is below the horizon and, for isotropic models, are
    the same after a rotation about z and after a reflection at the plane of incidence.
    """
    wi, wo = _hemisphere(rng, n), _hemisphere(rng, n)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    flip, mirror = np.array([1, 1, -1]), np.array([1, -1, 1])
    below = [eval(wi * flip, wo), eval(wi, wo * flip), pdf(wi * flip, wo), pdf(wi, wo * flip)]
    worst = max(float(np.abs(v).max()) for v in below)
    outcomes = [Outcome("nothing below the horizon", worst == 0.0, f"largest value or density {worst:.3g}")]
    for label, function in (("values", eval), ("densities", pdf)) if isotropic else ():
        there = function(wi, wo)
        outcomes += [
            close(f"{label} after a turn about the normal", function(wi @ turn.T, wo @ turn.T), there, rtol),
            close(f"{label} after a reflection", function(wi * mirror, wo * mirror), there, rtol),
        ]
    return outcomes


def validate(
    eval: Eval,
    sample: Sample,
    pdf: Pdf,
    name: str,
    theta_i: Sequence[float] = (0.0, 0.5, 1.0, 1.5),
    n: int = 200_000,
    reciprocal: bool = True,
    exact: bool = False,
    max_weight: float | None = None,
    quadrature: Quadrature | None = None,
    isotropic: bool = True,
) -> Report:
    """Run the whole kit.

    Parameters
    ----------
    eval, sample, pdf : callable
        As described at the top of this module.
    name : str
        Name of the model; fixes the random numbers.
    theta_i : sequence of float
        Angles of incidence to test, radians.
    n : int
        Samples per angle.
    reciprocal : bool
        Whether the model claims f(wi, wo) = f(wo, wi).
    exact, max_weight
        See `check_weights`.
    quadrature : Quadrature, optional
        Finer for lobes narrower than about a degree.
    isotropic : bool
        Whether the model claims to depend on the difference of the azimuths only.

    Returns
    -------
    Report
    """
    rng = np.random.default_rng(seed_from(name))
    outcomes = check_frame(eval, pdf, rng, isotropic=isotropic)
    if reciprocal:
        outcomes.append(check_reciprocity(eval, rng))
    for angle in theta_i:
        outcomes += check_sampling(sample, pdf, angle, rng, n, quadrature)
        outcomes += check_weights(eval, sample, angle, rng, n, exact, max_weight, quadrature)
        outcomes.append(check_furnace(eval, angle, quadrature))
    level = sidak(FALSE_ALARM, sum(o.p_value is not None for o in outcomes))
    return Report(
        tuple(
            o if o.p_value is None else Outcome(o.name, o.p_value > level, o.detail, o.p_value)
            for o in outcomes
        )
    )


def _hemisphere(rng: np.random.Generator, n: int) -> Array:
    """Directions uniform in solid angle on the upper hemisphere, shape (n, 3)."""
    return direction(np.arccos(rng.uniform(0.0, 1.0, n)), rng.uniform(0.0, 2.0 * np.pi, n))
