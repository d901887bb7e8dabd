"""Next-event estimates on a Lambertian surface: light is joined to lights and detectors wherever it meets a facet.

What leaves a Lambertian facet does not remember where it came from. With the albedo rho, the cosines at facets a
and V, the visibility of a direction, the BRDF is (Veach 1997, "Robust Monte Carlo methods", section 8.2, as a form
in the light and the detector)

    f(i, o) = 1 / (pi A cos_i cos_o)  integral over the surface of  a_i V_i  sum_k rho^k  K^(k-1) [a_o V_o],

A the area of the plane and K the transport from facet to facet, a random walk with Lambert's law. So one point x0
of the surface and one walk from it, x1, x2 ..., estimate f for all pairs of a light and a detector at once: with
shadow rays to I lights from x0, and to O detectors from every point of the walk, I * O pairs cost I + O rays and a
product of two vectors. Every pair falls in a cell chosen beforehand, and every cell is met equally often: lights
and detectors stand a whole number of sectors apart, each moved at random within its own cell. Paths, traced as the
analog estimator does, give the energies of rows and the ledger.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import direction
from gonio.core.embree import PACKET_WIDTH
from gonio.core.parallel import for_each
from gonio.trace.lambert_looks import look_around, pair
from gonio.trace.scene import TraceScene
from microgeometry.tile import HeightField, Tile

Array = NDArray[np.float64]

# Measured, merit over analog's in 1-degree tables of V-grooves and of a Gaussian surface of alpha 0.5, with lights and
# detectors as below: 2 and 12, 114 and 1700; 12 and 12, 250 and 3400; 30 and 12, 90 and 3200. Points in the order of
# the surface, so that a packet's are neighbours: 0.6 to 0.9 of the merit.
_TURNS = 12  # lights of a row in a group of points
_BESIDE = 12  # detectors of a ring in a group
_STREAM = 0x6E657874  # of the random numbers that place points and directions
_SHARE = 4.0  # of the time, looks to paths
_RAYS_PER_PATH, _PAIRS_PER_PATH = 8.0, 3000.0  # that take as long (measured)
_UNITS = 8
_MEMORY = 8_000_000  # numbers kept at a time


class LambertLooks:
    """Shadow rays to lights and detectors from points of one opaque Lambertian surface.

    Parameters
    ----------
    albedo : ndarray, shape (S,)
    to_channels : ndarray or None, shape (C, S)
        As in `gonio.trace.tracer.Tracer`.
    orders : int
        Numbers of bounces told apart.
    theta_i : ndarray, shape (I,)
    theta_i_edges : ndarray or None, shape (I + 1,)
        Rows, as in `gonio.table.table.Table`.
    theta_edges : ndarray, shape (R + 1,)
        Rings of detectors, radians.
    sectors : int
        Cells along delta phi.
    seed : int
    """

    def __init__(
        self,
        albedo: Array,
        to_channels: Array | None,
        orders: int,
        theta_i: Array,
        theta_i_edges: Array | None,
        theta_edges: Array,
        sectors: int,
        seed: int,
    ) -> None:
        self._albedo = albedo
        grey = bool(np.all(albedo == albedo[0]))  # then one weight does for all channels
        mix = np.eye(len(albedo)) if to_channels is None else to_channels
        self._to_basis = np.eye(1, len(albedo)) if grey else np.ascontiguousarray(mix)
        self._mix = mix.sum(axis=1, keepdims=True) if grey else np.eye(len(mix))
        self._orders = orders
        self._theta_i, self._theta_i_edges, self._theta_edges = theta_i, theta_i_edges, theta_edges
        self._sectors = sectors
        self._seed = seed
        self._turns = _largest_divisor(2 * sectors, _TURNS)
        self._turn = 2 * sectors // self._turns
        self._beside = _largest_divisor(self._turn, _BESIDE)
        self._cycle = self._turn // self._beside  # groups that meet every cell once a turn
        lights, detectors = len(theta_i) * self._turns, (len(theta_edges) - 1) * self._beside
        columns = orders * len(self._to_basis)
        self._paths_per_point = (
            lights + detectors
        ) / _RAYS_PER_PATH + lights * detectors * columns / _PAIRS_PER_PATH

    def measure(
        self,
        tile: Tile,
        scene: TraceScene,
        batch: int,
        passes: NDArray[np.int64],
        paths_per_pass: int,
        cells: Array,
        threads: int,
    ) -> int:
        """Add a realisation's light to the cells of a batch.

        Parameters
        ----------
        tile : Tile
        scene : TraceScene
            Of this tile.
        batch : int
        passes : ndarray of int, shape (I,)
            Of each row; rows without any get nothing.
        paths_per_pass : int
        cells : ndarray
            As in `gonio.trace.tally.Tally.accumulators`: sums as of so many paths.
        threads : int
            The sums do not depend on it.

        Returns
        -------
        int
            Rays cast.
        """
        wanted = _SHARE * int(passes.sum()) * paths_per_pass / self._paths_per_point
        rounds = max(1, round(wanted / (self._cycle * 64)))
        n_groups = self._cycle * rounds
        per_group = PACKET_WIDTH * max(1, round(wanted / (n_groups * PACKET_WIDTH)))
        n_points = n_groups * per_group
        random = np.random.Generator(np.random.Philox(np.random.SeedSequence((self._seed, batch, _STREAM))))
        place, normal, area = _points(tile, scene, n_points, random)
        # every group has points all over the surface
        place, normal = (
            np.ascontiguousarray(a.reshape(per_group, n_groups, 3).swapaxes(0, 1)).reshape(-1, 3)
            for a in (place, normal)
        )
        lattice = (np.arange(n_groups, dtype=np.int64) % self._cycle) * self._beside
        random.shuffle(lattice)
        packets = n_points // PACKET_WIDTH
        turn = 2.0 * math.pi * (random.permutation(packets) + random.random(packets)) / packets
        azimuth = np.column_stack([np.cos(turn), np.sin(turn)])
        to_light, to_detector = self._directions(lattice, random)
        # a cell is met by every cycle of groups twice, as it is folded
        met = 2 * rounds * per_group
        by_row = area / math.pi * passes * paths_per_pass
        by_ring = np.diff(np.sin(self._theta_edges) ** 2) * math.pi / self._sectors / met
        slots = np.cumsum(passes) - passes
        columns = self._orders * len(self._to_basis)
        block = max(1, _MEMORY // (per_group * columns * to_detector.shape[1]))
        rays = 0
        for first in range(0, n_groups, block):
            groups = range(first, min(first + block, n_groups))
            lit = np.empty((len(groups), per_group, to_light.shape[1]), np.float32)
            seen = np.empty((len(groups), per_group, columns, to_detector.shape[1]), np.float32)

            def look(number: int, groups: range = groups, lit: Any = lit, seen: Any = seen) -> int:
                mine = slice(groups[number] * per_group, (groups[number] + 1) * per_group)
                return look_around(
                    scene.embree, scene.box, False, place[mine], normal[mine], self._albedo, self._to_basis,
                    self._orders, to_light[groups[number]], to_detector[groups[number]],
                    azimuth[mine.start // PACKET_WIDTH : mine.stop // PACKET_WIDTH], self._seed, batch, mine.start,
                    lit[number], seen[number],
                )  # fmt: skip

            def join(unit: int, groups: range = groups, lit: Any = lit, seen: Any = seen) -> None:
                mine = np.arange(unit, len(passes), _UNITS)
                mine = mine[passes[mine] > 0]
                pair(
                    lit, seen, lattice[groups.start : groups.stop], self._turn, self._sectors, by_row, by_ring,
                    self._mix, mine, slots, cells[:, 0],
                )  # fmt: skip

            rays += sum(for_each(look, len(groups), threads))
            for_each(join, min(_UNITS, len(passes)), threads)
        return rays

    def _directions(
        self, lattice: NDArray[np.int64], random: np.random.Generator
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Lights and detectors of every group, uniform in projected solid angle within their cells."""
        groups, rows, rings = len(lattice), len(self._theta_i), len(self._theta_edges) - 1
        sector = math.pi / self._sectors
        shape = groups, rows, self._turns
        if self._theta_i_edges is None:
            theta = np.broadcast_to(self._theta_i[:, None], shape)
        else:
            theta = _within(self._theta_i_edges, random.random(shape))
        light = direction(theta, sector * self._turn * np.arange(self._turns))
        shape = groups, rings, self._beside
        theta = _within(self._theta_edges, random.random(shape))
        number = lattice[:, None, None] + np.arange(self._beside) + random.random(shape)
        detector = direction(theta, sector * number)
        return (
            light.reshape(groups, -1, 3).astype(np.float32),
            detector.reshape(groups, -1, 3).astype(np.float32),
        )


