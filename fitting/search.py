"""The search over shape parameters: the objective with coefficients eliminated, and nlopt's two stages."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import nlopt
import numpy as np
from numpy.typing import NDArray

from fitting.kernels import normal_equations
from fitting.linear import Coefficients
from fitting.models import Lobe
from fitting.samples import Samples

Array = NDArray[np.float64]

COARSE_CELLS = 6000
_GLOBAL_EVALUATIONS = 120  # per shape parameter
_LOCAL_EVALUATIONS = 20  # points with their gradient, per shape parameter
_NEGLIGIBLE = 1e-13  # gain of the objective, relative to the sum of squared values
_NEWTON_STEPS = 3
_TRUST = 0.05  # longest of them
_STEP = 2e-4  # of central differences, in the search's variables
_POINTS = 2_500_000  # most quadrature points of the final stage


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
        self.parameters = [(i, q) for i, lobe in enumerate(lobes) for q in lobe.parameters]
        self.squares = np.einsum("nc,nc,nc->c", weights, samples.values, samples.values)
        self.norm = float(self.squares.sum()) or 1.0

    def shapes(self, x: Array) -> Array:
        """Packed lobes, shape (L, SIZE), for the search's variables."""
        values: list[dict[str, float]] = [{} for _ in self.lobes]
        for u, (i, parameter) in zip(x, self.parameters, strict=True):
            values[i][parameter.name] = parameter.from_unit(float(u))
        return np.stack([lobe.pack(v) for lobe, v in zip(self.lobes, values, strict=True)])

    def solve(self, x: Array) -> tuple[Array, float]:
        """Best coefficients, shape (J, C), and the sum of squares at `x`."""
        grid = self.samples.grid
        shapes = self.shapes(x)
        parts = normal_equations(
            self.kinds,
            shapes,
            (grid.rows, grid.rings, grid.sectors),
            self.samples.cells,
            self.levels,
            grid.exact_rows,
            self.samples.values,
            self.weights,
        )
        return self.coefficients.solve(parts.sum(axis=0), self.squares, shapes)

    def values(self, x: Array, coefficients: Array, levels: int | NDArray[np.int8] | None = None) -> Array:
        """The model's cell averages, shape (N, C)."""
        used = self.levels if levels is None else levels
        shapes = self.shapes(x)
        terms = self.samples.terms(self.kinds, shapes, used)
        return terms @ self.coefficients.factors(coefficients, shapes)


def coarse(lobes: Sequence[Lobe], samples: Samples, weights: Array) -> Objective:
    """The objective on a few thousand cells, drawn by their share of it and weighted back.

    Systematic sampling, half by share and half evenly; deterministic.
    """
    n = len(samples.cells)
    if n > COARSE_CELLS:
        share = np.einsum("nc,nc,nc->n", weights, samples.values, samples.values)
        total = share.sum()
        probability = np.full(n, 0.5 / n) + (0.5 * share / total if total > 0 else 0.5 / n)
        probability = np.minimum(1.0, COARSE_CELLS * probability)
        picks = np.flatnonzero(np.diff(np.floor(np.concatenate([[0.5], 0.5 + np.cumsum(probability)]))))
        weights = weights[picks] / probability[picks, None]
        samples = _take(samples, picks)
    levels = np.zeros(len(samples.cells), np.int8)
    if samples.grid.rows.shape[0] > 1:
        levels[:] = np.where(samples.grid.near_mirror(samples.cells), 2, 1)
    return Objective(lobes, samples, weights, levels)


def refined(rough: Objective, x: Array, samples: Samples, weights: Array) -> Objective:
    """The objective on all cells, with as many quadrature nodes in each as the shape at `x` asks for.

    A cell goes to the next level where the two differ; the largest weighted differences come first, until
    what is left is negligible or half of the points still to be had are used.
    """
    objective = Objective(rough.lobes, samples, weights, np.zeros(len(samples.cells), np.int8))
    if samples.grid.rows.shape[0] == 1:
        return objective
    coefficients, _ = rough.solve(x)
    shapes = objective.shapes(x)
    factors = rough.coefficients.factors(coefficients, shapes)
    dimensions = 2 if samples.grid.exact_rows else 3
    tolerance = 1e-10 * objective.norm
    chosen = np.arange(len(samples.cells))
    before = samples.terms(objective.kinds, shapes, 0) @ factors
    points = len(chosen)
    for level in (1, 2, 3):
        each = 2 ** (dimensions * level)
        affordable = (_POINTS - points) // (2 * each)
        if level > 1:  # sorted: the rest could not be afforded
            chosen, before = chosen[:affordable], before[:affordable]
        if affordable <= 0:
            break
        after = samples.grid.terms(objective.kinds, shapes, samples.cells[chosen], level) @ factors
        error = np.einsum("nc,nc->n", weights[chosen], (after - before) ** 2)
        order = np.argsort(error)[::-1]
        needed = int(np.count_nonzero(np.cumsum(error[order][::-1])[::-1] > tolerance))
        take = order[: min(needed, affordable)]
        if len(take) == 0:
            break
        chosen, before = chosen[take], after[take]
        objective.levels[chosen] = level
        points += each * len(take)
    return objective


