"""The values of a table as a WINDOW or Radiance file writes them: Klems matrix or tensor tree."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import direction
from gonio.formats.klems import Klems
from gonio.formats.radiance_document import FULL
from gonio.formats.tensor_tree import directions, tree_text
from gonio.table.table import Table

Array = NDArray[np.float64]

LEVELS = 6  # of a tree that is written: 64 cells an axis
_TOLERANCE = 0.02
_INCIDENT, _OUTGOING, _SECTORS = 4, 20, 360  # angles of each ring of a matrix, and steps of delta phi


def _rgb_to_xyz() -> Array:
    """Radiance's primaries (src/common/color.h): white at x = y = 1/3."""
    xy = np.array([[0.640, 0.330], [0.290, 0.600], [0.150, 0.060]])
    primaries = np.column_stack([xy[:, 0] / xy[:, 1], np.ones(3), (1 - xy.sum(axis=1)) / xy[:, 1]]).T
    return primaries * np.linalg.solve(primaries, np.ones(3))


XYZ = _rgb_to_xyz()
"""From Radiance's RGB to CIE XYZ."""


def matrix_texts(table: Table) -> dict[str, str]:
    """ScatteringData of a table by kind of wavelength."""
    matrix = _matrix(table)
    n_channels = len(table.channels)
    if n_channels == 1:
        planes = {"Visible": matrix[..., 0]}
    else:
        xyz = matrix @ XYZ.T
        planes = {"Visible": xyz[..., 1], "CIE-X": xyz[..., 0], "CIE-Z": xyz[..., 2]}
    return {
        kind: "\n".join(", ".join(f"{v:.6g}" for v in row) + "," for row in plane)
        for kind, plane in planes.items()
    }


def _matrix(table: Table) -> Array:
    """Means of f over pairs of patches, shape (outgoing, incident, C)."""
    basis = Klems(FULL)
    # the cells hold the light of a highlight as well, and patches are wider
    table = table.replace(peak=None)
    rings = [
        np.arcsin(np.sqrt(u)) for u in (_middles(basis.edges, _INCIDENT), _middles(basis.edges, _OUTGOING))
    ]
    delta_phi = (np.arange(_SECTORS) + 0.5) * (np.pi / _SECTORS)
    wo = direction(rings[1][:, :, None], delta_phi)
    matrix = np.empty((basis.size, basis.size, len(table.channels)))
    for a, theta_i in enumerate(rings[0]):
        # means over polar angles, by outgoing ring
        f = np.mean([table.eval(direction(theta), wo).mean(axis=1) for theta in theta_i], axis=0)
        for b in range(len(basis.counts)):
            block = _over_azimuths(f[b], *(basis.azimuths(ring) for ring in (b, a)))
            matrix[basis.first[b] : basis.first[b + 1], basis.first[a] : basis.first[a + 1]] = block
    return matrix


def _middles(edges: Array, n: int) -> Array:
    """sin^2 of n angles in each ring, of equal projected solid angle; shape (rings, n)."""
    u = np.sin(edges) ** 2
    return u[:-1, None] + (np.arange(n) + 0.5) / n * np.diff(u)[:, None]


def _over_azimuths(f: Array, outgoing: Array, incident: Array) -> Array:
    """Exact means over pairs of intervals of azimuth of what is constant in equal intervals of |delta phi|.

    Parameters
    ----------
    f : ndarray, shape (_SECTORS, C)
    outgoing, incident : ndarray
        Middles of equal patches of a ring; the incident ones of the directions in which light travels.

    Returns
    -------
    ndarray, shape (outgoing, incident, C)
    """
    around = np.concatenate([f, f[::-1]])
    # twice the integral from 0, at the nodes of three turns, between which it is a parabola
    step = np.pi / _SECTORS
    once = step * np.cumsum(np.concatenate([np.zeros_like(around[:1]), np.tile(around, (3, 1))]), axis=0)
    twice = step * np.cumsum(np.concatenate([0 * once[:1], 0.5 * (once[1:] + once[:-1])]), axis=0)

    def integral(x: Array) -> Array:
        at = x / step
        low = np.clip(at.astype(int), 0, len(once) - 2)
        t = ((at - low) * step)[..., None]
        return twice[low] + t * (once[low] + 0.5 * t * (once[low + 1] - once[low]) / step)

    w_o, w_i = (2 * np.pi / len(patches) for patches in (outgoing, incident))
    # the light comes from opposite to where it travels; the middle one of the turns
    apart = (outgoing[:, None] - incident - np.pi) % (2 * np.pi) + 2 * np.pi
    wide, narrow = 0.5 * (w_o + w_i), 0.5 * (w_o - w_i)
    total = (
        integral(apart + wide) - integral(apart + narrow) - integral(apart - narrow) + integral(apart - wide)
    )
    return total / (w_o * w_i)


def tree_texts(table: Table) -> dict[str, str]:
    """ScatteringData of a table by kind of wavelength."""
    # the cells hold the light of a highlight as well, and points of the grid would miss it
    table = table.replace(peak=None)
    n = 2**LEVELS
    centre = (np.arange(2 * n) + 0.5) / (2 * n)
    n_channels = len(table.channels)
    grid = np.zeros((n, n, n, n_channels))
    for i in range(n // 2):  # beyond 0.5 there is no incidence
        total = np.zeros((n, n, n_channels))
        for g0 in centre[2 * i : 2 * i + 2]:
            square = np.stack(np.meshgrid([g0], centre, centre, indexing="ij"), axis=-1)[0]
            theta_in, theta_out, phi = directions(square)
            f = table.eval(direction(theta_in[0, 0]), direction(theta_out, phi))
            total += f.reshape(n, 2, n, 2, n_channels).mean(axis=(1, 3))
        grid[i] = grid[n - 1 - i] = 0.5 * total
    if n_channels == 1:
        return {"Visible": tree_text(grid[..., 0], _TOLERANCE)}
    xyz = grid @ XYZ.T
    scale = xyz @ np.array([1.0, 15.0, 3.0])
    lit = scale > 0
    # what is dark has the chromaticity of white
    u = np.divide(4 * xyz[..., 0], scale, out=np.full_like(scale, 4 / 19), where=lit)
    v = np.divide(9 * xyz[..., 1], scale, out=np.full_like(scale, 9 / 19), where=lit)
    planes = {
        "Visible": (xyz[..., 1], _TOLERANCE),
        "CIE-u": (u, 0.25 * _TOLERANCE),
        "CIE-v": (v, 0.25 * _TOLERANCE),
    }
    return {kind: tree_text(plane, tolerance) for kind, (plane, tolerance) in planes.items()}
