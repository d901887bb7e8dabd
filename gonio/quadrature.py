"""Integrals over the upper hemisphere, bin by bin, with an estimate of their error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import direction

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Quadrature:
    """Integrals over the bins of a (theta_o, phi_o) grid on the upper hemisphere, with their error.

    Parameters
    ----------
    bins : tuple of int
        Bins in theta_o and phi_o.
    max_points : int
        Evaluations allowed per integral.
    tolerance : float
        Subdivision stops where the sum of all bins' changes is below this fraction of the integral.
    """

    bins: tuple[int, int] = (32, 64)
    max_points: int = 2_000_000
    tolerance: float = 2e-4

    def integrate(self, function: Callable[[Array], Array]) -> tuple[Array, Array]:
        """Integrate over solid angle bin by bin.

        Parameters
        ----------
        function : callable
            From directions of shape (N, 3) to values of shape (N, ...).

        Returns
        -------
        integrals, errors : ndarray, shape (bins_theta, bins_phi, ...)
            `errors` is the change at the last doubling of the subdivision.
        """
        previous = self._rule(function, 1)
        divisions = 2
        while True:
            current = self._rule(function, divisions)
            errors = np.abs(current - previous)
            points = self.bins[0] * self.bins[1] * (2 * divisions) ** 2
            done = errors.sum() <= self.tolerance * np.abs(current).sum()
            if done or 4 * points > self.max_points:
                return current, errors
            previous, divisions = current, 2 * divisions

    def _rule(self, function: Callable[[Array], Array], divisions: int) -> Array:
        """Two-point Gauss rule per dimension on `divisions` parts of each bin."""
        n_theta, n_phi = self.bins
        offsets = np.array([0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0)])
        theta = (
            (np.arange(n_theta * divisions)[:, None] + offsets) * (0.5 * np.pi / n_theta / divisions)
        ).ravel()
        phi = ((np.arange(n_phi * divisions)[:, None] + offsets) * (2.0 * np.pi / n_phi / divisions)).ravel()
        weight = np.sin(theta) * (np.pi**2 / (n_theta * n_phi * (2 * divisions) ** 2))
        values = function(direction(theta[:, None], phi).reshape(-1, 3))
        values = values.reshape(n_theta, 2 * divisions, n_phi, 2 * divisions, *values.shape[1:])
        return np.einsum("taps...,ta->tp...", values, weight.reshape(n_theta, -1))
