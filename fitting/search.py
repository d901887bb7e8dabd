"""The search over shape parameters: the objective with coefficients eliminated, and nlopt's two stages."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import nlopt
import numpy as np
from numpy.typing import NDArray

from fitting.kernels import normal_equations
from fitting.linear import Coefficients
from fitting.models import SHAPE, SIZE, Lobe
from fitting.samples import Samples

Array = NDArray[np.float64]

COARSE_CELLS = 6000
_GLOBAL_EVALUATIONS = 120  # per shape parameter
_LOCAL_EVALUATIONS = 80  # per shape parameter
_POINTS = 3_000_000  # most quadrature points of the final stage


@dataclass(eq=False)
class Budget:
    """Evaluations and seconds left, and what is told about them."""

    deadline: float
    evaluations: int = 0
    progress: Callable[[float, str], None] | None = None

    def seconds(self) -> float:
        """Seconds left, at least a little: nlopt takes 0 for no limit."""
        return max(1e-3, self.deadline - time.perf_counter())


class Objective:
    """Weighted sum of squares as a function of the shape parameters on [0, 1], coefficients eliminated."""

    def __init__(
        self, lobes: Sequence[Lobe], samples: Samples, weights: Array, levels: NDArray[np.int8]
    ) -> None:
        self.lobes = tuple(lobes)
        self.samples, self.weights, self.levels = samples, weights, levels
        self.coefficients = Coefficients(lobes)
        self.kinds = np.array([lobe.kind for lobe in lobes], np.int64)
        self.parameters = [(i, j, q) for i, lobe in enumerate(lobes) for j, q in enumerate(lobe.parameters)]
        self.squares = np.einsum("nc,nc,nc->c", weights, samples.values, samples.values)
        self.norm = float(self.squares.sum()) or 1.0

    def shapes(self, x: Array) -> Array:
        """Packed lobes, shape (L, SIZE), for the search's variables."""
        out = np.zeros((len(self.lobes), SIZE))
        out[:, :SHAPE] = 1.0
        for u, (i, j, parameter) in zip(x, self.parameters, strict=True):
            out[i, SHAPE + j] = parameter.from_unit(float(u))
        return out

    def solve(self, x: Array) -> tuple[Array, float]:
        """Best coefficients, shape (J, C), and the sum of squares at `x`."""
        grid = self.samples.grid
        equations = normal_equations(
            self.kinds,
            self.shapes(x),
            grid.rows,
            grid.rings,
            grid.sectors,
            self.samples.cells,
            self.levels,
            grid.exact_rows,
            self.samples.values,
            self.weights,
        )
        return self.coefficients.solve(equations, self.squares)

    def values(self, x: Array, coefficients: Array, levels: int | NDArray[np.int8] | None = None) -> Array:
        """The model's cell averages, shape (N, C)."""
        used = self.levels if levels is None else levels
        terms = self.samples.terms(self.kinds, self.shapes(x), used)
        return terms @ self.coefficients.factors(coefficients)


def coarse(lobes: Sequence[Lobe], samples: Samples, weights: Array) -> Objective:
    """The objective on a few thousand cells, drawn by their share of it and weighted back.

    Systematic sampling, half by share and half evenly; deterministic.
    """
    n = len(samples.cells)
    level = 0 if samples.grid.rows.shape[0] == 1 else 2
    if n > COARSE_CELLS:
        share = np.einsum("nc,nc,nc->n", weights, samples.values, samples.values)
        total = share.sum()
        probability = np.full(n, 0.5 / n) + (0.5 * share / total if total > 0 else 0.5 / n)
        probability = np.minimum(1.0, COARSE_CELLS * probability)
        picks = np.flatnonzero(np.diff(np.floor(np.concatenate([[0.5], 0.5 + np.cumsum(probability)]))))
        weights = weights[picks] / probability[picks, None]
        samples = _take(samples, picks)
    return Objective(lobes, samples, weights, np.full(len(samples.cells), level, np.int8))


