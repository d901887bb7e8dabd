"""Triangles of a periodic surface, cut at the faces of one period."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from microgeometry.tile import TriangleMesh

# A vertex closer to the cut than this, in periods, is moved onto it: no slivers thinner than rounding.
_SNAP = 1e-9


def cut_to_tile(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int64],
    size: tuple[float, float],
    labels: NDArray[np.uint8] | None = None,
) -> TriangleMesh:
    """Cut a surface at the faces of the tile and bring what stands out in on the other side.

    A surface that is closed over the period stays so, to the bit: the two triangles at an edge are cut at
    the same point, and each point on a face of the tile has its twin on the opposite one. Triangles that use
    a position twice are left out.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
        Metres; less than one period outside 0..Lx, 0..Ly.
    faces : ndarray, shape (F, 3)
        Vertex indices. Each triangle of the period once, wherever it stands.
    size : tuple of float
        Periods (Lx, Ly), metres.
    labels : ndarray, shape (F,), optional
        See `TriangleMesh`; the pieces of a triangle keep its label.
    """
    vertices = vertices.copy()
    parents = np.arange(len(faces))
    for axis, period in enumerate(size):
        for plane in (0.0, period):
            near = np.abs(vertices[:, axis] - plane) < _SNAP * period
            vertices[near, axis] = plane
            vertices, faces, parents = _cut(vertices, faces, parents, axis, plane)
        middles = vertices[faces, axis].mean(axis=1)
        shift = np.where(middles < 0.0, 1, 0) - np.where(middles > period, 1, 0)
        # One vertex for each old one and shift.
        key, index = np.unique(3 * faces + (1 + shift)[:, None], return_inverse=True)
        vertices, faces = vertices[key // 3], index.reshape(-1, 3)
        vertices[:, axis] += (key % 3 - 1) * period
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    whole = (a != b).any(axis=1) & (b != c).any(axis=1) & (c != a).any(axis=1)
    pieces = None if labels is None else labels[parents[whole]]
    return TriangleMesh(vertices, faces[whole].astype(np.int32), (0.0, 0.0), size, pieces)


def _cut(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int64],
    parents: NDArray[np.int64],
    axis: int,
    plane: float,
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Split the triangles that cross a plane; none of the result has corners on both sides.

    `parents` (F,) is copied to the pieces of a triangle.
    """
    side = np.sign(vertices[:, axis] - plane).astype(int)
    sides = side[faces]
    crossing = (sides.min(axis=1) < 0) & (sides.max(axis=1) > 0)
    points: list[NDArray[np.float64]] = []
    known: dict[tuple[int, int], int] = {}

    def cut_point(a: int, b: int) -> int:
        # From the same end for both triangles at the edge: the same bits.
        edge = (min(a, b), max(a, b))
        if edge not in known:
            p, q = vertices[edge[0]], vertices[edge[1]]
            point = p + (plane - p[axis]) / (q[axis] - p[axis]) * (q - p)
            point[axis] = plane
            known[edge] = len(vertices) + len(points)
            points.append(point)
        return known[edge]

    pieces: list[tuple[int, int, int]] = []
    heirs: list[int] = []
    for (a, b, c), parent in zip(faces[crossing].tolist(), parents[crossing].tolist(), strict=True):
        # Turn it until `a` is alone on its side (or if one corner is on the plane, until it is not first).
        while side[a] == 0 or side[a] == side[b] or side[a] == side[c]:
            a, b, c = b, c, a
        if side[b] == 0 or side[c] == 0:
            if side[c] == 0:
                cut = cut_point(a, b)
                pieces += [(a, cut, c), (cut, b, c)]
            else:
                cut = cut_point(c, a)
                pieces += [(a, b, cut), (b, c, cut)]
            heirs += 2 * [parent]
        else:
            ab, ca = cut_point(a, b), cut_point(c, a)
            pieces += [(a, ab, ca), (ab, b, c), (ab, c, ca)]
            heirs += 3 * [parent]
    if not pieces:
        return vertices, faces, parents
    return (
        np.concatenate((vertices, points)),
        np.concatenate((faces[~crossing], np.array(pieces))),
        np.concatenate((parents[~crossing], np.array(heirs))),
    )
