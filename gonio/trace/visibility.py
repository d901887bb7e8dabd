"""Facets of a height field by tilt, and which of them see two directions: kernels of `gonio.trace.half_vector`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import combine, unit
from gonio.core.embree import DIR_X, DIR_Y, DIR_Z, ORG_X, ORG_Y, ORG_Z, T_FAR, T_NEAR, new_ray, occluded1
from gonio.core.jit import kernel
from gonio.core.masking import projected_area
from gonio.core.philox import uniforms
from gonio.trace.transport import MAX_SEGMENTS

_PURPOSE = 1 << 24  # word of the random numbers' counter that no path's bounce reaches
_LEAST_CHANCE = 0.05


class Relief(NamedTuple):
    """Heights of a periodic tile as Embree has them."""

    heights: NDArray[np.float64]
    """(nx, ny), in the unit tile's unit."""
    step_x: float
    step_y: float
    """Distance of the samples, same unit."""
    mean: float
    rms: float
    """Of the heights."""


class Nodes(NamedTuple):
    """Pairs of directions about a facet's normal at which visibility is measured."""

    tilt: NDArray[np.float64]
    """(A,) theta_h, radians, increasing from 0."""
    window: NDArray[np.float64]
    """(A,) a facet stands for a tilt from which its own differs by less, radians."""
    opening: NDArray[np.float64]
    """(B,) theta_d over the largest at which both directions are above the horizon; increasing from 0."""
    turn: NDArray[np.float64]
    """(P,) phi_d, radians, from 0 to pi/2."""
    every: NDArray[np.int64]
    """(B,) one round of picks in so many looks at this opening."""
    alpha: float
    """Beckmann roughness of the visibility that looks are compared with."""


@kernel(allocates=False)
def _inverse_smith(alpha, i, o):
    """1 + Lambda_i + Lambda_o."""
    p_i = projected_area(alpha, i[2], math.sqrt(i[0] * i[0] + i[1] * i[1]))
    p_o = projected_area(alpha, o[2], math.sqrt(o[0] * o[0] + o[1] * o[1]))
    return p_i / i[2] + p_o / o[2] - 1.0


@kernel(allocates=False)
def measure_tilts(relief, first, last, step, tilts, areas, windows_low, windows_high, members, window_areas):
    """Tilt of every facet in some columns of quads, and area by tilt.

    Parameters
    ----------
    relief : Relief
    first, last : int
        Columns, along x: first ... last - 1.
    step : float
        Width of the bins of `areas`, radians.
    tilts : ndarray of float32, shape (nx ny, 2)
        Set to the facets' tilts; the two of a quad stand together.
    areas : ndarray, shape (N,)
        Area is added, in units of a facet's projected area.
    windows_low, windows_high : ndarray, shape (A,)
        Windows of tilt.
    members : ndarray of int64, shape (A,)
        Number of facets in each window is added.
    window_areas : ndarray, shape (A,)
        Their area is added.
    """
    ny = relief.heights.shape[1]
    steepest = areas.shape[0] - 1
    for i in range(first, last):
        for j in range(ny):
            for half in range(2):
                dx, dy = _slopes(relief, i, j, half)
                slope2 = dx * dx + dy * dy
                tilt = math.atan(math.sqrt(slope2))
                area = math.sqrt(1.0 + slope2)
                tilts[i * ny + j, half] = tilt
                areas[min(int(tilt / step), steepest)] += area
                for a in range(members.shape[0]):
                    if windows_low[a] <= tilts[i * ny + j, half] < windows_high[a]:
                        members[a] += 1
                        window_areas[a] += area


@kernel(inline=True, allocates=False)
def _slopes(relief, i, j, half):
    """Slopes along x and y of triangle (v0, v1, v3) or (v2, v3, v1) of quad (i, j)."""
    z = relief.heights
    nx, ny = z.shape
    i1 = i + 1 if i + 1 < nx else 0
    j1 = j + 1 if j + 1 < ny else 0
    if half == 0:
        return (z[i1, j] - z[i, j]) / relief.step_x, (z[i, j1] - z[i, j]) / relief.step_y
    return (z[i1, j1] - z[i, j1]) / relief.step_x, (z[i1, j1] - z[i1, j]) / relief.step_y


@kernel(allocates=False)
def _chance(below, inverse):
    """Chance to cast rays at all, so that near the horizon the summits get them: Russian roulette.

    Smith's visibility of a point with a fraction `below` of the surface below it is below^(1/G - 1). A quarter
    of the exponent (measured: half of it is worse than none) and a floor keep the survivors' weights small.
    """
    if inverse < 1.5:
        return 1.0
    if below <= 0.0:
        return _LEAST_CHANCE
    return max(_LEAST_CHANCE, math.exp(0.25 * (inverse - 1.0) * math.log(below)))


@kernel
def see_both(embree, box, relief, tilts, low, high, members, node, nodes, rounds, seed, batch, looks, seen):
    """Look from facets of one window of tilt into both directions of every pair of a node.

    Facets are picked evenly over the tile, each with a point of its own; a round of picks goes once through
    the turns phi_d.

    Parameters
    ----------
    embree : Handle
    box : Box
    relief : Relief
    tilts : ndarray
        From `measure_tilts`.
    low, high, members : float, float, int
        The window, and how many facets are in it (at least one).
    node : int
        Part of the random numbers' counter.
    nodes : Nodes
    rounds, seed, batch : int
    looks : ndarray of int64, shape (B, P)
        Number of looks is added.
    seen : ndarray, shape (B, P)
        For each look that was free both ways, 1 over Smith's visibility G of its pair of directions is added.

    Returns
    -------
    int
        Rays traced.
    """
    return _see_both(
        embree,
        box,
        relief,
        tilts,
        low,
        high,
        members,
        node,
        nodes,
        rounds,
        seed,
        batch,
        looks,
        seen,
        new_ray(),
    )


