"""The steps of the search: how many they are, that they end at the bounds, and what the coarse cells stand for."""

from __future__ import annotations

import time

import numpy as np
import pytest

from fitting.levels import refine
from fitting.models import find_model
from fitting.objectives import find_objective
from fitting.problem import Problem
from fitting.samples import Samples
from fitting.search import Budget, bounded_step, coarse, descend, explore

from .exact import MODELS, samples_of
from .materials import gold, grid, material

pytestmark = pytest.mark.compiled


def problem_of(samples: Samples, model: str) -> Problem:
    levels = np.zeros(len(samples.cells), np.int8)
    return Problem(find_model(model).lobes, samples, find_objective(samples, "ngan_l2"), levels)


def test_what_a_model_cannot_describe_ends_after_few_looks() -> None:
    # two lobes are not one: plain steps of Gauss and Newton go too far, each by the same share, and take 9 looks
    samples = samples_of(material("ggx+ggx+lambert", *MODELS["ggx+ggx+lambert"]), 4000)
    problem = problem_of(samples, "cook_torrance_1982")
    start = problem.reduced(np.array([0.6]), None)
    point = descend(problem, start, Budget(time.perf_counter() + 60.0), (0.0, 1.0))
    assert point.value > 1e-3
    assert problem.evaluations < 8
    assert abs(problem.equations(point)[1][0]) < 1e-6


@pytest.mark.parametrize("model", ["cook_torrance_ggx", "hanrahan_krueger"])
def test_coefficients_that_leave_no_digits_are_forgotten(model: str) -> None:
    problem = problem_of(samples_of(material(model, *MODELS[model]), 2000), model)
    x = np.full(len(problem.parameters), 0.6)
    fresh = problem.evaluate(x, None)
    found = problem.evaluate(x, np.full(fresh.coefficients.shape, 1e60))
    assert found.value == fresh.value
    assert np.array_equal(found.coefficients, fresh.coefficients)


def misled(monkeypatch: pytest.MonkeyPatch, place: dict[int, list[float]]) -> None:
    """Let the global search end where it is told to, by the number of shape parameters."""
    monkeypatch.setattr(
        "fitting.search.search", lambda problem, x, *rest: [problem.reduced(np.array(place[len(x)]), None)]
    )


def test_more_lobes_begin_from_what_fewer_found(monkeypatch: pytest.MonkeyPatch) -> None:
    truth = "beckmann+beckmann+beckmann+lambert"
    samples = samples_of(material(truth, *MODELS[truth]), 4000)
    # three lobes all at the end of the range, where they are the same and no step leads out
    misled(monkeypatch, {1: [0.6], 2: [0.5, 0.8], 3: [0.0, 0.0, 0.0]})
    problem = problem_of(samples, truth)
    point = explore(problem.lobes, samples, problem.objective, Budget(time.perf_counter() + 60.0), 0)
    assert point.value < 1e-3


def test_optical_constants_begin_in_several_places(monkeypatch: pytest.MonkeyPatch) -> None:
    samples = samples_of(material("ggx_conductor", *MODELS["ggx_conductor"]), 4000)
    # the roughness is right; of a metal like glass rough steps lead to k = 0, where the objective is 3.1e-4
    misled(monkeypatch, {3: [0.7, 1.0, 0.0]})
    problem = problem_of(samples, "ggx_conductor")
    point = explore(problem.lobes, samples, problem.objective, Budget(time.perf_counter() + 60.0), 0)
    assert point.value < 1.5e-4


def test_a_step_stops_at_the_bounds_and_the_rest_makes_up_for_it() -> None:
    samples = samples_of(gold(0.3), 500)
    problem = problem_of(samples, "lambert")
    point = problem.evaluate(np.zeros(0), np.array([[0.5, 0.5, 0.5]]), solve=False)
    # minimum of s M s - 2 s r over s >= -1/2: free it were (-1, 0, 0); at s_0 = -1/2 the others solve
    # [[2, 0], [0, 1]] s = (-1, 0) - (1, 0)(-1/2) = (-1/2, 0)
    matrix = np.array([[1.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 1.0]])
    step = bounded_step(problem, point, matrix, np.array([-1.0, -1.0, 0.0]), 0.0)
    assert step == pytest.approx([-0.5, -0.25, 0.0])


def test_coarse_cells_stand_for_all() -> None:
    samples = samples_of(gold(0.3), 20_000)
    whole = problem_of(samples, "cook_torrance_beckmann")
    x, c = np.array([0.7]), np.full((3, 3), 0.2)
    all_of = whole.evaluate(x, c, solve=False).value * whole.norm
    ratios = []
    for seed in range(16):  # which are drawn depends on their order
        mixed = samples.take(np.random.default_rng(seed).permutation(len(samples.cells)))
        few = coarse(whole.lobes, mixed, find_objective(mixed, "ngan_l2"), 2000)
        assert len(few.samples.cells) <= 2000
        ratios.append(few.evaluate(x, c, solve=False).value * few.norm / all_of)
    error = np.std(ratios, ddof=1) / 4.0
    assert error < 0.05
    assert abs(np.mean(ratios) - 1.0) < 5.0 * error


@pytest.mark.parametrize("many", [100_000, 10], ids=["all cells", "one in a block"])
def test_cells_get_the_nodes_they_need(many: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fitting.levels._MANY", many)
    # a lobe of 3 degrees in cells of 5: its averages from the nodes chosen, against 16 x 16 nodes everywhere
    truth = gold(0.05)
    samples = Samples.of_table(truth.table(grid(0, 18, 36, theta_i_deg=[10.0, 40.0, 65.0])))
    problem = problem_of(samples, truth.model)
    x = np.array([q.to_unit(0.05) for _, q in problem.parameters])
    coefficients = np.array([[0.9, 0.7, 0.3], [1.0, 1.0, 1.0], [0.06, 0.05, 0.03]])
    plain = problem.evaluate(x, coefficients, solve=False).value
    refine(problem, x, coefficients)
    refined = problem.evaluate(x, coefficients, solve=False).value
    # blocks are as wide as this lobe: one cell of each tells less, but where to look first
    assert refined < (1e-6 if many > 10 else 1e-2) * plain
    levels = problem.cells.levels
    assert levels.max() > 2
    # and only those
    assert np.count_nonzero(levels) < 0.5 * len(levels)
