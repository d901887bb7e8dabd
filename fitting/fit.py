"""Fits an analytic model to a table: the search over shapes, the coefficients of each, the account."""

from __future__ import annotations

import time

import numpy as np

from fitting.metrics import metrics, weights
from fitting.models import SHAPE, find_model
from fitting.result import Fit, FittedLobe, versions
from fitting.samples import Samples
from fitting.search import Budget, coarse, polish, refined, search
from fitting.tabulate import albedo_check
from gonio.progress import Report
from gonio.table.table import Table
from microgeometry.errors import InputError


def fit(
    data: Table | Samples,
    model: str,
    *,
    objective: str | None = None,
    seed: int = 0,
    max_seconds: float = 60.0,
    progress: Report | None = None,
) -> Fit:
    """Find the parameters of a model that describe a table best.

    A global stage (nlopt's multi-level single linkage) searches the shape parameters on some thousand
    cells; a local one (sequential quadratic programming) ends it on all of them. For every shape the
    coefficients are the best non-negative ones. A cell's value is compared with the model's average over
    the cell.

    Parameters
    ----------
    data : Table or Samples
        Of a table, cells beyond 80 degrees, gaps and cells without information are left out.
    model : str
        A name of `fitting.models.MODELS`.
    objective : str, optional
        "chi2" (default where standard errors are known) or "ngan_l2"; see `fitting.metrics`.
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
        Unknown model or objective, an anisotropic model, or no cell left to fit.
    """
    began = time.perf_counter()
    if not max_seconds > 0:
        raise InputError(f"max_seconds: {max_seconds!r}; a positive number is allowed")
    chosen = find_model(model)
    for lobe in chosen.lobes:
        if not lobe.isotropic:
            raise InputError(
                f"model: {lobe.name} is anisotropic, and the data hold the difference of the azimuths only; "
                "an isotropic model is needed"
            )
    samples = data if isinstance(data, Samples) else Samples.of_table(data)
    name = objective or ("chi2" if samples.variance is not None else "ngan_l2")
    weight = weights(samples, name)
    budget = Budget(began + max_seconds, progress=progress)

    rough = coarse(chosen.lobes, samples, weight)
    x = np.random.default_rng(seed).random(len(rough.parameters))
    if len(x):
        x = search(rough, x, budget, seed)
    final = refined(rough, x, samples, weight)
    if len(x):
        # chi^2 need not be known better than to a thousandth
        x = polish(final, x, budget, 1e-3 / final.norm if name == "chi2" and final.norm > 0 else 0.0)
    coefficients, _ = final.solve(x)
    budget.evaluations += 1

    shapes = final.shapes(x)
    lobes = tuple(
        FittedLobe(
            lobe.name,
            {q.name: float(shapes[i, SHAPE + j]) for j, q in enumerate(lobe.parameters)},
            {
                coefficient: dict(zip(samples.channels, coefficients[row].tolist(), strict=True))
                for row, (owner, coefficient) in enumerate(final.coefficients.names)
                if owner == i
            },
        )
        for i, lobe in enumerate(chosen.lobes)
    )
    unknowns = len(x) + coefficients.size
    result = Fit(
        model=chosen.name,
        lobes=lobes,
        channels=samples.channels,
        wavelengths_nm=samples.wavelengths_nm,
        objective=name,
        residuals=metrics(samples, final.values(x, coefficients)),
        degrees_of_freedom=samples.values.size - unknowns,
        evaluations=budget.evaluations,
        cells_used=len(samples.cells),
        cells_left_out=samples.left_out,
        theta_limit_deg=samples.theta_limit_deg,
        provenance=samples.provenance,
        versions=versions(),
    )
    return result.replace(
        albedo=albedo_check(result),
        notes=_notes(result, samples, time.perf_counter() >= budget.deadline),
        seconds=time.perf_counter() - began,
    )


def _notes(result: Fit, samples: Samples, late: bool) -> tuple[str, ...]:
    """What a reader of the numbers should know."""
    notes = []
    if late:
        notes.append("the time limit ended the search; the parameters are the best met until then")
    if not np.any(samples.values > 0):
        notes.append("no value is above 0: all coefficients are 0 and the shape parameters mean nothing")
    elif result.degrees_of_freedom is not None and result.degrees_of_freedom <= 0:
        notes.append("fewer values than parameters: the parameters are one choice of many")
    else:
        for lobe in result.lobes:
            if lobe.parameters and not any(v > 0 for c in lobe.coefficients.values() for v in c.values()):
                notes.append(f"lobe {lobe.name} has coefficient 0: its shape parameters mean nothing")
    return tuple(notes)
