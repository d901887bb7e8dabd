"""How fast a mean modulus bends: the curvature of least absolute deviations.

The second derivative of |d| is 2 delta(d), of a modulus rounded off over s it is k(d) = s^2/(d^2 + s^2)^(3/2).
Neither is seen in a value's own d: of a thousand values ten have one near 0, by chance. What counts is the mean
over the noise, twice the density of d at 0 (Koenker and Bassett 1978; estimated by kernels, Powell 1991), and
this is taken from the values of about the same model brightness, whose d scatter alike.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fitting.moments import QUADRATIC
from fitting.problem import Point, Problem

Array = NDArray[np.float64]

_GROUP = 100  # values in the brightest group: there few bear on much, and their scatter is not one
_GROWTH = 1.2  # from there to the next group
_SHARE = 0.02  # of all values: the largest group
_BANDWIDTH = 0.2  # of the scatter: the density comes out 2 % low, and of 500 values to 8 %
_NODES = np.polynomial.legendre.leggauss(16)


def expected(problem: Problem, point: Point) -> Problem:
    """The problem of an objective of a modulus, as the quadratic one that has its mean curvature at a point."""
    samples, objective = problem.samples, problem.objective
    model = problem.model(point)
    cos_i = samples.cos_i[:, None]
    g = np.maximum(model * cos_i, 0.0)
    d = np.log1p(np.maximum(samples.values * cos_i, 0.0)) - np.log1p(g)
    slope = cos_i / (1.0 + g)
    weights = 0.5 * objective.weights * slope**2 * mean_curvature(g, d, objective.scale)
    plain = replace(objective, difference=QUADRATIC, weights=weights)
    return Problem(problem.lobes, samples, plain, problem.cells.levels)


def mean_curvature(brightness: Array, d: Array, scale: float) -> Array:
    """Mean of the modulus' second derivative over the noise.

    Parameters
    ----------
    brightness : ndarray
        By which values are grouped.
    d : ndarray, same shape
        Differences.
    scale : float
        s, over which the modulus is rounded off.

    Returns
    -------
    ndarray, same shape
    """
    order = np.argsort(-brightness, axis=None)
    flat, out = d.ravel(), np.empty(d.size)
    first, size = 0, _GROUP
    while first < len(order):
        last = first + size if len(order) - first >= 2 * size else len(order)
        group = order[first:last]
        out[group] = _curvature(flat[group], scale)
        first, size = last, min(int(_GROWTH * size), max(_GROUP, int(_SHARE * len(order))))
    return out.reshape(d.shape)


def _curvature(d: Array, scale: float) -> float:
    """Mean of k over a density: that of the values themselves, smoothed where k is narrower than it is known."""
    bandwidth = _BANDWIDTH * float(np.median(np.abs(d))) / 0.6745
    if bandwidth <= scale:
        return float(np.mean(scale**2 / (d**2 + scale**2) ** 1.5))
    y, weight = _NODES  # of y = d/sqrt(d^2 + s^2), by which k(d) dd = dy
    at = scale * y / np.sqrt(1.0 - y**2)
    density = [np.mean(np.exp(-0.5 * ((d - a) / bandwidth) ** 2)) for a in at]
    return float(weight @ density) / (bandwidth * np.sqrt(2.0 * np.pi))
