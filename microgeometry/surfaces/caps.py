"""Spherical caps on a plane: what pits and bosses share."""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, pi, sin, sqrt
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from microgeometry.errors import InputError
from microgeometry.keys import Keys
from microgeometry.surfaces.periodic import cut_to_tile
from microgeometry.tile import TriangleMesh

# Discs may come this close: a little below where they touch (pi / sqrt(12) = 0.9069 and pi / 4 = 0.7854);
# at random one after the other, a plane is jammed at 0.547, and slow to fill long before.
MAX_COVER = {"hexagonal": 0.9, "square": 0.78, "random": 0.45}
_N_RANDOM = 36
_RANDOM_GAP = 1.005  # least distance of two random discs, in diameters: no splinters of plane between them

Field = TypeVar("Field", bound="Caps")


@dataclass(frozen=True)
class Caps:
    """Keys, attributes and mesh of equal spherical caps on a plane.

    Keys of [surface]:

    - ``cover``: the fraction of the plane that is caps, 0.01 to 0.9 (hexagonal), 0.78 (square) or 0.45
      (random): they do not overlap.
    - ``depth`` (1): height of a cap / radius of its sphere; 1 is a hemisphere.
    - ``arrangement``: "hexagonal" (default), "square", or "random": centres drawn one after the other, each
      kept if it overlaps none before (36 caps to a tile).
    - ``radius`` (1) of the sphere in ``units`` ("um"). It changes no result in geometric optics.
    - ``segments`` (64): straight edges along the rim of a cap; the facets inside are of the same size.
    - ``plane``: the table of a material for the flat part, whose faces have the label 1; by default the caps'.

    A cap is a polyhedron with its vertices on the sphere, so its rim encloses (2 pi / segments)^2 / 6 less
    than the disc (0.16 % at 64). Its facets are drawn anew for each seed: on mirrors each is a delta, and
    only an average over many polyhedra is as smooth as the sphere.

    Attributes
    ----------
    cover, depth : float
    arrangement : str
    radius : float
        Of the sphere, metres.
    segments : int
    """

    cover: float
    depth: float
    arrangement: str
    radius: float
    segments: int

    @classmethod
    def read(cls: type[Field], keys: Keys) -> Field:
        """Build from the [surface] table. Raises `InputError`."""
        keys.allow("kind", "cover", "depth", "arrangement", "radius", "segments", "units")
        arrangement = keys.choice("arrangement", "hexagonal", MAX_COVER)
        return cls(
            cover=keys.number("cover", at_least=0.01, at_most=MAX_COVER[arrangement]),
            depth=keys.number("depth", 1.0, at_least=1e-3, at_most=1),
            arrangement=arrangement,
            radius=keys.number("radius", 1.0, above=0) * keys.metres_per_unit(),
            segments=keys.integer("segments", 64, at_least=12, at_most=1024),
        )

    def mesh(self, seed: int, sign: int) -> TriangleMesh:
        """Return the tile with caps above the plane z = 0 (`sign` 1) or below it (-1)."""
        rng = np.random.Generator(np.random.PCG64(seed))
        # In units of the sphere's radius.
        slope = acos(1.0 - self.depth)  # of the cap at its rim
        rim = sin(slope) if self.depth < 1 else 1.0
        size, centres = arrange(rng, self.arrangement, self.cover, rim, _N_RANDOM)
        vertices, faces, outlines, n = [], [], [], 0
        for centre in centres:
            angles = _rim_angles(rng, self.segments, centre, rim, size)
            points, triangles = _cap(rng, angles, slope, rim, self.segments)
            outline = centre + points[: len(angles), :2]
            _onto_borders(outline, size)
            points[:, :2] += centre
            points[: len(angles), :2] = outline
            outlines.append(outline)
            vertices.append(points * (1, 1, sign))
            faces.append(triangles + n)
            n += len(points)
        plane, triangles = _plane_between(outlines, centres, rim, size)
        vertices.append(plane)
        faces.append(triangles + n)
        labels = np.zeros(sum(map(len, faces)), np.uint8)
        labels[-len(triangles) :] = 1
        tile = cut_to_tile(np.concatenate(vertices), np.concatenate(faces), size, labels)
        periods = (size[0] * self.radius, size[1] * self.radius)
        return TriangleMesh(tile.vertices * self.radius, tile.faces, (0.0, 0.0), periods, tile.labels)


def arrange(
    rng: np.random.Generator, arrangement: str, cover: float, radius: float, n_random: int
) -> tuple[tuple[float, float], NDArray[np.float64]]:
    """Periods of a tile, and centres (n, 2) in it, of discs that cover this fraction of the plane."""
    disc = pi * radius**2 / cover  # area of the plane to each
    if arrangement == "square":
        side = sqrt(disc)
        return (side, side), np.array([(0.5 * side, 0.5 * side)])
    if arrangement == "hexagonal":
        pitch = sqrt(disc * 2.0 / sqrt(3.0))
        size = (pitch, sqrt(3.0) * pitch)
        return size, np.array([(0.5 * size[0], 0.25 * size[1]), (0.0, 0.75 * size[1])])
    side = sqrt(n_random * disc)
    return (side, side), scatter(rng, n_random, 2.0 * _RANDOM_GAP * radius, side)


