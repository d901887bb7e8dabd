"""The horizon of a height field: how steeply a path must climb to be free of it for good.

Most paths leave after one bounce, and a ray traced only to find nothing costs as much as one that hits. So each block
of the tile knows, for each of 16 sectors of azimuth, a slope above which nothing lies: a path that climbs
more steeply is out, whatever period of the surface it flies over. The bound is never below the true horizon:
tables are the same to the bit with and without it.

From a point of a block no ray climbs past facets that are less steep than it (all those of the block and its eight
neighbours), nor past what is lower than the ray is when it gets there (everything further off, in ever
larger windows, each as high as its highest point and as near as its nearest). The latter is a convex
function of the height the ray starts at: it is kept for the block's lowest and highest point, and the chord
between the two lies above it.
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.core.jit import kernel
from gonio.core.parallel import for_each

SECTORS = 16
_SAMPLES = 4  # of the height field along a block's side: fewer free more paths, but fill the caches
_REACH = 6  # windows of one size reach this many of their widths
_CHUNKS = 8
_STEEPEST = 16.0  # steeper horizons than this free nobody
_LEVELS = 65535
_UNIT = np.float32(_STEEPEST / _LEVELS)

_T1, _T3 = np.float32(math.tan(math.pi / 8)), np.float32(math.tan(3 * math.pi / 8))
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)

Field = NDArray[np.float32]


class Horizon(NamedTuple):
    """Bounds on the slope (height over distance) of everything in sight, by block and sector.

    Without blocks (`NO_HORIZON`), where there is none: the same type, so that kernels are compiled once.
    """

    slopes: NDArray[np.uint16]
    """Seen from the block's lowest and highest point, in units of 16/65535, the last meaning anything steeper;
    shape (mx, my, 16, 2). A block is one line of the cache."""
    heights: Field
    """Height of the lowest point, and 1 over the range of heights, shape (mx, my, 2)."""
    per_x: np.float32
    per_y: np.float32
    """Blocks per unit of length."""
    samples: Field
    """Of the height field, for `gonio.trace.start.fall`."""


NO_HORIZON = Horizon(
    np.empty((0, 0, SECTORS, 2), np.uint16),
    np.empty((0, 0, 2), np.float32),
    np.float32(0.0),
    np.float32(0.0),
    np.empty((0, 0), np.float32),
)


def find_horizon(z: NDArray[np.float64], width_x: float, width_y: float) -> Horizon:
    """Bound what is in sight of a periodic height field.

    Parameters
    ----------
    z : ndarray, shape (nx, ny)
        Heights of the samples.
    width_x, width_y : float
        Period, in the same unit.
    """
    nx, ny = z.shape
    samples = np.pad(z, ((0, 1), (0, 1)), mode="wrap").astype(np.float32)
    mx, my = max(1, nx // _SAMPLES), max(1, ny // _SAMPLES)
    z = np.pad(z.astype(np.float32), ((0, _SAMPLES), (0, _SAMPLES)), mode="wrap")
    high, low = np.empty((mx, my), np.float32), np.empty((mx, my), np.float32)
    along = np.empty((mx, my, SECTORS), np.float32)
    edges = np.arange(SECTORS // 2) * (2.0 * math.pi / SECTORS)
    per_step = (np.float32(nx / width_x), np.float32(ny / width_y))
    c, s = np.cos(edges).astype(np.float32), np.sin(edges).astype(np.float32)
    slices = [(chunk * mx // _CHUNKS, (chunk + 1) * mx // _CHUNKS) for chunk in range(_CHUNKS)]
    for_each(lambda k: _measure_blocks(z, nx, ny, *per_step, c, s, *slices[k], high, low, along), _CHUNKS)

    windows = _windows(mx, my, width_x / mx, width_y / my)
    near = _climb(along)
    slopes = np.empty((mx, my, SECTORS, 2), np.uint16)
    tops = _tops(high, windows.sizes)
    for_each(lambda k: _bound(tops, low, high, near, windows, *slices[k], slopes), _CHUNKS)
    return Horizon(
        slopes,
        np.stack([low, 1.0 / np.maximum(high - low, np.float32(1e-9))], axis=-1),
        np.float32(mx / width_x),
        np.float32(my / width_y),
        samples,
    )


@kernel(allocates=False)
def _measure_blocks(z, nx, ny, per_x, per_y, c, s, first, last, high, low, along):
    """Highest and lowest point of blocks, and the steepest slope of their facets along 16 directions.

    Quads that are only partly in a block count.
    """
    mx, my = high.shape
    for a in range(first, last):
        for b in range(my):
            top, bottom = -np.float32(np.inf), np.float32(np.inf)
            for k in range(SECTORS):
                along[a, b, k] = -np.inf
            for i in range(a * nx // mx, ((a + 1) * nx - 1) // mx + 1):
                for j in range(b * ny // my, ((b + 1) * ny - 1) // my + 1):
                    z00, z10, z01, z11 = z[i, j], z[i + 1, j], z[i, j + 1], z[i + 1, j + 1]
                    top = max(top, z00, z10, z01, z11)
                    bottom = min(bottom, z00, z10, z01, z11)
                    x0, y0, x1, y1 = (
                        (z10 - z00) * per_x,
                        (z01 - z00) * per_y,
                        (z11 - z01) * per_x,
                        (z11 - z10) * per_y,
                    )
                    for k in range(SECTORS // 2):
                        p, q = c[k] * x0 + s[k] * y0, c[k] * x1 + s[k] * y1
                        along[a, b, k] = max(along[a, b, k], p, q)
                        along[a, b, k + SECTORS // 2] = max(along[a, b, k + SECTORS // 2], -p, -q)
            high[a, b], low[a, b] = top, bottom


def _climb(along: Field) -> Field:
    """Slope of the steepest facet of each block and its neighbours, climbed in any direction of each sector.

    Parameters
    ----------
    along : ndarray, shape (mx, my, 16)
        The same of each block, along the directions between the sectors.

    Returns
    -------
    ndarray, shape (mx, 16, my)
        Sectors numbered as in `escapes`.
    """
    for axis in (0, 1):
        along = np.maximum(along, np.maximum(np.roll(along, 1, axis), np.roll(along, -1, axis)))
    # in between, a slope along both edges is exceeded by 1 / cos(half the sector) at most
    by_angle = np.maximum(along, np.roll(along, -1, 2)) / np.float32(math.cos(math.pi / SECTORS))
    quarter = np.arange(SECTORS // 4)
    order = (quarter, SECTORS - 1 - quarter, SECTORS // 2 - 1 - quarter, SECTORS // 2 + quarter)
    return np.ascontiguousarray(by_angle[..., np.concatenate(order)].transpose(0, 2, 1))


class _Windows(NamedTuple):
    """Everything but a block and its neighbours, in windows that grow with distance."""

    sizes: tuple[int, ...]
    """Blocks along a side, of each level."""
    place: NDArray[np.int64]
    """Level and first block relative to the one that looks, modulo the tile, shape (W, 3)."""
    inverse: Field
    """1 over the least distance between points of the two, shape (W,)."""
    first: NDArray[np.int64]
    """Of each window's sectors in `sectors`, shape (W + 1,)."""
    sectors: NDArray[np.int64]


