"""Lambertian cavities and sparse bosses, from closed forms and one integral equation."""

from __future__ import annotations

import math

import numpy as np


def pit_wall(depth):
    """Wall area of a spherical pit over that of its sphere; depth = height of the cap / radius."""
    return 0.5 * depth


def pit_albedo(depth, rho):
    """Share of the light that enters a Lambertian spherical pit's mouth and leaves it, at any incidence.

    A sphere exchanges light uniformly, whatever the points: of what any point of the wall reflects, s comes to the
    wall again.
    """
    s = pit_wall(depth)
    return rho * (1 - s) / (1 - rho * s)


def pit_order(depth, rho, k):
    """Of that, the light that leaves after exactly k bounces."""
    s = pit_wall(depth)
    return rho * (1 - s) * (rho * s) ** (k - 1)


def lambert_sphere(phase_angle):
    """Phase function of a white Lambertian sphere, mean 1 over the sphere of directions.

    Schoenberg (1929); phase angle between source and viewer, radians.
    """
    g = np.asarray(phase_angle, float)
    return 8 / (3 * math.pi) * (np.sin(g) + (math.pi - g) * np.cos(g))


def lambert_groove(slope, rho, theta=0.0, phi=0.0, orders=None, nodes=120):
    """Directional-hemispherical reflectance of an infinite Lambertian V-groove.

    The importance G(x) of a point at distance x from the valley, the share of what it reflects that leaves the
    groove, solves G = 1 - F + rho int K G with K(x, y) = sin^2 A x y / (2 (x^2 + y^2 - 2 x y cos A)^1.5),
    A = 180 degrees - 2 slope, and F = int K dy: Nystroem's method, crowded at the valley, where G is not smooth.
    Light is uniform along the groove whatever its direction, so only the angle in the cross-plane counts.

    Parameters
    ----------
    slope, theta, phi : float
        Radians; phi from the groove's cross-plane.
    rho : float
    orders : int, optional
        Instead of the sum, the light that leaves after exactly 1 ... orders bounces, as an array.
    """
    x, weight = gauss(0.0, 1.0, nodes)
    x, weight = x**3, 3 * x**2 * weight
    opening = math.pi - 2 * slope
    kernel = _exchange(x, x, opening) * weight
    importance = _escape(x, opening)
    if orders is None:
        importance = np.linalg.solve(np.eye(nodes) - rho * kernel, importance)
        return rho * _collect(
            slope,
            theta,
            phi,
            lambda at: _escape(at, opening) + rho * (_exchange(at, x, opening) * weight) @ importance,
        )
    result = [rho * _collect(slope, theta, phi, lambda at: _escape(at, opening))]
    for k in range(1, orders):
        arrived = importance

        def once_more(at, arrived=arrived):
            return (_exchange(at, x, opening) * weight) @ arrived

        result.append(rho ** (k + 1) * _collect(slope, theta, phi, once_more))
        importance = kernel @ importance
    return np.array(result)


def gauss(low, high, nodes):
    """Gauss-Legendre nodes and weights."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    return low + 0.5 * (high - low) * (x + 1), 0.5 * (high - low) * w


def _exchange(x, y, opening):
    x = x[:, None]
    return math.sin(opening) ** 2 * x * y / (2 * (x**2 + y**2 - 2 * x * y * math.cos(opening)) ** 1.5)


def _escape(x, opening):
    """1 - F: half of one plus the sine at which the other wall's edge is seen (Hottel's strings)."""
    return 0.5 * (1 + (x - math.cos(opening)) / np.sqrt(x**2 + 1 - 2 * x * math.cos(opening)))


def _collect(slope, theta, phi, importance):
    """Mean of a function of the wall over the light that arrives first."""
    c, s = math.cos(slope), math.sin(slope)
    tangent = math.tan(theta) * abs(math.cos(phi))
    total = 0.0
    for facing in (1, -1):  # the wall that faces the light, and the other
        irradiance = c + facing * s * tangent  # per unit of horizontal irradiance
        if irradiance <= 0:
            continue
        # if the other wall shades itself, its ridge shades the valley too
        dark = max(0.0, (s * tangent - c) / (s * tangent + c))
        # in the third root of the distance, as the nodes
        at, weight = gauss(dark ** (1 / 3), 1.0, 80)
        total += irradiance * (3 * at**2 * weight) @ importance(at**3)
    return total / (2 * c)
