"""A block cut out of a surface to look at: its top is the tile's triangles, its sides are cut faces."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from trimesh.intersections import slice_faces_plane

from microgeometry.tile import HeightField, Tile, TriangleMesh
from renderer.scene import Array

Triangles = tuple[Array, NDArray[np.int64]]
"""Vertices (V, 3) and faces (F, 3)."""

_HILLS = 6.0  # seen side by side, about
_MAX_SAMPLES = 1000  # of a height field, per side: more than the picture has pixels
# The sides are cut this far inside: on the very face of a tile, edges of triangles would lie in the cut.
_INSIDE = 1e-6


@dataclass(frozen=True, eq=False)
class Block:
    """A rectangular piece of a periodic surface, in units of its longer side.

    Attributes
    ----------
    tops : dict of int to Triangles
        The surface, by the label of its facets: 0 the layer's material, 1 its plane.
    sides : Triangles
        What is solid between the surface and `base` at the four cuts.
    size : tuple of float
        Widths along x and y; the block stands at x, y >= 0.
    base, top : float
        Heights of its underside and of its highest point.
    unit : float
        Metres per unit of all these.
    """

    tops: dict[int, Triangles]
    sides: Triangles
    size: tuple[float, float]
    base: float
    top: float
    unit: float


def cut_block(tile: Tile, size: tuple[float, float] | None = None) -> Block:
    """Cut a block out of a tile's surface that shows what kind of surface it is.

    Parameters
    ----------
    tile : Tile
    size : tuple of float, optional
        Widths along x and y, metres. By default some six hills: whole periods, or a part of one if a
        period holds more.
    """
    metres = size or typical_size(tile)
    unit = max(metres)
    size = (metres[0] / unit, metres[1] / unit)
    if isinstance(tile, HeightField):
        tops = {0: _grid(tile, size, unit)}
    else:
        tops = _copies(tile, size, unit)
    heights = np.concatenate([vertices[faces.ravel(), 2] for vertices, faces in tops.values()])
    low, high = float(heights.min()), float(heights.max())
    base = low - 0.08 - 0.05 * (high - low)
    sides = [_side(tops.values(), axis, at, base) for axis in (0, 1) for at in (0.0, size[axis])]
    return Block(tops, _joined(sides), size, base, high, unit)


def typical_size(tile: Tile) -> tuple[float, float]:
    """Widths of a block with some six hills (grooves, pits) to a side, metres.

    How far it is from hill to hill is judged by height over slope, exact for V-grooves.
    """
    normals, areas = tile.facets()
    slope = float(np.sum(areas * np.hypot(normals[:, 0], normals[:, 1]))) / (tile.size[0] * tile.size[1])
    if not slope > 0:
        return tile.size
    hill = math.sqrt(48.0) * tile.statistics().rms_height / slope
    wanted = _HILLS * min(hill, *tile.size)
    return _width(tile.size[0], wanted), _width(tile.size[1], wanted)


def _width(period: float, wanted: float) -> float:
    """Whole periods near the width wanted, or the width itself if a period is much wider."""
    return wanted if wanted < 0.75 * period else period * max(1, round(wanted / period))


def _grid(tile: HeightField, size: tuple[float, float], unit: float) -> Triangles:
    """The samples of a height field within `size`, no more of them than a picture can show."""
    index, place = [], []
    for axis in (0, 1):
        samples = tile.heights.shape[axis]
        n = max(1, round(size[axis] * unit / tile.size[axis] * samples))
        chosen = np.append(np.arange(0, n, -(-n // _MAX_SAMPLES)), n)
        index.append(chosen % samples)
        place.append(chosen * (size[axis] / n))
    x, y = np.meshgrid(*place, indexing="ij")
    z = (tile.heights - tile.heights.mean())[np.ix_(*index)] / unit
    number = np.arange(x.size).reshape(x.shape)
    v0, v1, v2, v3 = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate([np.stack(c, axis=-1).reshape(-1, 3) for c in ((v0, v1, v3), (v2, v3, v1))])
    return np.stack([x, y, z], axis=-1).reshape(-1, 3), faces


def _copies(tile: TriangleMesh, size: tuple[float, float], unit: float) -> dict[int, Triangles]:
    """Copies of a mesh side by side that cover `size`, cut off there; by label."""
    vertices = (tile.vertices - [*tile.origin, 0.0]) / unit
    vertices[:, 2] -= 0.5 * (vertices[:, 2].min() + vertices[:, 2].max())
    shifts = []
    for axis in (0, 1):  # a mesh may stand out of its own period
        period = tile.size[axis] / unit
        first = math.floor(1e-9 - vertices[:, axis].max() / period) + 1
        last = math.ceil((size[axis] - vertices[:, axis].min()) / period - 1e-9)
        shifts.append([k * period for k in range(first, last)])
    labels = np.zeros(len(tile.faces), np.uint8) if tile.labels is None else tile.labels
    tops = {}
    for label in np.unique(labels).tolist():
        faces = tile.faces[labels == label]
        offsets = [np.array([dx, dy, 0.0]) for dx in shifts[0] for dy in shifts[1]]
        copies = [_clipped(vertices + offset, faces, size) for offset in offsets]
        tops[label] = _joined([copy for copy in copies if len(copy[1])])
    return {label: top for label, top in tops.items() if len(top[1])}


def _clipped(vertices: Array, faces: NDArray, size: tuple[float, float]) -> Triangles:
    for axis in (0, 1):
        for at, sign in ((0.0, 1.0), (size[axis], -1.0)):
            normal, origin = np.zeros(3), np.zeros(3)
            normal[axis], origin[axis] = sign, at
            vertices, faces, _ = slice_faces_plane(vertices, faces, normal, origin)
    return vertices, faces


def _joined(parts: Sequence[Triangles]) -> Triangles:
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = [f + start for (_, f), start in zip(parts, starts, strict=False)]
    none = np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    return np.concatenate([none[0], *(v for v, _ in parts)]), np.concatenate([none[1], *faces])


def _side(tops: Iterable[Triangles], axis: int, at: float, base: float) -> Triangles:
    """The solid part of the plane where coordinate `axis` is `at`, 0 or the far end.

    Solid is what lies below a facet that faces up and above the next that faces down, or the base. The cut
    is a set of line segments; between any two neighbouring ends of theirs it is a stack of trapezoids.
    """
    segments = [_segments(*top, axis, at + (_INSIDE if at == 0.0 else -_INSIDE)) for top in tops]
    ends, facing = np.concatenate([s for s, _ in segments]), np.concatenate([f for _, f in segments])
    edges = np.unique(ends[..., 0])
    first, last = np.searchsorted(edges, ends[:, 0, 0]), np.searchsorted(edges, ends[:, 1, 0])
    count = last - first
    which = np.repeat(np.arange(len(ends)), count)
    column = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count) + first[which]
    (u0, z0), (u1, z1) = ends[which, 0].T, ends[which, 1].T
    slope = (z1 - z0) / (u1 - u0)
    left, right = (z0 + slope * (edges[column + side] - u0) for side in (0, 1))
    order = np.lexsort((-(left + right), column))
    column, left, right, facing = column[order], left[order], right[order], facing[which][order]
    # how many solids one is in just below each crossing, counted down each column from the air above it
    new = np.diff(column, prepend=-1) > 0
    depth = np.cumsum(facing)
    depth = depth - np.repeat((depth - facing)[new], np.diff(np.append(np.flatnonzero(new), len(column))))
    below_left, below_right = np.append(left[1:], base), np.append(right[1:], base)
    bottom = np.append(new[1:], True)
    below_left[bottom], below_right[bottom] = base, base
    solid = depth > 0
    u0, u1 = edges[column[solid]], edges[column[solid] + 1]
    corners = np.stack(
        [[u0, below_left[solid]], [u1, below_right[solid]], [u1, right[solid]], [u0, left[solid]]], axis=1
    ).transpose(2, 1, 0)  # (N, 4, 2)
    vertices = np.empty((*corners.shape[:2], 3))
    vertices[..., axis], vertices[..., 1 - axis], vertices[..., 2] = at, corners[..., 0], corners[..., 1]
    halves = np.array([[0, 1, 2], [0, 2, 3]])
    faces = 4 * np.arange(len(corners))[:, None, None] + halves
    return vertices.reshape(-1, 3), faces.reshape(-1, 3)


def _segments(vertices: Array, faces: NDArray, axis: int, at: float) -> tuple[Array, NDArray]:
    """Where triangles cross a plane: ends (N, 2, 2) as (along, z), along increasing; 1 faces up, -1 down."""
    corners = vertices[faces]
    side = corners[..., axis] > at
    crossing = side.any(axis=1) & ~side.all(axis=1)
    corners, side = corners[crossing], side[crossing]
    # turn each until the corner that is alone on its side comes first
    alone = np.where(side.sum(axis=1) == 1, side.argmax(axis=1), side.argmin(axis=1))
    corners = np.take_along_axis(corners, ((alone[:, None] + np.arange(3)) % 3)[..., None], axis=1)
    t = (at - corners[:, :1, axis]) / (corners[:, 1:, axis] - corners[:, :1, axis])
    points = corners[:, :1] + t[..., None] * (corners[:, 1:] - corners[:, :1])
    ends = points[..., [1 - axis, 2]]
    ends[..., 0] = ends[..., 0].round(9)  # neighbours' ends are one and the same
    backwards = ends[:, 0, 0] > ends[:, 1, 0]
    ends[backwards] = ends[backwards][:, ::-1]
    normal_z = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    wide = ends[:, 1, 0] > ends[:, 0, 0]
    return ends[wide], np.where(normal_z > 0, 1, -1)[wide]