@lru_cache(maxsize=8)
def _windows(mx: int, my: int, size_x: float, size_y: float) -> _Windows:
    sizes: list[int] = []
    place, inverse, first, sectors = [], [], [0], []
    side, covered = 1, 1
    while covered < max(mx, my):
        for i, j in product(range(-_REACH * side, _REACH * side + 1, side), repeat=2):
            if min(i, j) >= -covered and max(i, j) + side <= 1 + covered:
                continue
            x = (i - 1) * size_x, (i + side) * size_x  # from any point of the block to any of the window
            y = (j - 1) * size_y, (j + side) * size_y
            place.append((len(sizes), i % mx, j % my))
            inverse.append(1.0 / math.hypot(*(max(0.0, a, -b) for a, b in (x, y))))
            sectors += _sectors(x, y)
            first.append(len(sectors))
        sizes.append(side)
        covered = _REACH * side
        side *= 2
    sizes.append(max(mx, my))  # beyond a period: as high as anything
    place.append((len(sizes) - 1, 0, 0))
    inverse.append(1.0 / (covered * min(size_x, size_y)))
    sectors += range(SECTORS)
    first.append(len(sectors))
    return _Windows(
        tuple(sizes), np.array(place), np.array(inverse, np.float32), np.array(first), np.array(sectors)
    )


