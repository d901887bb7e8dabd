r"""Outgoing directions by the tilts of their half vector: the cells of anisotropic tables.

A facet of slopes s = (sx, sy) sends light from i to o only if its normal is their half vector, that is if

    s = (i + o)_xy / (i + o)_z,

so whatever a surface's slopes are, narrow along one axis and wide along the other, its highlight stands still in s
while i moves. From one i, the directions above the horizon fill the disk |s|^2 - 2 s.t < 1, t = i_xy / i_z: along
the unit vector e it ends at r(e) = e.t + sqrt(1 + (e.t)^2). The horizon would cut through cells, through others
for every i. It is therefore sent to infinity,

    w = s / (1 - (|s| / r)^4)^(1/4),

which leaves slopes well inside the disk where they are (0.4 % at a third of the way). Cells are rectangles of
the tilts x = atan(w_x), y = atan(w_y), radians in (-pi/2, pi/2): every direction above the horizon is in one cell,
and every point of the square is a direction above the horizon.

With k = |w| / |s| the measures are dw = k^6 ds, ds = domega_h / cos^3 theta_h, domega_h = domega_o / (4 o.h).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gonio.core.jit import kernel

_LEAST = 1e-9  # cosine that stands in for 0: at grazing incidence the slopes are infinite
_NEAREST = 1e-12  # the horizon is met no closer than so, in units of the fourth power above
_CORE, _REACH = 0.82, 3.2  # that part of the cells lies evenly within so many widths of slope
_STEEPEST = 10.0  # slope at which the last cell begins
_LEAST_WIDTH, _MOST_WIDTH = 1e-3, 1.0


@kernel(allocates=False)
def _reach(wi, x, y):
    """Slope r at which the horizon stands along the unit vector (x, y)."""
    z = max(wi[2], _LEAST)
    along = wi[0] * x + wi[1] * y
    root = math.sqrt(along * along + z * z)
    # without cancellation on either side
    return (root + along) / z if along > 0.0 else z / (root - along)


@kernel(allocates=False)
def to_tilts(wi, wo):
    """Tilts of the direction `wo`, seen with light from `wi`, and their density against solid angle.

    Parameters
    ----------
    wi, wo : direction
        Above the horizon.

    Returns
    -------
    x, y : float
        Radians.
    density : float
        dx dy / domega_o, 1/sr.
    """
    z = max(wi[2], _LEAST) + max(wo[2], _LEAST)
    sx, sy = (wi[0] + wo[0]) / z, (wi[1] + wo[1]) / z
    square = sx * sx + sy * sy
    k4 = 1.0
    if square > 0.0:
        scale = 1.0 / math.sqrt(square)
        part = square / _reach(wi, sx * scale, sy * scale) ** 2
        k4 = 1.0 / max(1.0 - part * part, _NEAREST)
    k2 = math.sqrt(k4)
    k = math.sqrt(k2)
    wx, wy = k * sx, k * sy
    secant = math.sqrt(1.0 + square)  # of theta_h
    cosine = (wi[0] * sx + wi[1] * sy + wi[2]) / secant  # i.h = o.h
    spread = (1.0 + wx * wx) * (1.0 + wy * wy)
    density = k4 * k2 * secant * secant * secant / (4.0 * max(cosine, _LEAST) * spread)
    return math.atan(wx), math.atan(wy), density


@kernel(allocates=False)
def to_tilts_many(wi, wo, tilts):
    """`to_tilts` for arrays of directions, shape (N, 3), into `tilts`, shape (N, 3)."""
    for n in range(len(wi)):
        tilts[n, 0], tilts[n, 1], tilts[n, 2] = to_tilts(
            (wi[n, 0], wi[n, 1], wi[n, 2]), (wo[n, 0], wo[n, 1], wo[n, 2])
        )


@kernel(allocates=False)
def from_tilts(wi, x, y):
    """The direction `wo` above the horizon that has these tilts."""
    # tan(pi/2) is large, not infinite
    wx, wy = math.tan(x), math.tan(y)
    sx, sy = wx, wy
    square = wx * wx + wy * wy
    if square > 0.0:
        scale = 1.0 / math.sqrt(square)
        reach = _reach(wi, wx * scale, wy * scale)
        part = square / (reach * reach)
        # |s| = |w| / (1 + part^2)^(1/4), also where part^2 is beyond all numbers
        length = 1.0 / (scale * math.sqrt(math.sqrt(1.0 + part * part))) if part < 1e8 else reach
        sx, sy = length * scale * wx, length * scale * wy
    double = 2.0 * (wi[0] * sx + wi[1] * sy + wi[2]) / (1.0 + sx * sx + sy * sy)
    ox, oy, oz = double * sx - wi[0], double * sy - wi[1], max(double - wi[2], _LEAST)
    scale = 1.0 / math.sqrt(ox * ox + oy * oy + oz * oz)
    return scale * ox, scale * oy, scale * oz


def tilt_edges(width: float, cells: int) -> NDArray[np.float64]:
    """Edges of cells along one axis, for a surface whose slopes along it have this width.

    Parameters
    ----------
    width : float
        sqrt(2) times the rms slope, Beckmann's alpha of that axis; taken as 0.001 to 1.
    cells : int
        At least 8; where odd, slope 0 is in the middle of one.

    Returns
    -------
    ndarray, shape (cells + 1,)
        Radians, from -pi/2 to pi/2: four fifths of the cells evenly spaced in slope where most facets are, the
        others in geometric steps beyond.
    """
    reach = _REACH * min(max(width, _LEAST_WIDTH), _MOST_WIDTH)
    core = int(_CORE * cells)
    core -= (cells - core) % 2
    tail = (cells - core) // 2
    inner = np.linspace(-reach, reach, core + 1)
    outer = reach * (_STEEPEST / reach) ** (np.arange(1, tail) / max(tail - 1, 1))
    outer = np.arctan(np.append(outer, np.inf))
    return np.concatenate([-outer[::-1], np.arctan(inner), outer])


def tilt_measures(
    wi: NDArray[np.float64], x_edges: NDArray[np.float64], y_edges: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Directions to the middles of cells, shape (X, Y, 3), and projected solid angles, sr, shape (X, Y).

    The latter by 4 x 4 points in each cell.
    """
    wo = np.empty((len(x_edges) - 1, len(y_edges) - 1, 3))
    areas = np.empty(wo.shape[:2])
    _measure((float(wi[0]), float(wi[1]), float(wi[2])), x_edges, y_edges, wo, areas)
    return wo, areas


@kernel(allocates=False)
def _measure(wi, x_edges, y_edges, wo, areas):
    for j in range(areas.shape[0]):
        width = x_edges[j + 1] - x_edges[j]
        for k in range(areas.shape[1]):
            height = y_edges[k + 1] - y_edges[k]
            total = 0.0
            for point in range(16):
                x = x_edges[j] + (point // 4 + 0.5) / 4.0 * width
                y = y_edges[k] + (point % 4 + 0.5) / 4.0 * height
                out = from_tilts(wi, x, y)
                _, _, density = to_tilts(wi, out)
                total += out[2] / density
            areas[j, k] = width * height * total / 16.0
            middle = from_tilts(wi, x_edges[j] + 0.5 * width, y_edges[k] + 0.5 * height)
            wo[j, k, 0], wo[j, k, 1], wo[j, k, 2] = middle