def refined(rough: Objective, x: Array, samples: Samples, weights: Array) -> Objective:
    """The objective on all cells, with as many quadrature nodes in each as the shape at `x` asks for.

    A cell goes to the next level where the two differ; the largest weighted differences come first, until
    what is left is negligible or the points are used up.
    """
    objective = Objective(rough.lobes, samples, weights, np.zeros(len(samples.cells), np.int8))
    if samples.grid.rows.shape[0] == 1:
        return objective
    coefficients, _ = rough.solve(x)
    factors = rough.coefficients.factors(coefficients)
    shapes = objective.shapes(x)
    dimensions = 2 if samples.grid.exact_rows else 3
    tolerance = 1e-11 * objective.norm
    chosen = np.arange(len(samples.cells))
    before = samples.terms(objective.kinds, shapes, 0) @ factors
    points = len(chosen)
    for level in (1, 2, 3):
        after = samples.grid.terms(objective.kinds, shapes, samples.cells[chosen], level) @ factors
        error = np.einsum("nc,nc->n", weights[chosen], (after - before) ** 2)
        order = np.argsort(error)[::-1]
        needed = int(np.count_nonzero(np.cumsum(error[order][::-1])[::-1] > tolerance))
        each = 2 ** (dimensions * level)
        affordable = max(0, (_POINTS - points) // each)
        take = order[: min(needed, affordable)]
        if len(take) == 0:
            break
        chosen, before = chosen[take], after[take]
        objective.levels[chosen] = level
        points += each * len(take)
    return objective


def search(objective: Objective, start: Array, budget: Budget, everywhere: bool, seed: int) -> Array:
    """Minimise over [0, 1]^D: multi-start (MLSL) over the whole range, or a local simplex about `start`.

    Returns
    -------
    ndarray, shape (D,)
        The best point met, also where time ran out.
    """
    dimensions = len(objective.parameters)
    best = (np.inf, np.array(start, float))
    most = (_GLOBAL_EVALUATIONS if everywhere else _LOCAL_EVALUATIONS) * dimensions
    count = 0

    def value(x: Array, _gradient: Array) -> float:
        nonlocal best, count
        count += 1
        budget.evaluations += 1
        _, residual = objective.solve(x)
        residual /= objective.norm
        if not np.isfinite(residual):
            residual = 1e30
        if residual < best[0]:
            best = (residual, x.copy())
        if budget.progress is not None:
            done = 0.5 * min(1.0, count / most) + (0.0 if everywhere else 0.5)
            budget.progress(done, f"residual {best[0]:.3g}")
        return residual

    local = nlopt.opt(nlopt.LN_SBPLX, dimensions)
    if everywhere:
        optimizer = nlopt.opt(nlopt.G_MLSL_LDS, dimensions)
        local.set_xtol_abs(1e-4)
        local.set_maxeval(40 * dimensions)
        optimizer.set_local_optimizer(local)
        optimizer.set_population(6)
        nlopt.srand(seed + 1)
    else:
        optimizer = local
        optimizer.set_xtol_abs(1e-8)
        optimizer.set_initial_step(0.005)
    optimizer.set_lower_bounds(np.zeros(dimensions))
    optimizer.set_upper_bounds(np.ones(dimensions))
    optimizer.set_min_objective(value)
    optimizer.set_maxeval(most)
    optimizer.set_maxtime(budget.seconds())
    try:
        optimizer.optimize(np.clip(start, 0.0, 1.0))
    except (nlopt.RoundoffLimited, RuntimeError):
        if not np.isfinite(best[0]):
            raise
    return best[1]


def _take(samples: Samples, picks: NDArray[np.intp]) -> Samples:
    return replace(
        samples,
        cells=samples.cells[picks],
        values=samples.values[picks],
        variance=None if samples.variance is None else samples.variance[picks],
        cos_i=samples.cos_i[picks],
        sin_i=samples.sin_i[picks],
        sin_o=samples.sin_o[picks],
    )
