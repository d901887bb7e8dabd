"""Coefficients for given shapes: non-negative least squares from the normal equations (variable projection).

Golub and Pereyra 1973: where the model is linear in some parameters, their best values are a function of
the others, and the search is over the others only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from fitting.models import Lobe

Array = NDArray[np.float64]

_SWEEPS = 500


class Coefficients:
    """How the terms of several lobes depend on their coefficients.

    Slot 2 l + t of the kernels is term t of lobe l; its factor is one coefficient to a power.
    """

    def __init__(self, lobes: Sequence[Lobe]) -> None:
        self.names = [(index, name) for index, lobe in enumerate(lobes) for name in lobe.coefficients]
        slots = [
            (2 * i + t, (i, term.coefficient), term.power)
            for i, lobe in enumerate(lobes)
            for t, term in enumerate(lobe.terms)
        ]
        self.slots = np.array([slot for slot, _, _ in slots])
        self.owner = np.array([self.names.index(name) for _, name, _ in slots])
        self.power = np.array([power for _, _, power in slots])
        self._size = 2 * len(lobes)

    def factors(self, coefficients: Array) -> Array:
        """Factor of every slot, shape (2 L, C), from the coefficients, shape (J, C)."""
        out = np.zeros((self._size, coefficients.shape[1]))
        out[self.slots] = coefficients[self.owner] ** self.power[:, None]
        return out

    def solve(self, equations: Array, squares: Array) -> tuple[Array, float]:
        """Best non-negative coefficients.

        Parameters
        ----------
        equations : ndarray, shape (C, 2 L, 2 L + 1)
            From `fitting.kernels.normal_equations`.
        squares : ndarray, shape (C,)
            Sum of w y^2 of each channel.

        Returns
        -------
        coefficients : ndarray, shape (J, C)
        residual : float
            Weighted sum of squared errors, all channels.
        """
        coefficients = np.zeros((len(self.names), len(squares)))
        residual = 0.0
        for channel, square in enumerate(squares):
            gram = equations[channel][np.ix_(self.slots, self.slots)]
            gram = np.tril(gram) + np.tril(gram, -1).T
            right = equations[channel][self.slots, -1]
            if not (np.all(np.isfinite(gram)) and np.all(np.isfinite(right))):
                return coefficients, np.inf
            if np.all(self.power == 1):
                c = _nonnegative(gram, right)
            else:
                c = self._coupled(gram, right)
            coefficients[:, channel] = c
            f = c[self.owner] ** self.power
            residual += max(0.0, float(square - 2.0 * f @ right + f @ gram @ f))
        return coefficients, residual

    def _coupled(self, gram: Array, right: Array) -> Array:
        """One coefficient at a time: in each, the sum of squares is a polynomial whose minimum is a root."""
        c = np.zeros(len(self.names))
        for _ in range(_SWEEPS):
            before = c.copy()
            for j in range(len(c)):
                own = self.owner == j
                rest = np.where(own, 0.0, c[self.owner] ** self.power)
                slope = np.zeros(2 * self.power.max())  # coefficients of half the derivative, rising powers
                for s in np.flatnonzero(own):
                    m = self.power[s]
                    slope[m - 1] += m * (gram[s] @ rest - right[s])
                    for t in np.flatnonzero(own):
                        slope[m - 1 + self.power[t]] += m * gram[s, t]
                roots = np.roots(slope[::-1])
                real = roots.real[np.abs(roots.imag) < 1e-9 * (1.0 + np.abs(roots.real))]
                c[j] = min(
                    (max(0.0, x) for x in [0.0, *real]),
                    key=lambda x: sum(a * x ** (k + 1) / (k + 1) for k, a in enumerate(slope)),
                )
            if np.allclose(c, before, rtol=1e-12, atol=0.0):
                break
        return c


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
