"""Coefficients for given shapes: non-negative least squares from the normal equations (variable projection).

Golub and Pereyra 1973: where the model is linear in some parameters, their best values are a function of
the others, and the search is over the others only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy.optimize import nnls

from fitting.models import SHAPE, Lobe

Array = NDArray[np.float64]

_SWEEPS = 500


class Coefficients:
    """How the terms of several lobes depend on their coefficients.

    Slot 2 l + t of the kernels is term t of lobe l; its factor is `Term.factor` of one coefficient.
    """

    def __init__(self, lobes: Sequence[Lobe]) -> None:
        self.names = [(index, name) for index, lobe in enumerate(lobes) for name in lobe.coefficients]
        slots = [
            (2 * i + t, (i, term.coefficient), term)
            for i, lobe in enumerate(lobes)
            for t, term in enumerate(lobe.terms)
        ]
        self.slots = np.array([slot for slot, _, _ in slots])
        self.owner = np.array([self.names.index(name) for _, name, _ in slots])
        self.terms = [term for _, _, term in slots]
        self.power = np.array([term.power for term in self.terms])
        self._linear = all(term.power == 1 and term.feedback is None for term in self.terms)
        self._parameters = [len(lobe.parameters) for lobe in lobes]

    def factors(self, coefficients: Array, shapes: Array) -> Array:
        """Factor of every slot, shape (2 L, C), from the coefficients, shape (J, C), and the packed lobes."""
        out = np.zeros((2 * len(shapes), coefficients.shape[1]))
        back = self._feedback(shapes)[:, None]
        out[self.slots] = coefficients[self.owner] ** self.power[:, None] / (
            1.0 - back * coefficients[self.owner]
        )
        return out

    def _feedback(self, shapes: Array) -> Array:
        """`Term.feedback` of every slot in use."""
        out = np.zeros(len(self.terms))
        for n, term in enumerate(self.terms):
            if term.feedback is not None:
                lobe = self.slots[n] // 2
                out[n] = term.feedback(*shapes[lobe, SHAPE : SHAPE + self._parameters[lobe]])
        return out

    def solve(self, equations: Array, squares: Array, shapes: Array) -> tuple[Array, float]:
        """Best non-negative coefficients.

        Parameters
        ----------
        equations : ndarray, shape (C, 2 L, 2 L + 1)
            From `fitting.kernels.normal_equations`.
        squares : ndarray, shape (C,)
            Sum of w y^2 of each channel.
        shapes : ndarray, shape (L, SIZE)
            Packed lobes.

        Returns
        -------
        coefficients : ndarray, shape (J, C)
        residual : float
            Weighted sum of squared errors, all channels.
        """
        coefficients = np.zeros((len(self.names), len(squares)))
        residual = 0.0
        back = self._feedback(shapes)
        for channel, square in enumerate(squares):
            gram = equations[channel][np.ix_(self.slots, self.slots)]
            gram = np.tril(gram) + np.tril(gram, -1).T
            right = equations[channel][self.slots, -1]
            if not (np.all(np.isfinite(gram)) and np.all(np.isfinite(right))):
                return coefficients, np.inf
            if self._linear:
                c = _nonnegative(gram, right)
            else:
                c = self._coupled(gram, right, back)
            coefficients[:, channel] = c
            f = c[self.owner] ** self.power / (1.0 - back * c[self.owner])
            residual += max(0.0, float(square - 2.0 * f @ right + f @ gram @ f))
        return coefficients, residual

    def _coupled(self, gram: Array, right: Array, back: Array) -> Array:
        """One coefficient at a time, until none moves: the best of each is a root of a polynomial."""
        c = np.zeros(len(self.names))
        for _ in range(_SWEEPS):
            before = c.copy()
            for j in range(len(c)):
                own = np.flatnonzero(self.owner == j)
                f = c[self.owner] ** self.power / (1.0 - back * c[self.owner])
                f[own] = 0.0
                pull = right[own] - gram[own] @ f
                c[j] = _best(gram[np.ix_(own, own)], pull, self.power[own], float(back[own].max()))
            if np.allclose(c, before, rtol=1e-12, atol=0.0):
                break
        return c


def _best(gram: Array, right: Array, power: NDArray[np.int64], back: float) -> float:
    """Minimum of f G f - 2 f r over x >= 0, where f is x^power, the squared ones over 1 - back x.

    With x = t/(1 + back t) every f is t^power/(1 + back t), and what is minimised is
    squares/(1 + back t)^2 - 2 products/(1 + back t), two polynomials. Its minimum is 0 or a root of a third.
    """
    powers = [Polynomial([0.0] * m + [1.0]) for m in power]
    products = sum((r * t for r, t in zip(right, powers, strict=True)), Polynomial([0.0]))
    squares = Polynomial([0.0])
    for row, t in zip(gram, powers, strict=True):
        squares += sum((g * t * other for g, other in zip(row, powers, strict=True)), Polynomial([0.0]))
    one = Polynomial([1.0, back])
    slope = squares.deriv() * one - 2.0 * back * squares
    slope -= 2.0 * one * (products.deriv() * one - back * products)
    roots = slope.roots()
    real = roots.real[np.abs(roots.imag) < 1e-9 * (1.0 + np.abs(roots.real))]
    t = min(
        (t for t in [0.0, *real] if t >= 0.0),
        key=lambda t: float(squares(t) / one(t) ** 2 - 2.0 * products(t) / one(t)),
    )
    return t / (1.0 + back * t)


def _nonnegative(gram: Array, right: Array) -> Array:
    """Minimum of c G c - 2 c r over c >= 0; of several, identical lobes for one, a small one."""
    scale = np.sqrt(np.maximum(np.diag(gram), 0.0))
    used = scale > 0.0
    c = np.zeros(len(right))
    if not used.any():
        return c
    s = scale[used]
    values, vectors = np.linalg.eigh(gram[np.ix_(used, used)] / np.outer(s, s))
    keep = values > 1e-14 * values[-1]
    root = np.sqrt(values[keep])
    solution, _ = nnls(root[:, None] * vectors[:, keep].T, vectors[:, keep].T @ (right[used] / s) / root)
    c[used] = solution / s
    return c
