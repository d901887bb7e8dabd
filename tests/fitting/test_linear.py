from __future__ import annotations

import numpy as np
import pytest

from fitting.linear import Coefficients
from fitting.models import MODELS, SHAPE, SIZE
from fitting.models.eon import missing


def best(solver: Coefficients, terms: np.ndarray, y: np.ndarray, shapes: np.ndarray, start=None):
    """Coefficients of one channel, from those at `start`, and the sum of squares."""
    back = solver.feedback(shapes)
    start = np.zeros(len(solver.names)) if start is None else np.array(start)
    left = y - terms @ solver.factors(start, back)
    c = solver.solve(terms.T @ terms, terms.T @ left, start, back)
    return c, float(np.sum((y - terms @ solver.factors(c, back)) ** 2))


ANY = np.zeros((2, SIZE))  # shapes, which the coefficients below do not ask for


def test_linear_coefficients_are_the_non_negative_least_squares() -> None:
    rng = np.random.default_rng(0)
    terms = rng.random((50, 3))
    solver = Coefficients(MODELS["cook_torrance_ggx"].lobes)
    for start in (None, [0.3, 0.7, 0.1]):
        c, residual = best(solver, terms, terms @ [0.5, 0.0, 0.2], ANY, start)
        assert c == pytest.approx([0.5, 0.0, 0.2], abs=1e-9)
        assert residual == pytest.approx(0.0, abs=1e-12)
        # the free optimum would be negative in the second: then the others alone
        c, _ = best(solver, terms, terms @ [0.5, -0.3, 0.2], ANY, start)
        alone = np.linalg.lstsq(terms[:, [0, 2]], terms @ [0.5, -0.3, 0.2], rcond=None)[0]
        assert c == pytest.approx([alone[0], 0.0, alone[1]], abs=1e-9)


def test_a_good_start_keeps_digits_that_normal_equations_lose() -> None:
    # two nearly equal columns: the condition number of the normal equations is 1e12
    rng = np.random.default_rng(0)
    terms = rng.random((50, 3))
    terms[:, 1] = terms[:, 0] + 1e-6 * terms[:, 1]
    truth = np.array([0.5, 0.25, 0.2])
    c, _ = best(Coefficients(MODELS["cook_torrance_ggx"].lobes), terms, terms @ truth, ANY, truth + 1e-4)
    c, _ = best(Coefficients(MODELS["cook_torrance_ggx"].lobes), terms, terms @ truth, ANY, c)
    assert c == pytest.approx(truth, abs=1e-8)


def test_identical_terms_do_not_blow_up() -> None:
    terms = np.random.default_rng(0).random((50, 3))
    terms[:, 1] = terms[:, 0]
    c, residual = best(Coefficients(MODELS["cook_torrance_ggx"].lobes), terms, terms[:, 0], ANY)
    assert c[0] + c[1] == pytest.approx(1.0, abs=1e-6)
    assert residual == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("rho", [0.0, 0.3, 1.0])
def test_a_squared_coefficient(rho: float) -> None:
    terms = np.random.default_rng(1).random((50, 2))
    solver = Coefficients(MODELS["oren_nayar"].lobes)
    c, residual = best(solver, terms, rho * terms[:, 0] + rho**2 * terms[:, 1], ANY[:1])
    assert c[0] == pytest.approx(rho, abs=1e-9)
    assert residual == pytest.approx(0.0, abs=1e-10)
    assert solver.factors(np.array([0.5]), np.zeros(2)) == pytest.approx([0.5, 0.25])


@pytest.mark.parametrize("rho", [0.0, 0.3, 1.0])
def test_a_coefficient_with_feedback(rho: float) -> None:
    terms = np.random.default_rng(1).random((50, 2))
    shape = np.zeros((1, SIZE))
    shape[0, SHAPE] = 0.8
    solver = Coefficients(MODELS["eon"].lobes)
    bounces = rho**2 / (1 - missing(0.8) * rho)
    truth = rho * terms[:, 0] + bounces * terms[:, 1]
    c, residual = best(solver, terms, truth, shape)
    assert c[0] == pytest.approx(rho, abs=1e-9)
    assert residual == pytest.approx(0.0, abs=1e-10)
    assert solver.factors(np.array([rho]), solver.feedback(shape)) == pytest.approx([rho, bounces])
    # away from the truth: no other coefficient comes closer
    noisy = truth + np.random.default_rng(2).normal(0.0, 0.3, 50)
    c, residual = best(solver, terms, noisy, shape)
    tries = np.linspace(0.0, 1.5, 1501)
    f = np.stack([tries, tries**2 / (1 - missing(0.8) * tries)])
    assert residual <= np.sum((terms @ f - noisy[:, None]) ** 2, axis=0).min() + 1e-9


@pytest.mark.parametrize("start", [None, [1e6, 0.1, 0.1]])
def test_a_lobe_that_no_sample_sees_has_no_coefficient(start: list[float] | None) -> None:
    terms = np.random.default_rng(0).random((50, 3))
    terms[:, 0] *= 1e-30
    solver = Coefficients(MODELS["cook_torrance_ggx"].lobes)
    c, residual = best(solver, terms, terms @ [1.0, 0.5, 0.2], ANY, start)
    assert c == pytest.approx([0.0, 0.5, 0.2])
    assert residual == pytest.approx(0.0, abs=1e-12)
