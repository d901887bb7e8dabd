"""The search over parameters: nlopt over the whole range on a few cells, then steps on all of them."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import nlopt
import numpy as np
from numpy.typing import NDArray

from fitting.models import Lobe
from fitting.objectives import Objective
from fitting.problem import Point, Problem, solve_scaled
from fitting.samples import Samples

Array = NDArray[np.float64]

COARSE_CELLS = 4000
_FINE = 32  # times rarer must cells about the mirror direction be, to have 4 x 4 x 4 nodes in this stage
_GLOBAL_EVALUATIONS = 30  # and as many again per shape parameter
_LOCAL_EVALUATIONS = 25
_PERFECT = 1e-20  # of the objective of a model that is 0: nothing left to find elsewhere
_STEPS = 60
_APART = 0.1  # in a shape parameter: not in one valley, it may be
_PLACES = (0.25, 0.5, 0.75)  # of a new lobe's parameters in their range
_OPTICS = 10  # other starts
_MOVED = 1e-7  # of the range of a shape parameter: close enough
_GAIN = 1e-3  # of a degree of freedom's share of the objective: a thirtieth of a standard error
_NO_GAIN = 1e-6  # of it: a thousandth of a standard error, however far the parameters still go
_ROUGH_GAIN = 1e-4  # of the objective, where a minimum is only compared with others
_DAMPING = 1e-3  # when a step has failed first
_MOST_DAMPING = 1e8


@dataclass(eq=False)
class Budget:
    """Seconds left, looks at the cells so far, and what is told about them."""

    deadline: float
    evaluations: int = 0
    progress: Callable[[float, str], None] | None = None

    def seconds(self) -> float:
        """Seconds left, at least a little: nlopt takes 0 for no limit."""
        return max(1e-3, self.deadline - time.perf_counter())

    @property
    def late(self) -> bool:
        """Whether the time is over."""
        return time.perf_counter() >= self.deadline

    def tell(self, done: float, point: Point) -> None:
        """Report progress."""
        if self.progress is not None:
            self.progress(min(1.0, done), f"residual {point.value:.3g}")


def coarse(
    lobes: tuple[Lobe, ...], samples: Samples, objective: Objective, cells: int = COARSE_CELLS
) -> Problem:
    """The problem on a few thousand cells, drawn by their share of the objective and weighted back.

    Systematic sampling, half by share and half evenly; deterministic.
    """
    n = len(samples.cells)
    if n > cells:
        share = objective.shares(samples)
        total = share.sum()
        probability = np.full(n, 0.5 / n) + (0.5 * share / total if total > 0 else 0.5 / n)
        probability = np.minimum(1.0, cells * probability)
        picks = np.flatnonzero(np.diff(np.floor(np.concatenate([[0.5], 0.5 + np.cumsum(probability)]))))
        objective = replace(objective, weights=objective.weights[picks] / probability[picks, None])
        samples = samples.take(picks)
    mirror = samples.grid.near_mirror(samples.cells)
    fine = 2 if np.count_nonzero(mirror) * _FINE < len(mirror) else 1
    levels = np.where(mirror, fine, 0).astype(np.int8)
    return Problem(lobes, samples, objective, levels)


def explore(
    lobes: tuple[Lobe, ...], samples: Samples, objective: Objective, budget: Budget, seed: int
) -> Point:
    """Find where the minimum is, on a few thousand cells.

    Where a lobe stands several times, its copies are added one at a time, and the search with one more also
    starts from what was found without it: more lobes never fit worse.
    """
    copies = max((lobes.count(lobe) for lobe in lobes if lobe.parameters), default=1)
    point: Point | None = None
    chosen: list[int] = []
    for count in range(1, copies + 1):
        before = chosen
        chosen = [n for n, lobe in enumerate(lobes) if lobes[:n].count(lobe) < count]
        problem = coarse(tuple(lobes[n] for n in chosen), samples, objective)
        start = np.random.default_rng(seed).random(len(problem.parameters))
        span = (0.5 * (count - 1) / copies, 0.5 * count / copies)
        starts = search(problem, start, budget, seed, span)
        if point is not None:
            starts += _extended(problem, chosen, before, point)
        if any(q.optical for n in chosen if n not in before for q in lobes[n].parameters):
            starts += _other_optics(problem, starts[0])
        found: list[Point] = []
        for begin in starts:
            found.append(descend(problem, begin, budget, (span[1], span[1]), _ROUGH_GAIN))
            if found[-1].value < _PERFECT:
                break
        point = min(found, key=lambda p: p.value)
        budget.evaluations += problem.evaluations
    assert point is not None
    return point


def _extended(problem: Problem, chosen: list[int], before: list[int], point: Point) -> list[Point]:
    """A point of fewer lobes with new ones beside them, wide, medium and narrow."""
    out = []
    for place in _PLACES:
        known = iter(point.x)
        x = [
            next(known) if chosen[lobe] in before else place
            for lobe, _ in problem.parameters
        ]  # fmt: skip
        rows = iter(point.coefficients)
        coefficients = [
            next(rows) if chosen[lobe] in before else np.zeros(problem.channels)
            for lobe, _ in problem.coefficients.names
        ]
        out.append(problem.evaluate(np.array(x), np.stack(coefficients)))
    return out


def _other_optics(problem: Problem, point: Point) -> list[Point]:
    """A point with its optical parameters elsewhere, if there are several, by a low-discrepancy sequence."""
    optical = [n for n, (_, q) in enumerate(problem.parameters) if q.optical]
    if len(optical) < 2:
        return []
    # Kronecker's sequence of the square roots of primes
    ratios = np.sqrt(np.array([2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0, 23.0, 29.0]))
    out = []
    for n in range(1, _OPTICS + 1):
        x = point.x.copy()
        x[optical] = n * np.resize(ratios, len(optical)) % 1.0
        out.append(problem.reduced(x, None))
    return out


def search(
    problem: Problem, start: Array, budget: Budget, seed: int, span: tuple[float, float]
) -> list[Point]:
    """Minimise over the whole range of the shape parameters, the coefficients being the best for each.

    nlopt's multi-level single linkage: local searches, sequential quadratic programming with the gradient,
    from a low-discrepancy sequence of starts and from `start`.

    Returns
    -------
    list of Point
        The best met, and the best of those that lie apart from it and from each other; also where time ran out.
    """
    dimensions = len(start)
    if dimensions == 0:
        return [problem.reduced(start, None)]
    most = _GLOBAL_EVALUATIONS * (1 + dimensions)
    found: list[Point] = []
    count = 0

    def value(x: Array, gradient: Array) -> float:
        nonlocal count
        count += 1
        point = problem.reduced(np.array(x), None)
        if gradient.size:
            gradient[:] = -2.0 * problem.equations(point)[1][:dimensions]
        if np.isfinite(point.value):
            found.append(point)
            budget.tell(span[0] + (span[1] - span[0]) * count / most, point)
        if point.value < _PERFECT or budget.late:
            optimizer.force_stop()
        return point.value if np.isfinite(point.value) else 1e30

    local = nlopt.opt(nlopt.LD_SLSQP, dimensions)
    local.set_xtol_abs(1e-3)  # `descend` does the rest
    local.set_ftol_rel(1e-3)
    local.set_maxeval(_LOCAL_EVALUATIONS)
    optimizer = nlopt.opt(nlopt.G_MLSL_LDS, dimensions)
    optimizer.set_local_optimizer(local)
    optimizer.set_population(4 + 2 * dimensions)
    optimizer.set_lower_bounds(np.zeros(dimensions))
    optimizer.set_upper_bounds(np.ones(dimensions))
    optimizer.set_min_objective(value)
    optimizer.set_maxeval(most)
    optimizer.set_maxtime(budget.seconds())
    nlopt.srand(seed + 1)
    # nlopt reports an end at rounding errors as an exception; the best point met stands
    with suppress(nlopt.RoundoffLimited, nlopt.ForcedStop, RuntimeError):
        optimizer.optimize(start)
    apart: list[Point] = []
    for point in sorted(found, key=lambda p: p.value):
        if all(np.abs(point.x - other.x).max() > _APART for other in apart):
            apart.append(point)
        if len(apart) == dimensions:
            break
    return apart or [problem.reduced(start, None)]


def descend(
    problem: Problem, start: Point, budget: Budget, span: tuple[float, float], rough: float = 0.0
) -> Point:
    """Minimise from a point near the minimum: Levenberg and Marquardt's steps of all unknowns within bounds.

    The matrix of a step is that of Golub and Pereyra's in Kaufman's form if the coefficients are at their
    best, as they are after every look at a quadratic objective. A step costs one look at the cells. Where much
    is left over the matrix is not that of the second derivatives, and its steps go too far or not far enough,
    one like the other: two of the same damping are mixed (Anderson 1965).

    Parameters
    ----------
    problem : Problem
    start : Point
        Of this problem.
    budget : Budget
    span : tuple of 2 float
        Progress before and after.
    rough : float
        Stop where a step promises less than this share of the objective.

    Returns
    -------
    Point
        The best met, also where time ran out.
    """
    point, damping = start, 0.0
    last: tuple[float, Array, Array] | None = None  # damping, position and step of one that was taken
    freedom = max(1, problem.samples.values.size - problem.size)
    d = len(problem.parameters)
    for count in range(_STEPS):
        budget.tell(span[0] + (span[1] - span[0]) * count / 10.0, point)
        if budget.late or point.value == 0.0:
            break
        matrix, right = problem.equations(point)
        step = bounded_step(problem, point, matrix, right, damping)
        gain = float(2.0 * step @ right - step @ matrix @ step)
        small = np.abs(step[:d]).max(initial=0.0) < _MOVED and damping == 0.0
        share = point.value / freedom
        if (abs(gain) < _GAIN * share and small) or damping > _MOST_DAMPING:
            break
        if 0.0 < gain < max(rough * point.value, _NO_GAIN * share):
            break
        position = np.concatenate([point.x, point.coefficients.ravel()])
        before, last = (last, None) if last is not None and last[0] == damping else (None, last)
        mixed = step if before is None else _mixed(matrix, position, step, *before[1:])
        trial = problem.evaluate(*problem.moved(point, mixed)) if gain > 0.0 else point
        if trial.value < point.value:
            rewarded = point.value - trial.value > 0.1 * gain
            last = damping, position, step
            point, damping = trial, (0.0 if rewarded and damping <= _DAMPING else 0.1 * damping)
        else:
            damping = max(_DAMPING, 10.0 * damping)
    budget.tell(span[1], point)
    return point


def _mixed(matrix: Array, position: Array, step: Array, before: Array, last: Array) -> Array:
    """The step to where steps vanish, if they change as they did from `before`, where there was a step `last`."""
    change = step - last
    length = float(change @ matrix @ change)
    if not length > 0.0:
        return step
    share = float(step @ matrix @ change) / length
    return step - share * (position - before + change)


def bounded_step(problem: Problem, point: Point, matrix: Array, right: Array, damping: float) -> Array:
    """The step that solves the equations within the bounds: what would leave them stops there, the rest goes on."""
    position = np.concatenate([point.x, point.coefficients.ravel()])
    lower = -position
    upper = np.where(np.arange(len(position)) < len(point.x), 1.0 - position, np.inf)
    step = np.zeros(len(position))
    free = ~((lower >= 0.0) & (right <= 0.0) | (upper <= 0.0) & (right >= 0.0))
    for _ in range(len(position)):
        if not free.any():
            break
        rest = right[free] - matrix[np.ix_(free, ~free)] @ step[~free]
        step[free] = solve_scaled(matrix[np.ix_(free, free)], rest, damping)
        outside = free & ((step < lower) | (step > upper))
        if not outside.any():
            break
        step[outside] = np.clip(step, lower, upper)[outside]
        free &= ~outside
    return np.clip(step, lower, upper)
