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


def _rgb_to_xyz() -> Array:
    """Radiance's primaries (src/common/color.h): white at x = y = 1/3."""
    xy = np.array([[0.640, 0.330], [0.290, 0.600], [0.150, 0.060]])
    primaries = np.column_stack([xy[:, 0] / xy[:, 1], np.ones(3), (1 - xy.sum(axis=1)) / xy[:, 1]]).T
    return primaries * np.linalg.solve(primaries, np.ones(3))


XYZ = _rgb_to_xyz()
"""From Radiance's RGB to CIE XYZ."""


def matrix_texts(table: Table) -> dict[str, str]:
    """ScatteringData of a table by kind of wavelength."""
    basis = Klems(FULL)
    n_channels = len(table.channels)
    matrix = np.empty((basis.size, basis.size, n_channels))
    points = [basis.points(patch, 3, 3) for patch in range(basis.size)]
    wo = np.stack([direction(*p) for p in points])
    for incident in range(basis.size):
        theta, phi = basis.points(incident, 3, 3)
        wi = direction(theta, phi + np.pi)
        # every point of the incident patch with every point of the outgoing ones
        matrix[:, incident] = np.mean([table.eval(w, wo).mean(axis=1) for w in wi], axis=0)
    if n_channels == 1:
        planes = {"Visible": matrix[..., 0]}
    else:
        xyz = matrix @ XYZ.T
        planes = {"Visible": xyz[..., 1], "CIE-X": xyz[..., 0], "CIE-Z": xyz[..., 2]}
    return {
        kind: "\n".join(", ".join(f"{v:.6g}" for v in row) + "," for row in plane)
        for kind, plane in planes.items()
    }


def tree_texts(table: Table) -> dict[str, str]:
    """ScatteringData of a table by kind of wavelength."""
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
