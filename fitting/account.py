"""The last look at the cells: every metric of a fit, and what its uncertainty is made of, in one loop."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitting.moments import (
    ABSOLUTE_LOG,
    QUADRATIC,
    Cells,
    Shapes,
    average,
    touching,
)
from fitting.problem import Point, Problem, solve_scaled
from gonio.core.jit import kernel
from gonio.core.parallel import for_each

Array = NDArray[np.float64]

_CHUNKS = 32
_LEAST = 0.05  # of 1 - leverage
_ENOUGH = 150_000  # cells for a covariance
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
    bread : ndarray, shape (C, V, V)
        Half of the second derivatives of the objective, in terms of the vector v of `fitting.moments`.
    scores : ndarray, shape (C, C, V, V)
        Sums over cells of s_c s_c' v v', s = w r/(1 - h) with the leverage h of the value, by which its own pull
        on the fit makes its residual small (HC3, MacKinnon and White 1985): the scatter of its first
        derivatives. Both are estimated from one cell in several where there are very many.
    """

    metrics: dict[str, float]
    chi2_std: float
    neighbours: float
    bread: Array
    scores: Array


def account(problem: Problem, point: Point) -> Account:
    """Look at all cells once more, at the parameters of `point`."""
    shapes: Shapes = problem.shapes(point.x)
    back = problem.coefficients.feedback(shapes.packed)
    factors = problem.coefficients.factors(point.coefficients, back)
    cells: Cells = problem.cells
    samples, objective = problem.samples, problem.objective
    n, channels = samples.values.shape
    size = point.right.shape[1]
    chunks = max(1, min(_CHUNKS, n // 2000))
    stride = max(1, n // _ENOUGH)
    sums = np.zeros((chunks, 10))
    bread = np.zeros((chunks, channels, size, size))
    scores = np.zeros((chunks, channels, channels, size, size))
    leverage = _leverage(problem, point) / problem.norm
    variance = np.empty((0, channels)) if samples.variance is None else samples.variance

    def task(chunk: int) -> None:
        part = slice(chunk * n // chunks, (chunk + 1) * n // chunks)
        _account(
            *shapes,
            *cells.part(part),
            samples.sin_i[part],
            samples.sin_o[part],
            variance[part],
            factors,
            objective.difference,
            objective.scale,
            stride,
            leverage,
            sums[chunk],
            bread[chunk],
            scores[chunk],
        )

    for_each(task, chunks)
    total = sums.sum(axis=0)
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
    return Account(
        metrics,
        float(np.sqrt(min(total[_SPREAD], total[_BOUND]))),
        float(total[_PAIRS] / np.sqrt(total[_PAIRS2])) if total[_PAIRS2] > 0 else 0.0,
        stride * _symmetric(bread.sum(axis=0)),
        stride * _symmetric(scores.sum(axis=0)),
    )


def _leverage(problem: Problem, point: Point) -> Array:
    """Matrices K of every channel, shape (C, V, V): the leverage of a value is w v K v, times the norm."""
    matrix, _ = problem.equations(point)
    inverse = np.stack([solve_scaled(matrix, unit, 0.0) for unit in np.eye(problem.size)])
    d, j, channels = len(problem.parameters), len(problem.coefficients.names), problem.channels
    out = []
    for c, rule in enumerate(problem.maps(point)):
        places = np.concatenate([np.arange(d), d + np.arange(j) * channels + c])
        out.append(rule.T @ inverse[np.ix_(places, places)] @ rule)
    return np.array(out)


def _symmetric(lower: Array) -> Array:
    """From lower triangles, also over pairs of channels."""
    out = lower + np.swapaxes(np.tril(lower, -1), -1, -2)
    if out.ndim == 4:
        for c in range(len(out)):
            for d in range(c):
                out[d, c] = out[c, d]
    return out


@kernel
def _account(
    kinds, counts, packed, tangents, rows, rings, sectors, exact_rows, cells, levels, values, weights, cos_i,
    sin_i, sin_o, variance, factors, difference, scale, stride, leverage, sums, bread, scores,
):  # fmt: skip
    size, terms, channels = bread.shape[1], factors.shape[0], values.shape[1]
    v, scratch, score = np.empty(size), np.empty(2 * tangents.shape[1]), np.empty(channels)
    shared = weights.shape[1] == 1
    before = np.zeros(channels)  # residuals of the last cell, in standard errors
    for n in range(len(cells)):
        level = np.int64(levels[n])
        sampled = n % stride == 0
        average(
            kinds, counts, packed, tangents, rows, rings, sectors, exact_rows, cells[n], level, sampled, scratch,
            v if sampled else v[:terms],
        )  # fmt: skip
        ngan = cos_i[n] * cos_i[n] * sin_i[n] * sin_o[n]
        excess, bound, pair = 0.0, 0.0, 0.0
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
            root = np.cbrt(f) - np.cbrt(g)
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
            if not sampled:
                continue
            pull = 0.0
            for j in range(size):
                for k in range(size):
                    pull += v[j] * leverage[channel, j, k] * v[k]
            score[channel] = w * r / max(_LEAST, 1.0 - w * pull)
            if difference == ABSOLUTE_LOG:  # the rounded modulus' own curvature, not its bound
                w *= scale * scale / (log * log + scale * scale)
            for j in range(size):
                wv = w * v[j]
                for k in range(j + 1):
                    bread[channel, j, k] += wv * v[k]
        sums[_SPREAD] += excess * excess
        sums[_BOUND] += bound * bound
        if adjacent:
            sums[_PAIRS] += pair
            sums[_PAIRS2] += pair * pair
        if not sampled:
            continue
        for channel in range(channels):
            for other in range(channel + 1):
                w = score[channel] * score[other]
                for j in range(size):
                    wv = w * v[j]
                    for k in range(j + 1):
                        scores[channel, other, j, k] += wv * v[k]
