"""Fits an analytic model to a table: the search over shapes, the coefficients of each, the account."""

from __future__ import annotations

import math
import time

import numpy as np

from fitting.account import account
from fitting.confidence import Confidence, confidence, describe, goodness
from fitting.levels import refine
from fitting.models import Model, find_model
from fitting.objectives import default_objective, find_objective
from fitting.problem import Point, Problem
from fitting.result import Fit, FittedLobe, versions
from fitting.samples import Samples
from fitting.search import Budget, descend, explore
from fitting.tabulate import albedo_check, reciprocity_check
from gonio.progress import Report
from gonio.table.table import Table
from microgeometry.errors import InputError

REJECTED = 1e-3
"""Probability below which a fit says that the model cannot be what was measured."""

LATE = "the time limit ended the search; the parameters are the best met until then"
"""Among the notes of a fit that was."""

_SMALLEST, _LARGEST = 1e-30, 1e30  # their squares, and those of coefficients, are still numbers


def fit(
    data: Table | Samples,
    model: str | Model,
    *,
    objective: str | None = None,
    seed: int = 0,
    max_seconds: float = 60.0,
    progress: Report | None = None,
) -> Fit:
    """Find the parameters of a model that describe a table best.

    A global stage (nlopt's multi-level single linkage) searches the shape parameters on some thousand
    cells; steps of Levenberg and Marquardt end it on all of them. The coefficients are the best non-negative
    ones. A cell's value is compared with the model's average over the cell.

    Parameters
    ----------
    data : Table or Samples
        Of a table, cells beyond 80 degrees, gaps and cells without information are left out.
    model : str or Model
        A name of `fitting.models.MODELS`, or a sum of lobes and models, as in "ggx+ggx+lambert".
    objective : str, optional
        One of `fitting.objectives`; default: "chi2" where standard errors are known, else "ngan_l2". The others,
        low_log, nbrdf and cube_root, are biased on a table of few hits a cell: they find faint lobes too dark.
    seed : int
        Where the global stage starts.
    max_seconds : float
        The best found so far is returned after this time; kernels compile in it on first use.
    progress : callable, optional
        Called with the fraction done and a few words.

    Returns
    -------
    Fit

    Raises
    ------
    InputError
        Unknown model or objective, an anisotropic model, absurd values, or no cell left to fit.
    """
    began = time.perf_counter()
    if not max_seconds > 0:
        raise InputError(f"max_seconds: {max_seconds!r}; a positive number is allowed")
    chosen = find_model(model) if isinstance(model, str) else model
    for lobe in chosen.lobes:
        if not lobe.isotropic:
            raise InputError(
                f"model: {lobe.name} is anisotropic, and the data hold the difference of the azimuths only; "
                "an isotropic model is needed"
            )
    samples = data if isinstance(data, Samples) else Samples.of_table(data)
    largest = float(np.abs(samples.values).max())
    if largest != 0.0 and not _SMALLEST < largest < _LARGEST:
        raise InputError(
            f"values: the largest is {largest:.3g}; from {_SMALLEST:g} to {_LARGEST:g} is allowed, a BRDF is in 1/sr"
        )
    name = objective or default_objective(samples)
    measured = find_objective(samples, name)
    budget = Budget(began + max_seconds, progress=progress)

    point = explore(chosen.lobes, samples, measured, budget, seed)
    final = Problem(chosen.lobes, samples, measured, np.zeros(len(samples.cells), np.int8))
    refine(final, point.x, point.coefficients)
    point = descend(final, final.evaluate(point.x, point.coefficients), budget, (0.5, 1.0))
    late = budget.late
    seen = account(final, point)
    certain = confidence(final, point, seen)

    result = Fit(
        model=chosen.name,
        lobes=_lobes(final, point),
        channels=samples.channels,
        wavelengths_nm=samples.wavelengths_nm,
        objective=name,
        residuals=seen.metrics,
        degrees_of_freedom=samples.values.size - final.size,
        goodness=goodness(seen, samples.values.size, final.size, samples.estimated),
        criterion=criterion(name, seen.metrics, samples.values.size, final),
        confidence=None if certain is None else describe(final, point, certain),
        evaluations=budget.evaluations + final.evaluations,
        cells_used=len(samples.cells),
        cells_left_out=samples.left_out,
        theta_limit_deg=samples.theta_limit_deg,
        provenance=samples.provenance,
        versions=versions(),
    )
    return result.replace(
        albedo=albedo_check(result),
        reciprocity=reciprocity_check(result),
        notes=_notes(result, samples, certain, late),
        seconds=time.perf_counter() - began,
    )


def criterion(objective: str, metrics: dict[str, float], values: int, problem: Problem) -> float:
    """Bayes' information criterion (Schwarz 1978): -2 log likelihood + unknowns x log(values).

    The likelihood is the one the objective stands for: chi2 with the table's errors; for the others errors of
    one unknown size, Gaussian in the weighted difference, or Laplace's for nbrdf. A constant is left out, so
    criteria compare models of one objective on the same cells. Akaike's, even corrected for small samples,
    charges 2 for an unknown however many values there are: of a million cells it would call noise a lobe.
    """
    penalty = problem.size * math.log(values)
    if objective == "chi2":
        return metrics["chi2"] + penalty
    floor = 1e-30 * problem.norm  # a perfect fit is finite
    if objective == "nbrdf":
        return 2.0 * values * math.log(max(metrics["nbrdf"], floor / values)) + penalty
    total = metrics[objective] ** 2 * values if objective == "cube_root" else metrics[objective]
    return values * math.log(max(total, floor) / values) + penalty


def _lobes(problem: Problem, point: Point) -> tuple[FittedLobe, ...]:
    """The numbers by name."""
    values = problem.values(point.x)
    names = problem.coefficients.names
    return tuple(
        FittedLobe(
            lobe.name,
            {q.name: values[i][j] for j, q in enumerate(lobe.parameters)},
            {
                coefficient: dict(
                    zip(problem.samples.channels, point.coefficients[row].tolist(), strict=True)
                )
                for row, (owner, coefficient) in enumerate(names)
                if owner == i
            },
        )
        for i, lobe in enumerate(problem.lobes)
    )


def _notes(result: Fit, samples: Samples, certain: Confidence | None, late: bool) -> tuple[str, ...]:
    """What a reader of the numbers should know."""
    notes = []
    if late:
        notes.append(LATE)
    if not np.any(samples.values > 0):
        notes.append("no value is above 0: all coefficients are 0 and the shape parameters mean nothing")
    elif certain is None:
        notes.append("fewer values than parameters: the parameters are one choice of many")
    else:
        for lobe in result.lobes:
            if lobe.parameters and not any(v > 0 for c in lobe.coefficients.values() for v in c.values()):
                notes.append(f"lobe {lobe.name} has coefficient 0: its shape parameters mean nothing")
    if result.goodness is not None and result.goodness["p_value"] < REJECTED:
        notes.append(
            "the model does not describe the table: what is left over is more than its errors "
            f"(p = {result.goodness['p_value']:.2g})"
        )
    return tuple(notes)
