r"""Outgoing directions by the tilts of their half vector: the cells of anisotropic tables.

A facet of slopes s = (sx, sy) sends light from i to o only if its normal is their half vector, that is if

    s = (i + o)_xy / (i + o)_z,

so whatever a surface's slopes are, narrow along one axis and wide along the other, its highlight stands still in s
while i moves. From one i, the directions above the horizon fill the disk |s - t|^2 < 1 + |t|^2, t = i_xy / i_z. The
horizon would cut through cells, through others for every i, so it is sent to infinity, one axis after the other. Along
the axis a on which slopes are narrower the disk spans |a - t_a| < L, L^2 = 1 + |t|^2, and at each slope there
|b - t_b| < L', L'^2 = L^2 - (a - t_a)^2, along the other. Either interval is stretched by

    w = t + (s - t) sqrt(1 + c / (L^2 - (s - t)^2)) + d,

which, with c = 4 delta^2, is s + delta^2 / (distance to the horizon) but for the constant d. So slopes that are a few
delta from the horizon stay about where they are, and a highlight stays narrow along a whatever the horizon does along
b. delta is a quarter of the surface's width of slopes on that axis, with a part of the distance from slope 0 to the
horizon where that is far, so that no cell is nearly empty; d undoes what the latter shifts slope 0 by. Cells are
rectangles of the tilts x = atan(w_x), y = atan(w_y), radians in (-pi/2, pi/2): every direction above the horizon is in
one cell, and every point of the square is a direction above the horizon. The inverse solves a quadratic equation.

With the derivatives of both w the measures are dw = w_a' w_b' ds, ds = domega_h / cos^3 theta_h,
domega_h = domega_o / (4 o.h).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gonio.core.jit import kernel

_LEAST = 1e-4  # cosine that stands in for 0: at grazing incidence the slopes are infinite
_TINY = 1e-30
_CORE, _REACH = 0.82, 3.2  # that part of the cells lies evenly within so many widths of slope
_STEEPEST = 10.0  # slope at which the last cell begins
_LEAST_WIDTH, _MOST_WIDTH = 1e-3, 1.0
_SOFT = 0.25  # delta in widths of slope
_FAR = 0.3  # and in distances to the horizon


@kernel(allocates=False)
def _stretch(width, centre, length2):
    """Constants c and d of the module's equation, along one axis; `length2` is L^2."""
    ratio = 1.0 - centre * centre / length2  # below 0 where slope 0 is beyond the horizon
    part = min(1.0, abs(ratio))
    c = 4.0 * (_SOFT * width) ** 2 + (_FAR * part) ** 2 * length2
    return c, centre * (math.sqrt(1.0 + _FAR * _FAR * max(ratio, 0.0)) - 1.0)


@kernel(allocates=False)
def _outward(slope, left, width, centre, length2):
    """Stretched slope w, and dw/ds; `left` is L^2 - (s - t)^2."""
    c, d = _stretch(width, centre, length2)
    left = max(left, _TINY)
    from_centre = slope - centre
    factor = math.sqrt(1.0 + c / left)
    return centre + from_centre * factor + d, factor * (
        1.0 + from_centre * from_centre * (c / left) / (left + c)
    )


@kernel(allocates=False)
def _inward(w, width, centre, length2):
    """The slope, and L^2 - (s - t)^2."""
    c, d = _stretch(width, centre, length2)
    far = w - d - centre
    b = 0.5 * (c + far * far - length2)
    root = math.sqrt(b * b + c * length2)
    # without cancellation on either side
    left = c * length2 / (root + b) if b > 0.0 else root - b
    return centre + math.copysign(math.sqrt(max(0.0, length2 - left)), far), max(left, _TINY)


@kernel(allocates=False)
def to_tilts(wi, wo, widths):
    """Tilts of the direction `wo`, seen with light from `wi`, and their density against solid angle.

    Parameters
    ----------
    wi, wo : direction
        Above the horizon.
    widths : tuple of float
        Of slopes along x and y, Beckmann's alpha; see `slope_widths`.

    Returns
    -------
    x, y : float
        Radians.
    density : float
        dx dy / domega_o, 1/sr.
    """
    zi, zo = max(wi[2], _LEAST), max(wo[2], _TINY)
    sx, sy = (wi[0] + wo[0]) / (zi + zo), (wi[1] + wo[1]) / (zi + zo)
    tx, ty = wi[0] / zi, wi[1] / zi
    secant2 = 1.0 + sx * sx + sy * sy  # of theta_h
    disk = 1.0 + tx * tx + ty * ty
    left = zo / zi * secant2  # to the horizon, from both axes: 1 + 2 s.t - |s|^2
    if widths[0] < widths[1]:
        span = max(1.0 + ty * ty + 2.0 * sx * tx - sx * sx, left)
        wx, slope_x = _outward(sx, span, widths[0], tx, disk)
        wy, slope_y = _outward(sy, left, widths[1], ty, span)
    else:
        span = max(1.0 + tx * tx + 2.0 * sy * ty - sy * sy, left)
        wy, slope_y = _outward(sy, span, widths[1], ty, disk)
        wx, slope_x = _outward(sx, left, widths[0], tx, span)
    secant = math.sqrt(secant2)
    cosine = (wi[0] * sx + wi[1] * sy + zi) / secant  # i.h = o.h
    spread = (1.0 + wx * wx) * (1.0 + wy * wy)
    density = slope_x * slope_y * secant2 * secant / (4.0 * max(cosine, _LEAST) * spread)
    return math.atan(wx), math.atan(wy), density