def _largest_divisor(n: int, most: int) -> int:
    return max(d for d in range(1, most + 1) if n % d == 0)


def _within(edges: Array, u: Array) -> Array:
    """Polar angles of directions uniform in projected solid angle between two edges each; `u` of shape (..., n, k)."""
    square = np.sin(edges) ** 2
    return np.arcsin(np.sqrt(square[:-1, None] + u * np.diff(square)[:, None]))


def _points(
    tile: Tile, scene: TraceScene, count: int, random: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.float32], float]:
    """Points just above the surface, one in each stratum of equal area, in units of the unit tile.

    Returns
    -------
    place, normal : ndarray of float32, shape (count, 3)
    area : float
        Of the surface, per area of the plane.
    """
    normals, areas = tile.facets()
    total = areas.sum()
    if isinstance(tile, HeightField):  # both triangles of a quad beside each other
        areas = areas.reshape(2, -1).T.ravel()
    upto = np.cumsum(areas)
    chosen = np.searchsorted(upto, upto[-1] * (np.arange(count) + random.random(count)) / count, side="right")
    chosen = np.minimum(chosen, len(areas) - 1)
    scale = 1.0 / scene.unit
    if isinstance(tile, HeightField):
        corners = _corners(tile, chosen)
        normal = normals.reshape(2, -1, 3)[chosen % 2, chosen // 2]
        origin = 0.0, 0.0
    else:
        corners, normal, origin = tile.vertices[tile.faces[chosen]], normals[chosen], tile.origin
    corners = (corners - np.array([*origin, scene.centre])) * scale
    u, v = random.random((2, count, 1))
    u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
    place = corners[:, 0] + u * (corners[:, 1] - corners[:, 0]) + v * (corners[:, 2] - corners[:, 0])
    place += normal * float(scene.box.lift)
    plane = tile.size[0] * tile.size[1]
    return place.astype(np.float32), normal.astype(np.float32), float(total / plane)


def _corners(tile: HeightField, chosen: NDArray[np.intp]) -> Array:
    """Corners of triangles of a height field, metres; number 2 q + h is triangle h of quad q."""
    nx, ny = tile.heights.shape
    quad, half = np.divmod(chosen, 2)
    i, j = np.divmod(quad, ny)
    offsets = np.array([[(0, 0), (1, 0), (0, 1)], [(1, 1), (0, 1), (1, 0)]])[half]
    x, y = i[:, None] + offsets[..., 0], j[:, None] + offsets[..., 1]
    z = tile.heights[x % nx, y % ny]
    return np.stack([x * (tile.size[0] / nx), y * (tile.size[1] / ny), z], axis=-1)
