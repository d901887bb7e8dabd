"""A model, samples and an objective: value, gradient and Gauss-Newton equations at any parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fitting.linear import Coefficients
from fitting.models import SIZE, Lobe, Parameter
from fitting.moments import Cells, Moments, Shapes, moments
from fitting.objectives import Objective
from fitting.samples import Samples

Array = NDArray[np.float64]

_INNER = 8  # steps over coefficients alone
_ABSURD = 1e6  # times the objective of a model that is 0: differences of such numbers have no digits left


@dataclass(frozen=True, eq=False)
class Point:
    """Parameters, and what the objective is there.

    Parameters
    ----------
    x : ndarray, shape (D,)
        Shape parameters on [0, 1], see `Parameter.from_unit`.
    coefficients : ndarray, shape (J, C)
    value : float
        Of the objective, divided by `Problem.norm`.
    right : ndarray, shape (C, V)
    gram : ndarray, shape (C, V, V)
        See `fitting.moments`.
    """

    x: Array
    coefficients: Array
    value: float
    right: Array
    gram: Array


class Problem:
    """What is minimised, as a function of the shape parameters on [0, 1] and of the coefficients."""

    def __init__(
        self, lobes: Sequence[Lobe], samples: Samples, objective: Objective, levels: NDArray[np.int8]
    ) -> None:
        self.lobes = tuple(lobes)
        self.samples, self.objective = samples, objective
        self.coefficients = Coefficients(lobes)
        self.parameters: list[tuple[int, Parameter]] = [
            (i, q) for i, lobe in enumerate(lobes) for q in lobe.parameters
        ]
        self._kinds = np.array([lobe.kind for lobe in lobes], np.int64)
        self._counts = np.array([[len(lobe.terms), len(lobe.parameters)] for lobe in lobes], np.int64)
        grid = samples.grid
        self.cells = Cells(
            (grid.rows, grid.rings, grid.sectors),
            grid.exact_rows,
            samples.cells,
            levels,
            samples.values,
            objective.weights,
            samples.cos_i,
        )
        self.norm = float(objective.shares(samples).sum()) or 1.0
        self.evaluations = 0

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.parameters) + len(self.coefficients.names) * self.channels

    @property
    def channels(self) -> int:
        """Of the samples."""
        return self.samples.values.shape[1]

    def values(self, x: Array) -> list[list[float]]:
        """Shape parameters of every lobe, for the search's variables."""
        out: list[list[float]] = [[] for _ in self.lobes]
        for u, (i, parameter) in zip(x, self.parameters, strict=True):
            out[i].append(parameter.from_unit(float(u)))
        return out

    def shapes(self, x: Array) -> Shapes:
        """Packed lobes for the search's variables."""
        values = self.values(x)
        most = max(1, *(len(v) for v in values)) if values else 1
        packed, tangents = np.zeros((len(values), SIZE)), np.zeros((len(values), most, SIZE))
        for k, (lobe, v) in enumerate(zip(self.lobes, values, strict=True)):
            packed[k] = lobe.pack(dict(zip((q.name for q in lobe.parameters), v, strict=True)))
            tangents[k, : len(v)] = lobe.tangents(v)
        return Shapes(self._kinds, self._counts, packed, tangents)

    def evaluate(
        self, x: Array, coefficients: Array | None, *, solve: bool = True, slopes: bool = True
    ) -> Point:
        """The objective at shape parameters and coefficients, which a quadratic one then improves to the best.

        Parameters
        ----------
        x : ndarray, shape (D,)
        coefficients : ndarray, shape (J, C), or None
            None is 0.
        solve : bool
            Take the best coefficients; of a quadratic objective only, which knows them without looking again.
        slopes : bool
            Include the derivatives by shape parameters.
        """
        self.evaluations += 1
        if coefficients is None:
            coefficients = np.zeros((len(self.coefficients.names), self.channels))
        shapes = self.shapes(x)
        back = self.coefficients.feedback(shapes.packed)
        before = self.coefficients.factors(coefficients, back)
        found = moments(shapes, self.cells, before, self.objective.difference, self.objective.scale, slopes)
        if not solve or not self.objective.quadratic:
            value = float(found.objective.sum()) / self.norm
            return Point(x, coefficients, value, found.right, found.gram)
        if coefficients.any() and not found.objective.sum() <= _ABSURD * self.norm:
            return self.evaluate(x, None, slopes=slopes)
        return self._eliminated(x, coefficients, before, back, found)

    def _eliminated(self, x: Array, start: Array, before: Array, back: Array, found: Moments) -> Point:
        terms = len(before)
        coefficients = np.stack(
            [
                self.coefficients.solve(g[:terms, :terms], r[:terms], c, back)
                for g, r, c in zip(found.gram, found.right, start.T, strict=True)
            ],
            axis=1,
        )
        moved = self.coefficients.factors(coefficients, back) - before
        toward = np.einsum("cvt,tc->cv", found.gram[:, :, :terms], moved)
        if not np.sum(moved.T * toward[:, :terms]) <= _ABSURD * self.norm:
            return Point(x, start, float(found.objective.sum()) / self.norm, found.right, found.gram)
        value = found.objective.sum() - np.sum(moved.T * (2.0 * found.right - toward)[:, :terms])
        return Point(x, coefficients, max(0.0, float(value)) / self.norm, found.right - toward, found.gram)

    def model(self, point: Point) -> Array:
        """The model's averages over the cells, 1/sr, shape (N, C)."""
        shapes = self.shapes(point.x)
        factors = self.coefficients.factors(point.coefficients, self.coefficients.feedback(shapes.packed))
        used = np.concatenate([2 * k + np.arange(n) for k, (n, _) in enumerate(self._counts)])
        return self.samples.terms(self._kinds, shapes.packed, self.cells.levels)[:, used] @ factors

    def reduced(self, x: Array, coefficients: Array | None) -> Point:
        """The objective at shape parameters and the best coefficients for them, near `coefficients`."""
        if self.objective.quadratic:
            return self.evaluate(x, coefficients)
        if coefficients is None:
            coefficients = self.first_coefficients(x)
        point = self.evaluate(x, coefficients)
        for _ in range(_INNER):
            matrix, right = self.equations(point)
            d = len(self.parameters)
            matrix, right = matrix[d:, d:], right[d:]
            free = (point.coefficients.ravel() > 0.0) | (right > 0.0)
            step = np.zeros(len(right))
            step[free] = solve_scaled(matrix[np.ix_(free, free)], right[free], 0.0)
            for _ in range(6):
                trial = self.evaluate(x, self.moved(point, np.concatenate([np.zeros(d), step]))[1])
                if trial.value < point.value:
                    break
                step = 0.25 * step
            gain = point.value - trial.value
            if gain > 0.0:
                point = trial
            if not gain > 1e-6 * point.value:
                break
        return point

    def first_coefficients(self, x: Array) -> Array:
        """Coefficients to start from where the objective is not quadratic: of least squares."""
        plain = replace(self.objective, difference=0, weights=self.relative_weights())
        problem = Problem(self.lobes, self.samples, plain, self.cells.levels)
        found = problem.evaluate(x, None, slopes=False).coefficients
        # the slope of a root at 0 is infinite: begin inside
        return np.maximum(found, 1e-3 * found.max(axis=0, initial=0.0))

    def relative_weights(self) -> Array:
        """Least squares with these is near the logarithmic objectives where the model is near the values."""
        f = np.maximum(self.samples.values * self.samples.cos_i[:, None], 0.0)
        return self.objective.weights * (self.samples.cos_i[:, None] / (1.0 + f)) ** 2

    def equations(self, point: Point) -> tuple[Array, Array]:
        """Gauss and Newton's matrix and right side for a step of all unknowns, divided by the norm.

        Returns
        -------
        matrix : ndarray, shape (M, M)
            Half of the objective's second derivatives, M = `size`: shape parameters first, then the
            coefficients, those of one name side by side for all channels.
        right : ndarray, shape (M,)
            Minus half of its first derivatives.
        """
        maps = self.maps(point)
        matrix, right = np.zeros((self.size, self.size)), np.zeros(self.size)
        for c, own in enumerate(self.places):
            matrix[np.ix_(own, own)] += maps[c] @ point.gram[c] @ maps[c].T
            right[own] += maps[c] @ point.right[c]
        return matrix / self.norm, right / self.norm

    @property
    def places(self) -> NDArray[np.int64]:
        """Which unknowns each channel has, shape (C, D + J)."""
        d, j, channels = len(self.parameters), len(self.coefficients.names), self.channels
        return np.stack(
            [np.concatenate([np.arange(d), d + np.arange(j) * channels + c]) for c in range(channels)]
        )

    def maps(self, point: Point) -> Array:
        """Derivatives of the model by the unknowns of each channel, of the vector v: shape (C, D + J, V)."""
        shapes = self.shapes(point.x)
        rule = self.coefficients
        back = rule.feedback(shapes.packed)
        factors = rule.factors(point.coefficients, back)
        by_coefficient = rule.factor_slopes(point.coefficients, back)
        d, terms = len(self.parameters), len(factors)
        out = np.zeros((self.channels, d + len(rule.names), point.right.shape[1]))
        for t, j in enumerate(rule.owner.tolist()):
            out[:, d + j, t] = by_coefficient[t]
        at = terms
        first = {i: n for n, (i, _) in reversed(list(enumerate(self.parameters)))}
        for n, (i, parameter) in enumerate(self.parameters):
            scale = parameter.slope(float(point.x[n]))
            for t in np.flatnonzero(rule.lobe_of == i).tolist():
                out[:, n, at] = scale * factors[t]
                bounce = rule.feedback_slope(shapes.packed, t, n - first[i])
                if bounce != 0.0:
                    c = point.coefficients[rule.owner[t]]
                    out[:, n, t] += scale * bounce * c ** (rule.power[t] + 1) / (1.0 - back[t] * c) ** 2
                at += 1
        return out

    def moved(self, point: Point, step: Array) -> tuple[Array, Array]:
        """Shape parameters and coefficients after a step, kept in their ranges."""
        d = len(self.parameters)
        x = np.clip(point.x + step[:d], 0.0, 1.0)
        coefficients = np.maximum(0.0, point.coefficients + step[d:].reshape(point.coefficients.shape))
        if not self.coefficients.linear:  # a series of bounces must have a sum
            back = self.coefficients.feedback(self.shapes(x).packed)
            for t, j in enumerate(self.coefficients.owner.tolist()):
                if back[t] > 0.0:
                    coefficients[j] = np.minimum(coefficients[j], 0.999 / back[t])
        return x, coefficients


def solve_scaled(matrix: Array, right: Array, damping: float) -> Array:
    """Solution, for one right side or a matrix of several, of equations scaled to a unit diagonal.

    `damping` is added to the diagonal; null directions stay put.
    """
    if len(right) == 0:
        return right
    scale = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    scale[scale == 0.0] = np.inf
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    keep = values > 1e-15 * max(values[-1], 1e-300)
    basis = vectors[:, keep] / scale[:, None]
    return basis @ ((basis.T @ right).T / (values[keep] + damping)).T
