"""Coefficients for given shapes: non-negative least squares from the normal equations (variable projection).

Golub and Pereyra 1973: where the model is linear in some parameters, their best values are a function of
the others, and the search is over the others only. At those values the objective's derivatives by the
coefficients vanish, so its derivative by a shape parameter is that at fixed coefficients.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from fitting.models import SHAPE, Lobe

Array = NDArray[np.float64]

_HALVINGS = 8
_STEPS = 20
_DARK = 1e-10  # of the brightest term: a lobe that lies between all samples has no coefficient
_NULL = 1e-14  # of the largest eigenvalue: directions that change nothing


class Coefficients:
    """How the terms of several lobes depend on their coefficients.

    Term t, of the lobes in their order, has the factor `Term.factor` of coefficient owner[t]; `names` are
    (number of the lobe, name of the coefficient).
    """

    def __init__(self, lobes: Sequence[Lobe]) -> None:
        self.lobes = tuple(lobes)
        self.names = [(index, name) for index, lobe in enumerate(lobes) for name in lobe.coefficients]
        terms = [(i, term) for i, lobe in enumerate(lobes) for term in lobe.terms]
        self.lobe_of = np.array([i for i, _ in terms])
        self.owner = np.array([self.names.index((i, term.coefficient)) for i, term in terms])
        self.terms = [term for _, term in terms]
        self.power = np.array([term.power for term in self.terms])
        self.linear = all(term.power == 1 and term.feedback is None for term in self.terms)

    def feedback(self, packed: Array) -> Array:
        """`Term.feedback` of every term, shape (T,), for packed lobes."""
        return np.array([self._feedback(n, packed) for n in range(len(self.terms))])

    def feedback_slope(self, packed: Array, term: int, parameter: int) -> float:
        """Its derivative by a parameter of its lobe, by central differences: it is smooth."""
        if self.terms[term].feedback is None:
            return 0.0
        step = 1e-5
        ends = [packed.copy(), packed.copy()]
        for sign, end in zip((1.0, -1.0), ends, strict=True):
            end[self.lobe_of[term], SHAPE + parameter] += sign * step
        return (self._feedback(term, ends[0]) - self._feedback(term, ends[1])) / (2.0 * step)

    def _feedback(self, term: int, packed: Array) -> float:
        function = self.terms[term].feedback
        if function is None:
            return 0.0
        lobe = self.lobe_of[term]
        return function(*packed[lobe, SHAPE : SHAPE + len(self.lobes[lobe].parameters)])

    def factors(self, coefficients: Array, back: Array) -> Array:
        """Factor of every term, shape (T, C), from the coefficients, shape (J, C), and their feedback."""
        c = coefficients[self.owner]
        back = back.reshape(-1, *[1] * (c.ndim - 1))
        power = self.power.reshape(-1, *[1] * (c.ndim - 1))
        return c**power / (1.0 - back * c)

    def factor_slopes(self, coefficients: Array, back: Array) -> Array:
        """Derivative of every term's factor by its coefficient, shape (T, C)."""
        c = coefficients[self.owner]
        back = back.reshape(-1, *[1] * (c.ndim - 1))
        power = self.power.reshape(-1, *[1] * (c.ndim - 1))
        rest = 1.0 - back * c
        return np.where(power == 1, 1.0, 2.0 * c) / rest + c**power * back / rest**2

    def solve(self, gram: Array, right: Array, start: Array, back: Array) -> Array:
        """Best non-negative coefficients of one channel.

        Parameters
        ----------
        gram : ndarray, shape (T, T)
            Sums of w t t'.
        right : ndarray, shape (T,)
            Sums of w t r, with the residual r at `start`.
        start : ndarray, shape (J,)
        back : ndarray, shape (T,)
            `feedback`.

        Returns
        -------
        ndarray, shape (J,)
            `start` where the equations are not finite.
        """
        if not (np.all(np.isfinite(gram)) and np.all(np.isfinite(right))):
            return start
        at_start = self.factors(start, back)
        scale = np.sqrt(np.maximum(np.diag(gram), 0.0))
        seen = np.bincount(self.owner, scale > _DARK * scale.max(initial=0.0), len(start)) > 0
        if np.any(start[~seen]):  # of no influence here, it may have any size, and spoil all cells elsewhere
            start = np.where(seen, start, 0.0)
            right = right + gram @ (at_start - self.factors(start, back))
            at_start = self.factors(start, back)
        if self.linear:
            step = _least_squares(gram, right)
            if np.all(start + step >= 0.0):  # the residual's own digits are kept
                return start + step
            return _nonnegative(gram, right + gram @ at_start)
        if not start.any():  # begin with what enters linearly
            first = np.flatnonzero(self.power == 1)
            start = np.zeros(len(self.names))
            start[self.owner[first]] = _nonnegative(
                gram[np.ix_(first, first)], (right + gram @ at_start)[first]
            )
            start = np.minimum(
                start, 0.9 / np.maximum(back.max(), 0.9)
            )  # where a series of bounces has a sum
        return self._newton(gram, right, at_start, start, back)

    def _newton(self, gram: Array, right: Array, at_start: Array, c: Array, back: Array) -> Array:
        """Gauss and Newton's steps on coefficients that enter as powers, from a point near the best."""
        chosen = np.zeros((len(self.owner), len(c)))
        chosen[np.arange(len(self.owner)), self.owner] = 1.0

        def value(c: Array) -> float:
            moved = self.factors(c, back) - at_start
            return float(moved @ gram @ moved - 2.0 * moved @ right)

        best = value(c)
        for _ in range(_STEPS):
            slopes = chosen * self.factor_slopes(c, back)[:, None]
            left = right - gram @ (self.factors(c, back) - at_start)
            free = (c > 0.0) | (slopes.T @ left > 0.0)
            step = np.zeros(len(c))
            step[free] = _least_squares(
                (slopes.T @ gram @ slopes)[np.ix_(free, free)], (slopes.T @ left)[free]
            )
            for _ in range(_HALVINGS):
                following = np.maximum(0.0, c + step)
                allowed = np.all(back * following[self.owner] < 1.0)
                after = value(following) if allowed else np.inf
                if after < best:
                    break
                step = 0.25 * step
            if not after < best:
                break
            done = np.allclose(following, c, rtol=1e-13, atol=0.0)
            c, best = following, after
            if done:
                break
        return c


def _scaled(gram: Array) -> tuple[NDArray[np.bool_], Array, Array, Array]:
    """Which columns there are, their lengths, and eigenvalues and vectors of the rest that matter."""
    scale = np.sqrt(np.maximum(np.diag(gram), 0.0))
    used = scale > _DARK * scale.max(initial=0.0)
    s = scale[used]
    if not used.any():
        return used, s, np.zeros(0), np.zeros((0, 0))
    values, vectors = np.linalg.eigh(gram[np.ix_(used, used)] / np.outer(s, s))
    keep = values > _NULL * values[-1]
    return used, s, values[keep], vectors[:, keep]


def _least_squares(gram: Array, right: Array) -> Array:
    """Minimum of c G c - 2 c r; of several the shortest."""
    used, s, values, vectors = _scaled(gram)
    c = np.zeros(len(right))
    c[used] = vectors @ (vectors.T @ (right[used] / s) / values) / s
    return c


def _nonnegative(gram: Array, right: Array) -> Array:
    """The same over c >= 0."""
    used, s, values, vectors = _scaled(gram)
    c = np.zeros(len(right))
    if used.any():
        root = np.sqrt(values)
        solution, _ = nnls(root[:, None] * vectors.T, vectors.T @ (right[used] / s) / root)
        c[used] = solution / s
    return c