def _sectors(x: tuple[float, float], y: tuple[float, float]) -> list[int]:
    """Sectors that vectors of a rectangle point into; numbered as in `escapes`."""
    found = []
    for quadrant in range(4):
        (x0, x1), (y0, y1) = ((-b, -a) if quadrant & bit else (a, b) for (a, b), bit in ((x, 2), (y, 1)))
        if x1 < 0.0 or y1 < 0.0:
            continue
        angles = math.atan2(max(y0, 0.0), x1), math.atan2(y1, max(x0, 0.0))
        first, last = (angle * (SECTORS / 4) / (math.pi / 2) for angle in angles)
        for k in range(max(0, math.floor(first - 1e-6)), min(SECTORS // 4 - 1, math.floor(last + 1e-6)) + 1):
            found.append(quadrant * (SECTORS // 4) + k)
    return found


def _tops(high: Field, sizes: tuple[int, ...]) -> Field:
    """Highest point of the window that starts at each block, two periods each way, shape (L, 2 mx, 2 my)."""
    tops, size = [high], 1
    for wanted in sizes[1:]:
        while size < wanted:
            step = min(size, wanted - size)
            for axis in (0, 1):
                high = np.maximum(high, np.roll(high, -step, axis))
            size += step
        tops.append(high)
    return np.tile(np.stack(tops), (1, 2, 2))


@kernel
def _bound(tops, low, high, near, windows, first, last, slopes):
    """Set `slopes` of rows first ... last - 1 of blocks."""
    my = low.shape[1]
    bounds = np.empty((2, SECTORS, my), np.float32)
    for a in range(first, last):
        bounds[0] = near[a]
        bounds[1] = near[a]
        _raise(tops, low[a], high[a], windows, a, bounds)
        for b in range(my):
            for k in range(SECTORS):
                for point in range(2):
                    # rounding, of the heights and of where a ray starts, is far less than a unit
                    code = math.ceil(bounds[point, k, b] / _UNIT) + 1.0
                    slopes[a, b, k, point] = np.uint16(min(max(code, 1.0), float(_LEVELS)))


@kernel(allocates=False)
def _raise(tops, low, high, windows, a, bounds):
    """Raise the bounds of one row of blocks to what its windows hold."""
    my = low.shape[0]
    for w in range(windows.inverse.shape[0]):
        level, i, j = windows.place[w]
        top = tops[level, a + i, j : j + my]
        inverse = windows.inverse[w]
        for place in range(windows.first[w], windows.first[w + 1]):
            from_low, from_high = bounds[0, windows.sectors[place]], bounds[1, windows.sectors[place]]
            for b in range(my):
                slope = (top[b] - low[b]) * inverse
                from_low[b] = slope if slope > from_low[b] else from_low[b]
                slope = (top[b] - high[b]) * inverse
                from_high[b] = slope if slope > from_high[b] else from_high[b]


@kernel(inline=True, allocates=False)
def escapes(horizon, x, y, z, vx, vy, vz):
    """Whether a ray from a point of the surface will never meet it again."""
    i = min(max(np.int64(x * horizon.per_x), 0), horizon.slopes.shape[0] - 1)
    j = min(max(np.int64(y * horizon.per_y), 0), horizon.slopes.shape[1] - 1)
    ax, ay = abs(vx), abs(vy)
    sector = 8 * (vx < _ZERO) + 4 * (vy < _ZERO) + (ay > _T1 * ax) + (ay > ax) + (ay > _T3 * ax)
    low, high = horizon.slopes[i, j, sector, 0], horizon.slopes[i, j, sector, 1]
    part = min(max((z - horizon.heights[i, j, 0]) * horizon.heights[i, j, 1], _ZERO), _ONE)
    bound = _UNIT * (np.float32(low) + part * (np.float32(high) - np.float32(low)))
    return (low < _LEVELS) & (vz > _ZERO) & (vz * vz > bound * bound * (vx * vx + vy * vy))
