"""Triangles of a periodic surface, cut at the faces of one period."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from microgeometry.tile import TriangleMesh

# A vertex closer to the cut than this, in periods, is moved onto it: no slivers thinner than rounding.
_SNAP = 1e-9


def cut_to_tile(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], size: tuple[float, float]
) -> TriangleMesh:
    """Cut a surface at the faces of the tile and bring what stands out in on the other side.

    A surface that is closed over the period stays so, to the bit: the two triangles at an edge are cut at
    the same point, and each point on a face of the tile has its twin on the opposite one.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
        Metres; less than one period outside 0..Lx, 0..Ly.
    faces : ndarray, shape (F, 3)
        Vertex indices. Each triangle of the period once, wherever it stands.
    size : tuple of float
        Periods (Lx, Ly), metres.
    """
    vertices = vertices.copy()
    for axis, period in enumerate(size):
        for plane in (0.0, period):
            near = np.abs(vertices[:, axis] - plane) < _SNAP * period
            vertices[near, axis] = plane
            vertices, faces = _cut(vertices, faces, axis, plane)
        middles = vertices[faces, axis].mean(axis=1)
        shifted = []
        for shift, here in (
            (0.0, (middles >= 0.0) & (middles <= period)),
            (period, middles < 0.0),
            (-period, middles > period),
        ):
            piece = vertices[faces[here]]
            piece[..., axis] += shift
            shifted.append(piece.reshape(-1, 3))
        vertices = np.concatenate(shifted)
        vertices, index = np.unique(vertices + 0.0, axis=0, return_inverse=True)
        faces = index.reshape(-1, 3)
    return merged(vertices, faces, size)


def merged(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], size: tuple[float, float]
) -> TriangleMesh:
    """Return the tile with one vertex for each position, and no triangle that uses a position twice."""
    # Adding zero turns -0 into 0, which unique would tell apart from it.
    vertices, index = np.unique(vertices + 0.0, axis=0, return_inverse=True)
    faces = index.reshape(-1)[faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    return TriangleMesh(vertices, faces.astype(np.int32), (0.0, 0.0), size)


def _cut(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], axis: int, plane: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Split the triangles that cross a plane; none of the result has corners on both sides."""
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
    for a, b, c in faces[crossing].tolist():
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
        else:
            ab, ca = cut_point(a, b), cut_point(c, a)
            pieces += [(a, ab, ca), (ab, b, c), (ab, c, ca)]
    if not pieces:
        return vertices, faces
    if points:
        vertices = np.concatenate((vertices, points))
    return vertices, np.concatenate((faces[~crossing], np.array(pieces)))
