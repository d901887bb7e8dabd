"""Radiance's isotropic tensor trees: f on the unit cube, in nested braces.

A node is ``{8 nodes}``, child n holding the half of axis i that bit i of n says, or ``{numbers}``, a grid of
2^k cells on each axis, the last axis fastest. Coordinates: 0.5 - 0.5 sin(theta_in), then Shirley and Chiu's
map from the disk of (x, y) of the outgoing direction, turned so that light travels along +x, to the square.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.formats.text import to_numbers
from microgeometry.errors import InputError

Array = NDArray[np.float64]

_MAX_DEPTH = 20
_RANK = 3


class TensorTree:
    """A tree that has been read.

    Parameters
    ----------
    text : str
        Nested braces.
    path : Path
        The file, for errors.

    Raises
    ------
    InputError
        Braces that do not match, numbers that make no grid, or a tree too deep.
    """

    def __init__(self, text: str, path: Path) -> None:
        children: list[list[int]] = []
        offset: list[int] = []
        cells: list[int] = []  # per axis of a leaf's grid
        words: list[str] = []
        open_nodes: list[tuple[int, int]] = []  # node, where its words begin
        depth, done = 0, False
        for token in re.findall(r"[{}]|[^\s{},]+", text):
            if done:
                raise InputError(f"{path}: text after the end of a tensor tree; copy it again")
            if token == "{":
                node = len(children)
                if open_nodes:
                    parent, begun = open_nodes[-1]
                    if not children[parent] and len(words) > begun:
                        raise InputError(f"{path}: numbers and branches in one node of a tensor tree")
                    children[parent].append(node)
                children.append([])
                offset.append(0)
                cells.append(0)
                open_nodes.append((node, len(words)))
                depth = max(depth, len(open_nodes))
                if depth > _MAX_DEPTH:
                    raise InputError(f"{path}: a tensor tree more than {_MAX_DEPTH} deep; is it damaged?")
            elif not open_nodes:
                raise InputError(f"{path}: a tensor tree begins with {token[:20]!r}; {{ is expected")
            elif token == "}":
                node, begun = open_nodes.pop()
                offset[node] = begun
                cells[node] = _close(children[node], len(words) - begun, path)
                done = not open_nodes
            elif children[open_nodes[-1][0]]:
                raise InputError(f"{path}: numbers and branches in one node of a tensor tree")
            else:
                words.append(token)
        if not done:
            raise InputError(f"{path}: a tensor tree without its last }}; copy it again")
        self.values = np.maximum(to_numbers(words, "a tensor tree", path), 0.0)
        self._children = np.array([c or [-1] * 2**_RANK for c in children], np.int64)
        self._offset, self._cells = np.array(offset), np.array(cells)
        self.resolution = int(min(2**depth * self._cells.max() // 2, 2**_MAX_DEPTH))

    def look_up(self, points: Array) -> Array:
        """Values at points of the unit cube, shape (N, 3); cells are constant."""
        points = np.clip(points, 0.0, np.nextafter(1.0, 0.0))
        node = np.zeros(len(points), np.int64)
        while np.any(branch := self._children[node, 0] >= 0):
            doubled = 2 * points
            upper = doubled >= 1
            child = self._children[node, upper @ np.array([1, 2, 4])]
            node = np.where(branch, child, node)
            points = np.where(branch[:, None], doubled - upper, points)
        n = self._cells[node]
        i = np.minimum((points * n[:, None]).astype(np.int64), n[:, None] - 1)
        return self.values[self._offset[node] + (i[:, 0] * n + i[:, 1]) * n + i[:, 2]]

    def middles(self) -> Array:
        """Of all cells, shape (N, 3)."""
        points = []
        node, low, size = np.zeros(1, np.int64), np.zeros((1, _RANK)), 1.0
        while len(node):
            branch = self._children[node, 0] >= 0
            for n in np.unique(self._cells[node[~branch]]):
                inside = (np.indices((n, n, n)).reshape(_RANK, -1).T + 0.5) / n
                leaves = low[~branch & (self._cells[node] == n)]
                points.append((leaves[:, None] + size * inside).reshape(-1, _RANK))
            size *= 0.5
            corners = size * (np.arange(2**_RANK)[:, None] >> np.arange(_RANK) & 1)
            low = (low[branch][:, None] + corners).reshape(-1, _RANK)
            node = self._children[node[branch]].ravel()
        return np.concatenate(points)


def _close(children: list[int], n_words: int, path: Path) -> int:
    """Cells per axis of what stood between two braces; 0 for a node with branches."""
    if len(children) == 2**_RANK:
        return 0
    if children:
        raise InputError(f"{path}: a node of {len(children)} branches; 8 are expected in an isotropic tree")
    cells = round(n_words ** (1 / _RANK))
    if n_words == 0 or cells**_RANK != n_words or cells & (cells - 1):
        raise InputError(
            f"{path}: a node of {n_words} numbers; 1, 8, 64, ... are expected in an isotropic tree"
        )
    return cells


def tree_text(grid: Array, tolerance: float) -> str:
    """A tree of a cube of values, 2^k on each axis; octants that vary by less than `tolerance` are joined.

    Parameters
    ----------
    grid : ndarray, shape (n, n, n)
    tolerance : float
        Relative to an octant's largest value.
    """
    low, high = grid.min(), grid.max()
    if len(grid) == 1 or high - low <= tolerance * high:
        return f"{{ {grid.mean():.6g} }}"
    h = len(grid) // 2
    octants = (
        grid[
            (n & 1) * h : (n & 1) * h + h,
            (n >> 1 & 1) * h : (n >> 1 & 1) * h + h,
            (n >> 2) * h : (n >> 2) * h + h,
        ]
        for n in range(8)
    )
    return "{\n" + "\n".join(tree_text(octant, tolerance) for octant in octants) + "\n}"


def coordinates(theta_in: Array, theta_out: Array, delta_phi: Array) -> Array:
    """Points of the cube, shape (N, 3), of light and detector; delta phi is 0 at retro-reflection."""
    # light travels away from where it comes from
    psi = delta_phi - np.pi
    square = disk_to_square(np.sin(theta_out) * np.cos(psi), np.sin(theta_out) * np.sin(psi))
    return np.stack([0.5 - 0.5 * np.sin(theta_in) + 0 * theta_out, *square], axis=-1)


def directions(points: Array) -> tuple[Array, Array, Array]:
    """The inverse of `coordinates`: theta_in, theta_out, delta phi."""
    x, y = square_to_disk(points[..., 1], points[..., 2])
    radius = np.minimum(np.hypot(x, y), 1.0)
    return np.arcsin(np.clip(1 - 2 * points[..., 0], 0, 1)), np.arcsin(radius), np.arctan2(y, x) + np.pi


def square_to_disk(u: Array, v: Array) -> tuple[Array, Array]:
    """Shirley & Chiu 1997, from [0, 1]^2 to the unit disk, as in Radiance."""
    a, b = 2 * u - 1, 2 * v - 1
    wide = np.abs(a) > np.abs(b)
    radius = np.where(wide, a, b)
    safe = np.where(radius == 0, 1.0, radius)
    phi = np.where(wide, 0.25 * np.pi * b / safe, 0.5 * np.pi - 0.25 * np.pi * a / safe)
    return radius * np.cos(phi), radius * np.sin(phi)


def disk_to_square(x: Array, y: Array) -> tuple[Array, Array]:
    """The inverse of `square_to_disk`."""
    radius = np.hypot(x, y)
    phi = (np.arctan2(y, x) + 0.25 * np.pi) % (2 * np.pi) - 0.25 * np.pi  # from -pi/4
    quadrant = np.minimum((phi + 0.25 * np.pi) // (0.5 * np.pi), 3)
    along = (phi - quadrant * 0.5 * np.pi) * radius * (4 / np.pi)
    a = np.choose(quadrant.astype(int), [radius, -along, -radius, along])
    b = np.choose(quadrant.astype(int), [along, radius, -along, -radius])
    return 0.5 * (a + 1), 0.5 * (b + 1)