@kernel(allocates=False)
def to_tilts_many(wi, wo, widths, tilts):
    """`to_tilts` for arrays of directions, shape (N, 3), into `tilts`, shape (N, 3)."""
    for n in range(len(wi)):
        tilts[n, 0], tilts[n, 1], tilts[n, 2] = to_tilts(
            (wi[n, 0], wi[n, 1], wi[n, 2]), (wo[n, 0], wo[n, 1], wo[n, 2]), widths
        )


@kernel(allocates=False)
def from_tilts(wi, x, y, widths):
    """The direction `wo` above the horizon that has these tilts."""
    zi = max(wi[2], _LEAST)
    tx, ty = wi[0] / zi, wi[1] / zi
    disk = 1.0 + tx * tx + ty * ty
    # tan(pi/2) is large, not infinite
    wx, wy = math.tan(x), math.tan(y)
    if widths[0] < widths[1]:
        sx, span = _inward(wx, widths[0], tx, disk)
        sy, left = _inward(wy, widths[1], ty, span)
    else:
        sy, span = _inward(wy, widths[1], ty, disk)
        sx, left = _inward(wx, widths[0], tx, span)
    secant2 = 1.0 + sx * sx + sy * sy
    double = 2.0 * (wi[0] * sx + wi[1] * sy + zi) / secant2
    ox, oy, oz = double * sx - wi[0], double * sy - wi[1], zi * left / secant2
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
    core = _core_cells(cells)
    tail = (cells - core) // 2
    inner = np.linspace(-reach, reach, core + 1)
    outer = reach * (_STEEPEST / reach) ** (np.arange(1, tail) / max(tail - 1, 1))
    outer = np.arctan(np.append(outer, np.inf))
    return np.concatenate([-outer[::-1], np.arctan(inner), outer])


def slope_widths(x_edges: NDArray[np.float64], y_edges: NDArray[np.float64]) -> tuple[float, float]:
    """Widths of slopes along x and y that edges are made for, from the cells in their middle.

    Of the edges of `tilt_edges`, the width they were asked for.
    """
    x, y = (_slope_width(edges) for edges in (x_edges, y_edges))
    return x, y


def _slope_width(edges: NDArray[np.float64]) -> float:
    cells = len(edges) - 1
    low, high = np.tan(edges[(cells - 1) // 2 : (cells - 1) // 2 + 2])
    return float(min(max(0.5 * (high - low) * _core_cells(cells) / _REACH, _LEAST_WIDTH), _MOST_WIDTH))


def _core_cells(cells: int) -> int:
    """Those that are evenly spaced in slope."""
    core = int(_CORE * cells)
    return core - (cells - core) % 2


def tilt_measures(
    wi: NDArray[np.float64],
    x_edges: NDArray[np.float64],
    y_edges: NDArray[np.float64],
    widths: tuple[float, float] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Directions to the middles of cells, shape (X, Y, 3), and projected solid angles, sr, shape (X, Y).

    The latter by 4 x 4 points in each cell. The widths are those of the edges, unless these cut the cells of others.
    """
    wo = np.empty((len(x_edges) - 1, len(y_edges) - 1, 3))
    areas = np.empty(wo.shape[:2])
    _measure(
        tuple(np.asarray(wi, float).tolist()),
        x_edges,
        y_edges,
        widths or slope_widths(x_edges, y_edges),
        wo,
        areas,
    )
    return wo, areas


@kernel(allocates=False)
def _measure(wi, x_edges, y_edges, widths, wo, areas):
    for j in range(areas.shape[0]):
        width = x_edges[j + 1] - x_edges[j]
        for k in range(areas.shape[1]):
            height = y_edges[k + 1] - y_edges[k]
            total = 0.0
            for point in range(16):
                x = x_edges[j] + (point // 4 + 0.5) / 4.0 * width
                y = y_edges[k] + (point % 4 + 0.5) / 4.0 * height
                out = from_tilts(wi, x, y, widths)
                _, _, density = to_tilts(wi, out, widths)
                total += out[2] / density
            areas[j, k] = width * height * total / 16.0
            middle = from_tilts(wi, x_edges[j] + 0.5 * width, y_edges[k] + 0.5 * height, widths)
            wo[j, k, 0], wo[j, k, 1], wo[j, k, 2] = middle
