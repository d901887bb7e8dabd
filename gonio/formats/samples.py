"""Samples as a file has them: a list of directions with a value each, and how far a table is from it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.core.directions import direction
from gonio.table.table import Table

Array = NDArray[np.float64]

_SAME = 1e-4  # radians: angles of incidence closer than this are one


@dataclass(frozen=True)
class Samples:
    """N samples of a BRDF, or of what is transmitted, in C channels.

    Parameters
    ----------
    theta_i, theta_r : ndarray, shape (N,)
        Radians, from the normal; theta_r from that of the side which the light leaves.
    delta_phi : ndarray, shape (N,)
        Radians, any; 0 is retro-reflection.
    values : ndarray, shape (N, C)
        f in 1/sr; NaN where a channel has no sample there.
    """

    theta_i: Array
    theta_r: Array
    delta_phi: Array
    values: Array

    @classmethod
    def on_grid(cls, theta_i: ArrayLike, theta_r: ArrayLike, delta_phi: ArrayLike, values: Array) -> Samples:
        """Values of shape (..., C), and angles that broadcast to all axes but the last."""
        light, detector, phi = (
            np.broadcast_to(a, values.shape[:-1]).ravel() for a in (theta_i, theta_r, delta_phi)
        )
        return cls(light, detector, phi, values.reshape(-1, values.shape[-1]))

    @classmethod
    def joined(cls, pieces: Iterable[Samples]) -> Samples:
        """All samples of several."""
        columns = zip(*((p.theta_i, p.theta_r, p.delta_phi, p.values) for p in pieces), strict=True)
        return cls(*map(np.concatenate, columns))

    def where(self, known: NDArray[np.bool_]) -> Samples:
        """Some of the samples; shape (N,)."""
        return Samples(self.theta_i[known], self.theta_r[known], self.delta_phi[known], self.values[known])

    @property
    def folded(self) -> Array:
        """Delta phi in [0, pi]."""
        return np.abs((self.delta_phi + np.pi) % (2 * np.pi) - np.pi)


def sample_error(table: Table, samples: Samples) -> tuple[float, float, float]:
    """How far a table is from the samples it was made of, where they stand; all 0 where none is above the horizon.

    Returns
    -------
    median, worst : float
        Over angles of incidence: relative RMS difference of f, weighted with the cosine of theta_r and the solid
        angle that a sample stands for, an equal share of the table's cell that it is in.
    at_deg : float
        Where the worst is.
    """
    if len(samples.theta_i) == 0:
        return 0.0, 0.0, 0.0
    rings = _cell(table.theta_r_edges, samples.theta_r)
    sectors = _cell(table.delta_phi_edges, samples.folded)
    angles, row = np.unique(np.round(samples.theta_i / _SAME), return_inverse=True)
    places = np.ravel_multi_index((row, rings, sectors), (len(angles), *table.values.shape[1:3]))
    solid_angles = np.diff(-np.cos(table.theta_r_edges))[:, None] * np.diff(table.delta_phi_edges)
    weight = np.cos(samples.theta_r) * solid_angles[rings, sectors] / np.bincount(places)[places]
    wi, wo = direction(samples.theta_i), direction(samples.theta_r, samples.delta_phi)
    difference = table.eval(wi, wo) - samples.values
    squares, norms = (
        np.bincount(row, weight * np.nansum(x**2, axis=1)) for x in (difference, samples.values)
    )
    lit = norms > 0
    if not lit.any():
        return 0.0, 0.0, 0.0
    errors = np.sqrt(squares[lit] / norms[lit])
    worst = int(np.argmax(errors))
    return float(np.median(errors)), float(errors[worst]), float(np.degrees(angles[lit][worst] * _SAME))


def _cell(edges: Array, angles: Array) -> NDArray[np.int64]:
    return np.clip(np.searchsorted(edges, angles, "right") - 1, 0, len(edges) - 2)