def search(objective: Objective, start: Array, budget: Budget, seed: int) -> Array:
    """Minimise over the whole range [0, 1]^D: nlopt's multi-level single linkage, Subplex in each start.

    Returns
    -------
    ndarray, shape (D,)
        The best point met, also where time ran out.
    """
    watched = _Watched(objective, budget, _GLOBAL_EVALUATIONS, (0.0, 0.5))
    dimensions = len(start)
    local = nlopt.opt(nlopt.LN_SBPLX, dimensions)
    local.set_xtol_abs(1e-5)
    local.set_maxeval(60 * dimensions)
    optimizer = nlopt.opt(nlopt.G_MLSL_LDS, dimensions)
    optimizer.set_local_optimizer(local)
    optimizer.set_population(6)
    nlopt.srand(seed + 1)
    return watched.minimise(optimizer, start, lambda x, _gradient: watched(x))


def polish(objective: Objective, start: Array, budget: Budget, negligible: float = 0.0) -> Array:
    """Minimise from a point close to the minimum: Newton's steps, then sequential quadratic programming.

    Both on central differences. The variables are scaled to unit curvature first, which spares the
    library's method its own search for a scale.

    Parameters
    ----------
    objective : Objective
    start : ndarray, shape (D,)
    budget : Budget
    negligible : float
        Stop when less than this, relative to the sum of squared values, may still be gained; 1e-13 at least.

    Returns
    -------
    ndarray, shape (D,)
        The best point met, also where time ran out.
    """
    watched = _Watched(objective, budget, _LOCAL_EVALUATIONS, (0.5, 1.0))
    negligible = max(negligible, _NEGLIGIBLE)
    dimensions = len(start)
    centre = np.clip(start, _STEP, 1.0 - _STEP)

    def differences(x: Array) -> tuple[float, Array, Array]:
        """Value, gradient and diagonal of the Hessian; x is at least a step inside."""
        middle = watched(x)
        gradient, curvature = np.zeros(dimensions), np.zeros(dimensions)
        for d in range(dimensions):
            up, down = watched(x + _STEP * np.eye(dimensions)[d]), watched(x - _STEP * np.eye(dimensions)[d])
            gradient[d] = (up - down) / (2.0 * _STEP)
            curvature[d] = (up - 2.0 * middle + down) / _STEP**2
        return middle, gradient, curvature

    def gain(point: tuple[float, Array, Array], x: Array) -> float:
        """What there may still be to gain, if curvature is diagonal: g^2 / 2h, off the bounds."""
        inside = (x > 2.0 * _STEP) & (x < 1.0 - 2.0 * _STEP) & (point[2] > 0)
        return 0.5 * float(np.sum(point[1][inside] ** 2 / point[2][inside]))

    first = differences(centre)
    # Newton's steps need three values for each parameter; a search by the library needs them several times
    for _ in range(_NEWTON_STEPS):
        convex = first[2] > 0
        step = np.where(convex, -first[1] / np.where(convex, first[2], 1.0), 0.0)
        moved = np.clip(centre + np.clip(step, -_TRUST, _TRUST), _STEP, 1.0 - _STEP)
        there = differences(moved)
        if gain(there, moved) < negligible:
            return watched.best[1]
        if not there[0] <= first[0]:
            break
        centre, first = moved, there
    steepest = first[2].max()
    if not (np.isfinite(steepest) and steepest > 0.0):
        return watched.best[1]  # flat: nothing to gain
    scale = 1.0 / np.sqrt(np.maximum(first[2], 1e-6 * steepest))

    def value(z: Array, gradient: Array) -> float:
        x = centre + scale * z
        middle, slope, _ = first if not z.any() else differences(x)
        if gradient.size:
            gradient[:] = slope * scale
        if gain((middle, slope, 1.0 / scale**2), x) < negligible:
            optimizer.force_stop()
        return middle

    optimizer = nlopt.opt(nlopt.LD_SLSQP, dimensions)
    optimizer.set_lower_bounds((_STEP - centre) / scale)
    optimizer.set_upper_bounds((1.0 - _STEP - centre) / scale)
    optimizer.set_xtol_abs(1e-7 / scale)
    return watched.minimise(optimizer, np.zeros(dimensions), value, bounded=True)


class _Watched:
    """An objective, relative to the sum of squared values, that remembers the best and reports progress."""

    def __init__(
        self, objective: Objective, budget: Budget, evaluations: int, span: tuple[float, float]
    ) -> None:
        self.objective, self.budget, self.span = objective, budget, span
        self.most = evaluations * max(1, len(objective.parameters))
        self.count = 0
        self.best = (np.inf, np.zeros(len(objective.parameters)))

    def __call__(self, x: Array) -> float:
        self.count += 1
        self.budget.evaluations += 1
        residual = self.objective.solve(x)[1] / self.objective.norm
        if not np.isfinite(residual):
            residual = 1e30
        if residual < self.best[0] or self.count == 1:
            self.best = (residual, np.array(x))
        if self.budget.progress is not None:
            share = min(1.0, self.count / self.most)
            done = self.span[0] + share * (self.span[1] - self.span[0])
            self.budget.progress(done, f"residual {self.best[0]:.3g}")
        return residual

    def minimise(
        self,
        optimizer: nlopt.opt,
        start: Array,
        value: Callable[[Array, Array], float],
        bounded: bool = False,
    ) -> Array:
        if not bounded:
            optimizer.set_lower_bounds(np.zeros(len(start)))
            optimizer.set_upper_bounds(np.ones(len(start)))
        optimizer.set_min_objective(value)
        optimizer.set_maxeval(self.most)
        optimizer.set_maxtime(self.budget.seconds())
        # nlopt reports an end at rounding errors as an exception; the best point met stands
        with suppress(nlopt.RoundoffLimited, nlopt.ForcedStop, RuntimeError):
            optimizer.optimize(start)
        return self.best[1]


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