def scatter(rng: np.random.Generator, number: int, distance: float, side: float) -> NDArray[np.float64]:
    """Draw points in a periodic square, none nearer to another than `distance`.

    Random sequential addition: each is uniform over the room left by those before it.

    Returns
    -------
    ndarray, shape (number, 2)
    """
    for _ in range(100):
        centres = np.empty((0, 2))
        for candidate in rng.uniform(0.0, side, (400 * number, 2)):
            apart = np.abs(centres - candidate)
            apart = np.minimum(apart, side - apart)
            if (np.hypot(apart[:, 0], apart[:, 1]) >= distance).all():
                centres = np.vstack((centres, candidate))
                if len(centres) == number:
                    return centres
    raise InputError("cover: no room for the caps at random; lower it, or arrange them")


def _rim_angles(
    rng: np.random.Generator,
    segments: int,
    centre: NDArray[np.float64],
    rim: float,
    size: tuple[float, float],
) -> NDArray[np.float64]:
    """Angles of a rim's vertices: evenly spaced, and where it crosses a face of the tile."""
    crossings = []
    for axis, period in enumerate(size):
        for plane in (0.0, period):
            cosine = (plane - centre[axis]) / rim
            if abs(cosine) < 1.0:
                along = np.arccos(cosine)
                crossings += [along, -along] if axis == 0 else [0.5 * pi - along, 0.5 * pi + along]
    step = 2.0 * pi / segments
    even = (np.arange(segments) + rng.uniform()) * step
    angles = np.mod(np.array(crossings), 2.0 * pi)
    if len(angles):
        # An even one close to a crossing gives way to it: no splinters.
        apart = np.abs((even[:, None] - angles + pi) % (2.0 * pi) - pi).min(axis=1)
        even = even[apart > 0.3 * step]
    return np.sort(np.concatenate((np.mod(even, 2.0 * pi), angles)))


def _onto_borders(outline: NDArray[np.float64], size: tuple[float, float]) -> None:
    """Move what rounding left beside a face of the tile onto it."""
    for axis, period in enumerate(size):
        for plane in (0.0, period):
            outline[np.abs(outline[:, axis] - plane) < 1e-9 * period, axis] = plane


def _cap(
    rng: np.random.Generator, angles: NDArray[np.float64], slope: float, rim: float, segments: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices and faces of a cap of the unit sphere over z = 0; the rim's vertices come first."""
    # Rings as far apart as the rim's vertices, in units of the rim's polar angle. Where the first is, and
    # how each is turned, is drawn: so facets take every inclination over the seeds. The last gap is at
    # least 3/4 of one: a hemisphere is so steep there that a nearer ring would stand out over the rim's edges.
    step = 2.0 * pi * rim / (segments * slope)
    polar: list[np.ndarray] = [np.ones(len(angles))]
    azimuth: list[np.ndarray] = [angles]
    for at in np.arange(rng.uniform() * step, 1.0 - 0.75 * step, step).tolist():
        count = max(1, round(segments * sin(at * slope) / rim))
        polar.append(np.full(count, at))
        azimuth.append((np.arange(count) + rng.uniform()) * (2.0 * pi / count))
    u, phi = np.concatenate(polar), np.concatenate(azimuth)
    faces = Delaunay(np.column_stack((u * np.cos(phi), u * np.sin(phi)))).simplices
    radius = np.where(u == 1.0, rim, np.sin(u * slope))
    height = np.where(u == 1.0, 0.0, np.cos(u * slope) - np.cos(slope))
    points = np.column_stack((radius * np.cos(phi), radius * np.sin(phi), height))
    return points, _facing_up(points, faces.astype(np.int64))


def _facing_up(points: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Turn the triangles of a plane's triangulation counter-clockwise."""
    a, b, c = (points[faces[:, corner], :2] for corner in range(3))
    clockwise = (b - a)[:, 0] * (c - a)[:, 1] < (b - a)[:, 1] * (c - a)[:, 0]
    faces[clockwise] = faces[clockwise, ::-1]
    return faces


def _plane_between(
    outlines: list[NDArray[np.float64]],
    centres: NDArray[np.float64],
    rim: float,
    size: tuple[float, float],
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Triangulate the tile without the discs.

    The vertices of a rim lie on a circle with none of another's inside, so each of its edges is one of
    the Delaunay triangulation, and a triangle is inside a disc if all its corners are on one rim.
    """
    points, disc, n = [], [], 0
    for outline in outlines:
        for x in (0.0, size[0], -size[0]):
            for y in (0.0, size[1], -size[1]):
                image = outline + np.array((x, y))
                inside = ((image >= 0.0) & (image <= size)).all(axis=1)
                points.append(image[inside])
                disc.append(np.full(np.count_nonzero(inside), n))
                n += 1
    corners = np.array([(x, y) for x in (0.0, size[0]) for y in (0.0, size[1])])
    # All four are one point of the surface; if it is in a disc, the plane has no corner.
    apart = np.minimum(centres, size - centres)
    if (np.hypot(apart[:, 0], apart[:, 1]) > rim).all():
        points.append(corners)
        disc.append(np.arange(n, n + 4))
    xy, owner = np.concatenate(points), np.concatenate(disc)
    faces = Delaunay(xy).simplices.astype(np.int64)
    own = owner[faces]
    faces = faces[(own[:, 0] != own[:, 1]) | (own[:, 1] != own[:, 2])]
    vertices = np.column_stack((xy, np.zeros(len(xy))))
    return vertices, _facing_up(vertices, faces)
