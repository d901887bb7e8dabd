"""Each objective is minimised by its own fit, and finds known parameters."""

from __future__ import annotations

import numpy as np
import pytest

from fitting import fit
from fitting.models import find_model
from fitting.objectives import OBJECTIVES, find_objective
from fitting.problem import Problem

from .exact import MODELS, numbers, samples_of
from .materials import counted, gold, grid, material

pytestmark = pytest.mark.compiled

WITHOUT_ERRORS = [name for name in OBJECTIVES if name != "chi2"]


def test_every_fit_is_the_best_under_its_own_objective() -> None:
    # GGX's tails cannot be Beckmann's: the objectives disagree on what to give up
    table = gold(0.3, "ggx").table(grid(6, 24, 36))
    table = table.replace(std_error=0.01 + 0.1 * table.values)
    found = {name: fit(table, "cook_torrance_beckmann", objective=name) for name in OBJECTIVES}
    for name, own in found.items():
        assert own.objective == name
        for other in found.values():
            assert set(other.residuals) >= set(OBJECTIVES)
            assert own.residuals[name] <= other.residuals[name] * (1 + 1e-6), (name, other.objective)
    assert found["ngan_l2"].lobes != found["low_log"].lobes


@pytest.mark.parametrize("objective", WITHOUT_ERRORS)
@pytest.mark.parametrize("model", ["cook_torrance_ggx", "oren_nayar", "ggx+ggx+lambert"])
def test_noise_free_parameters_come_back(model: str, objective: str) -> None:
    truth = material(model, *MODELS[model])
    found = fit(samples_of(truth, 4000), model, objective=objective)
    # a rounded-off modulus ends where the rest is below its rounding
    assert numbers(found) == pytest.approx(numbers(truth), rel=1e-4 if objective != "nbrdf" else 1e-3)


def test_few_hits_darken_faint_lobes_but_under_quadratic_objectives() -> None:
    # 4 hits a cell and channel, mostly of the facets; the diffuse lobe's albedo is 0.06, 0.05, 0.03
    truth = gold(0.5)
    table = counted(truth.table(grid(10, 36, 60)), 150_000, np.random.default_rng(11))
    for objective in OBJECTIVES:
        found = fit(table, truth.model, objective=objective)
        for channel, true in truth.lobes[1].coefficients["albedo"].items():
            albedo = found.lobes[1].coefficients["albedo"][channel]
            if objective in ("chi2", "ngan_l2"):
                of = [
                    p
                    for p in found.confidence["parameters"]
                    if (p["name"], p["channel"]) == ("albedo", channel)
                ]
                assert abs(albedo - true) < 4.0 * of[0]["std_error"]
            elif channel == "R":
                assert albedo < (0.9 if objective == "low_log" else 0.5) * true


@pytest.mark.parametrize("objective", WITHOUT_ERRORS)
def test_gradient_is_a_difference_of_the_objective(objective: str) -> None:
    model = "eon+ggx"
    lobes = find_model(model).lobes
    truth = material("cook_torrance_beckmann", *MODELS["cook_torrance_beckmann"])
    samples = samples_of(truth, 2000)
    problem = Problem(
        lobes, samples, find_objective(samples, objective), np.zeros(len(samples.cells), np.int8)
    )
    x, c = np.array([0.4, 0.7]), np.full((3, 3), 0.3)
    gradient = -2.0 * problem.equations(problem.evaluate(x, c, solve=False))[1]
    for k in range(problem.size):
        ends = []
        for sign in (1, -1):
            unknowns = np.concatenate([x, c.ravel()])
            unknowns[k] += sign * 1e-5
            ends.append(problem.evaluate(unknowns[:2], unknowns[2:].reshape(3, 3), solve=False).value)
        assert gradient[k] == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-4, abs=1e-9), k


def test_eliminated_coefficients_leave_no_slope() -> None:
    truth = material("cook_torrance_ggx", *MODELS["cook_torrance_ggx"])
    samples = samples_of(truth, 2000)
    problem = Problem(
        find_model("cook_torrance_ggx").lobes,
        samples,
        find_objective(samples, "ngan_l2"),
        np.zeros(len(samples.cells), np.int8),
    )
    point = problem.reduced(np.array([0.4]), None)
    right = problem.equations(point)[1][1:]
    positive = point.coefficients.ravel() > 0
    assert np.abs(right[positive]).max() < 1e-10
    assert right[~positive].max(initial=0.0) < 1e-10
    # Golub and Pereyra: the slope of the reduced objective is that at fixed coefficients
    ends = [problem.reduced(np.array([0.4 + s]), None).value for s in (1e-6, -1e-6)]
    assert -2.0 * problem.equations(point)[1][0] == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-4)