@kernel(allocates=False)
def _see_both(
    embree, box, relief, tilts, low, high, members, node, nodes, rounds, seed, batch, looks, seen, ray
):  # fmt: skip
    ny = relief.heights.shape[1]
    turns = nodes.turn.shape[0]
    picks = rounds * turns
    rays = 0
    facet = -1
    rank = -1
    for pick in range(picks):
        u, v, w, sign = uniforms(pick, node, _PURPOSE, 0, seed, batch)
        wanted = min(int((pick + u) * members / picks), members - 1)
        while rank < wanted:
            facet += 1
            if low <= tilts[facet >> 1, facet & 1] < high:
                rank += 1
        luck, _, _, _ = uniforms(pick, node, _PURPOSE, 1, seed, batch)
        quad, half = facet >> 1, facet & 1
        i, j = quad // ny, quad % ny
        dx, dy = _slopes(relief, i, j, half)
        n = unit((-dx, -dy, 1.0))
        p = _point(relief, i, j, half, dx, dy, v, w)
        below = (
            0.5 * math.erfc((relief.mean - p[2]) / (math.sqrt(2.0) * relief.rms)) if relief.rms > 0.0 else 1.0
        )
        p = (p[0] + box.lift * n[0], p[1] + box.lift * n[1], p[2] + box.lift * n[2])
        sine = math.sqrt(n[0] * n[0] + n[1] * n[1])
        across = (-n[1] / sine, n[0] / sine, 0.0) if sine > 0.0 else (0.0, 1.0, 0.0)
        along = (n[2] * across[1], -n[2] * across[0], -sine)  # where the tilt grows
        c = pick % turns
        cos_turn = math.cos(nodes.turn[c])
        sin_turn = math.sin(nodes.turn[c]) * (1.0 if sign < 0.5 else -1.0)
        tangent = combine(cos_turn, along, sin_turn, across, 0.0, n)
        # horizon: cos theta_h cos theta_d = sin theta_h sin theta_d cos phi_d
        widest = math.atan2(n[2], sine * cos_turn)
        for b in range(nodes.opening.shape[0]):
            if (pick // turns) % nodes.every[b] != 0:
                continue
            opening = nodes.opening[b] * widest
            # the direction that leans with the tilt is the lower one
            lower = combine(math.cos(opening), n, math.sin(opening), tangent, 0.0, n)
            upper = combine(math.cos(opening), n, -math.sin(opening), tangent, 0.0, n)
            looks[b, c] += 1
            inverse = _inverse_smith(nodes.alpha, lower, upper)
            chance = _chance(below, inverse)
            if luck >= chance:
                continue
            free, cast = _is_free(embree, box, ray, p, lower)
            rays += cast
            if free:
                free, cast = _is_free(embree, box, ray, p, upper)
                rays += cast
            if free:
                seen[b, c] += inverse / chance
    return rays


@kernel(inline=True, allocates=False)
def _point(relief, i, j, half, dx, dy, u, v):
    """Point of a facet from two uniform numbers."""
    if u + v > 1.0:
        u, v = 1.0 - u, 1.0 - v
    z = relief.heights
    nx, ny = z.shape
    if half == 0:
        height = z[i, j] + u * dx * relief.step_x + v * dy * relief.step_y
        return (i + u) * relief.step_x, (j + v) * relief.step_y, height
    corner = z[i + 1 if i + 1 < nx else 0, j + 1 if j + 1 < ny else 0]
    height = corner - u * dx * relief.step_x - v * dy * relief.step_y
    return (i + 1 - u) * relief.step_x, (j + 1 - v) * relief.step_y, height


@kernel(allocates=False)
def _is_free(embree, box, ray, p, d):
    """Whether a ray from `p` along `d` (upwards) leaves the periodic tile above; and the rays that took."""
    x, y, z = p
    if d[2] <= 0.0:  # a rounding below the horizon
        return False, 0
    for segment in range(MAX_SEGMENTS):
        distance = (box.top - z) / d[2]
        face = 0
        if d[0] != 0.0:
            to_x = ((box.width_x if d[0] > 0.0 else 0.0) - x) / d[0]
            if to_x < distance:
                distance, face = to_x, 1
        if d[1] != 0.0:
            to_y = ((box.width_y if d[1] > 0.0 else 0.0) - y) / d[1]
            if to_y < distance:
                distance, face = to_y, 2
        ray[ORG_X], ray[ORG_Y], ray[ORG_Z] = x, y, z
        ray[DIR_X], ray[DIR_Y], ray[DIR_Z] = d[0], d[1], d[2]
        ray[T_NEAR] = 0.0
        ray[T_FAR] = distance
        if distance > 0.0 and occluded1(embree, ray):
            return False, segment + 1
        if face == 0:
            return True, segment + 1
        x += d[0] * distance
        y += d[1] * distance
        z += d[2] * distance
        if face == 1:  # exactly onto the opposite face
            x = 0.0 if d[0] > 0.0 else float(box.width_x)
        else:
            y = 0.0 if d[1] > 0.0 else float(box.width_y)
    return False, MAX_SEGMENTS
