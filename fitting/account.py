"""The last look at the cells: every metric of a fit, and what its uncertainty is made of, in one loop."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitting.cube_root import cube_root
from fitting.modulus import expected
from fitting.moments import (
    ABSOLUTE_LOG,
    BLOCK,
    QUADRATIC,
    Cells,
    Shapes,
    averages,
    new_scratch,
    touching,
)
from fitting.problem import Point, Problem, solve_scaled
from gonio.core.jit import kernel
from gonio.core.parallel import for_each

Array = NDArray[np.float64]

_CHUNKS = 32
_LEAST = 0.05  # of 1 - leverage
_NGAN, _NORM, _LOW, _NBRDF, _CUBE, _CHI2, _SPREAD, _BOUND, _PAIRS, _PAIRS2 = range(10)


@dataclass(frozen=True, eq=False)
class Account:
    """What a model is worth on some samples.

    Parameters
    ----------
    metrics : dict of str to float
        ngan_l2, low_log, nbrdf, cube_root, and chi2 where errors are known, see `fitting.objectives`;
        relative_ngan_l2, the root of ngan_l2 over the same sum with f for e: cosine-weighted RMSE relative
        to the measurement's, 0 where all values are 0.
    chi2_std : float
        Standard deviation of chi2 from its scatter over cells, the channels of a cell being taken as one; at
        most that of counts (variance 2 + variance/g^2 each) whose channels are all the same.
    neighbours : float
        Correlation of the residuals of cells side by side in delta phi, in units of its standard deviation.
    matrix : ndarray, shape (M, M)
        Half of the second derivatives of the objective by the unknowns, in the order of `Problem.equations`; of
        a modulus in the mean over the noise, see `fitting.modulus`.
    scatter : ndarray, shape (M, M)
        Of its first derivatives: sums over cells of u u', u = sum over channels of w r/(1 - h) and the model's
        derivatives, with the leverage h of the value, by which its own pull on the fit makes its residual
        small (HC3, MacKinnon and White 1985).
    held : ndarray of bool, shape (M,)
        At a bound, or without any influence.
    freedom : ndarray, shape (M,)
        How well the scatter is known along each unknown, in degrees of freedom. An unknown moves by q = sum of
        the q_n of cells. With t_n the variance of q_n, the estimate sum q_n^2 scatters like chi^2 of
        (sum t)^2 / sum t^2 degrees of freedom (Satterthwaite 1946; of scatters like this one, Bell and McCaffrey
        2002), and of Gaussian errors sum q^4 is 3 sum t^2 and (sum q^2)^2 is (sum t)^2 + 2 sum t^2 in the
        mean. A thousand cells can be three, where errors or weights are uneven.
    """

    metrics: dict[str, float]
    chi2_std: float
    neighbours: float
    matrix: Array
    scatter: Array
    held: NDArray[np.bool_]
    freedom: Array


def account(problem: Problem, point: Point) -> Account:
    """Look at all cells once more, at the parameters of `point`."""
    shapes: Shapes = problem.shapes(point.x)
    back = problem.coefficients.feedback(shapes.packed)
    factors = problem.coefficients.factors(point.coefficients, back)
    cells: Cells = problem.cells
    samples, objective = problem.samples, problem.objective
    n, channels = samples.values.shape
    chunks = max(1, min(_CHUNKS, n // 2000))
    curved, weights = problem, np.empty((0, channels))
    if objective.difference == ABSOLUTE_LOG:
        curved = expected(problem, point)
        weights = curved.objective.weights
        point = curved.evaluate(point.x, point.coefficients, solve=False)
    matrix = curved.equations(point)[0]
    held = _held(matrix, point)
    matrix *= curved.norm
    inverse = inverse_over(matrix, ~held)
    maps, places = problem.maps(point), problem.places
    leverage = np.stack(
        [rule.T @ inverse[np.ix_(own, own)] @ rule for rule, own in zip(maps, places, strict=True)]
    )
    variance = np.empty((0, channels)) if samples.variance is None else samples.variance

    def task(chunk: int) -> tuple[Array, Array, Array]:
        part = slice(chunk * n // chunks, (chunk + 1) * n // chunks)
        sums: tuple[Array, Array, Array] = _account(
            *shapes,
            *cells.part(part),
            samples.sin_i[part],
            samples.sin_o[part],
            variance[part],
            factors,
            objective.difference,
            objective.scale,
            weights[part],
            leverage,
            maps,
            places,
            inverse,
        )
        return sums

    total, scatter, powers = (np.sum(parts, axis=0) for parts in zip(*for_each(task, chunks), strict=True))
    values = n * channels
    metrics = {
        "ngan_l2": float(total[_NGAN]),
        "relative_ngan_l2": float(np.sqrt(total[_NGAN] / total[_NORM])) if total[_NORM] > 0 else 0.0,
        "low_log": float(total[_LOW]),
        "nbrdf": float(total[_NBRDF] / values),
        "cube_root": float(np.sqrt(total[_CUBE] / values)),
    }
    if samples.variance is not None:
        metrics["chi2"] = float(total[_CHI2])
    square, fourth = powers
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        freedom = 3.0 * square**2 / fourth - 2.0
    return Account(
        metrics,
        float(np.sqrt(min(total[_SPREAD], total[_BOUND]))),
        float(total[_PAIRS] / np.sqrt(total[_PAIRS2])) if total[_PAIRS2] > 0 else 0.0,
        matrix,
        _symmetric(scatter),
        held,
        freedom,
    )


def _held(matrix: Array, point: Point) -> NDArray[np.bool_]:
    """Which unknowns are at a bound or change nothing."""
    position = np.concatenate([point.x, point.coefficients.ravel()])
    shape = np.arange(len(position)) < len(point.x)
    return (np.diag(matrix) <= 0.0) | (position <= 0.0) | (shape & (position >= 1.0))


def inverse_over(matrix: Array, free: NDArray[np.bool_]) -> Array:
    """Inverse of the part of a matrix that belongs to the free unknowns, 0 elsewhere."""
    out = np.zeros_like(matrix)
    within = np.ix_(free, free)
    out[within] = solve_scaled(matrix[within], np.eye(int(free.sum())), 0.0)
    return out


def _symmetric(lower: Array) -> Array:
    """From lower triangles."""
    full: Array = lower + np.swapaxes(np.tril(lower, -1), -1, -2)
    return full


@kernel
def _account(
    kinds, counts, packed, tangents, rows, rings, sectors, exact_rows, cells, levels, values, weights, cos_i,
    sin_i, sin_o, variance, factors, difference, scale, curved, leverage, maps, places, inverse,
):  # fmt: skip
    """The sums over some cells: ten as numbered above; of u u', the lower triangle; of q^2 and q^4."""
    size, terms, channels = maps.shape[2], factors.shape[0], values.shape[1]
    block, scratch, u = np.empty((BLOCK, size)), new_scratch(tangents), np.empty(len(inverse))
    sums, scatter, powers = np.zeros(10), np.zeros(inverse.shape), np.zeros((2, len(inverse)))
    shared = weights.shape[1] == 1
    before = np.zeros(channels)  # residuals of the last cell, in standard errors
    for n in range(len(cells)):
        at = n % BLOCK
        if at == 0:
            averages(
                kinds, counts, packed, tangents, rows, rings, sectors, exact_rows, cells[n : n + BLOCK],
                levels[n : n + BLOCK], True, scratch, block,
            )  # fmt: skip
        v = block[at]
        ngan = cos_i[n] * cos_i[n] * sin_i[n] * sin_o[n]
        excess, bound, pair = 0.0, 0.0, 0.0
        u[:] = 0.0
        last = n - 1
        adjacent = (
            n > 0
            and cells[n, 0] == cells[last, 0]
            and cells[n, 1] == cells[last, 1]
            and cells[n, 2] == cells[last, 2] + 1
        )
        for channel in range(channels):
            model = 0.0
            for t in range(terms):
                model += factors[t, channel] * v[t]
            y = values[n, channel]
            e = y - model
            f, g = max(0.0, y * cos_i[n]), max(0.0, model * cos_i[n])
            log = math.log((1.0 + f) / (1.0 + g))
            root = cube_root(f) - cube_root(g)
            sums[_NGAN] += ngan * e * e
            sums[_NORM] += ngan * y * y
            sums[_LOW] += sin_i[n] * log * log
            sums[_NBRDF] += abs(log)
            sums[_CUBE] += root * root
            if len(variance) > 0:
                chi2 = e * e / variance[n, channel]
                sums[_CHI2] += chi2
                excess += chi2 - 1.0
                here = e / math.sqrt(variance[n, channel])
                pair += here * before[channel]
                before[channel] = here
                bound += math.sqrt(2.0 + variance[n, channel] / (model * model))
            w, r = weights[n, 0 if shared else channel], e
            if difference != QUADRATIC:
                _, w, r = touching(difference, scale, y, model, cos_i[n], w)
            pull = 0.0
            for j in range(size):
                for k in range(size):
                    pull += v[j] * leverage[channel, j, k] * v[k]
            own = curved[n, channel] if len(curved) > 0 else w
            score = w * r / max(_LEAST, 1.0 - own * pull)
            for m in range(places.shape[1]):
                slope = 0.0
                for j in range(size):
                    slope += maps[channel, m, j] * v[j]
                u[places[channel, m]] += score * slope
        sums[_SPREAD] += excess * excess
        sums[_BOUND] += bound * bound
        if adjacent:
            sums[_PAIRS] += pair
            sums[_PAIRS2] += pair * pair
        for j in range(len(u)):
            q = 0.0
            for k in range(len(u)):
                q += inverse[j, k] * u[k]
            powers[0, j] += q**2
            powers[1, j] += q**4
            for k in range(j + 1):
                scatter[j, k] += u[j] * u[k]
    return sums, scatter, powers
