"""An analytic model as a table, and its directional albedo."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting.grid import LEVELS, Grid
from fitting.models import find_lobe
from fitting.models.dispatch import lobe_eval, lobe_pdf, lobe_sample
from fitting.result import Fit
from gonio.core.jit import kernel
from gonio.progress import Report
from gonio.table.table import Table
from microgeometry.errors import InputError

Array = NDArray[np.float64]

_TOLERANCE = (
    1e-3  # a cell is done when halving the node distance changes it by less; what remains is far less
)
_ANGLES_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 85.0)
_LATTICE = 4096
_PAIRS = 100


def tabulate(fit: Fit, grid_like: Table | None = None, progress: Report | None = None) -> Table:
    """Cell averages of a model, by Gauss quadrature refined where the lobe is narrow.

    Parameters
    ----------
    fit : Fit
    grid_like : Table, optional
        Its grid is used; else 1 degree, 90 x 90 x 180 cells, rows being cells of incidence.
    progress : callable, optional
        Called with the fraction done and a few words.

    Returns
    -------
    Table
        Without error bars; its albedo is the sum over its own cells.

    Raises
    ------
    InputError
        The model is anisotropic.
    """
    for lobe in fit.lobes:
        if not find_lobe(lobe.name).isotropic:
            raise InputError(
                f"lobe {lobe.name}: is anisotropic, and a table holds the difference of the azimuths only; "
                "an isotropic model is needed"
            )
    if grid_like is None:
        polar = np.linspace(0.0, np.pi / 2, 91)
        azimuth = np.linspace(0.0, np.pi, 181)
        theta_i, theta_r_edges, delta_phi_edges = 0.5 * (polar[1:] + polar[:-1]), polar, azimuth
        theta_i_edges: Array | None = polar
    else:
        theta_i, theta_i_edges = grid_like.theta_i, grid_like.theta_i_edges
        theta_r_edges, delta_phi_edges = grid_like.theta_r_edges, grid_like.delta_phi_edges
    shape = (len(theta_i), len(theta_r_edges) - 1, len(delta_phi_edges) - 1)
    bare = Table(
        values=np.zeros((*shape, len(fit.channels))),
        theta_i=theta_i,
        theta_r_edges=theta_r_edges,
        delta_phi_edges=delta_phi_edges,
        channels=fit.channels,
        row_albedo=np.zeros((len(theta_i), len(fit.channels))),
        theta_i_edges=theta_i_edges,
        wavelengths_nm=fit.wavelengths_nm,
        provenance={"model": fit.model, "fit": fit.to_json()},
    )
    grid = Grid.of_table(bare)
    values = np.zeros(bare.values.shape)
    for row in range(shape[0]):
        values[row] = _row(fit, grid, row, shape[1:])
        if progress is not None:
            progress((row + 1) / shape[0], f"row {row + 1} of {shape[0]}")
    albedo = np.einsum("irsc,rs->ic", values, bare.projected_solid_angles)
    return bare.replace(values=values, row_albedo=albedo)


def _row(fit: Fit, grid: Grid, row: int, shape: tuple[int, int]) -> Array:
    """One row's cell averages, shape (R, P, C)."""
    kinds, shapes, weights = fit.terms()
    values = np.zeros((*shape, len(fit.channels)))
    if len(kinds) == 0:
        return values
    # entry k of `terms` is one term of a lobe: the kernel returns both, the packed weights pick
    picks = shapes[:, :2].reshape(-1, 1) * np.repeat(weights, 2, axis=0)
    cells = np.stack(np.meshgrid([row], *map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 3)
    cells = cells.astype(np.int32)
    flat = values.reshape(-1, len(fit.channels))
    chosen = np.arange(len(cells))
    flat[:] = grid.terms(kinds, shapes, cells, 0) @ picks
    mirror = grid.near_mirror(cells)
    for level in range(1, LEVELS):
        new = grid.terms(kinds, shapes, cells[chosen], level) @ picks
        change = np.abs(new - flat[chosen]).max(axis=1)
        flat[chosen] = new
        open_ = change > _TOLERANCE * np.abs(new).max(axis=1)
        # a narrow lobe can fall between the first nodes: cells that may hold one go on
        if level < 3:
            open_ |= mirror[chosen]
        chosen = chosen[open_]
        if len(chosen) == 0:
            break
    return values


@kernel
def _albedo(kinds, shapes, wi, points):
    """Directional albedo of each term by its own sampling, over a lattice of uniform numbers."""
    out = np.zeros(len(kinds))
    for k in range(len(kinds)):
        for n in range(len(points)):
            wo = lobe_sample(kinds[k], shapes[k], wi, points[n, 0], points[n, 1])
            if wo[2] > 0.0:
                density = lobe_pdf(kinds[k], shapes[k], wi, wo)
                if density > 0.0:
                    out[k] += lobe_eval(kinds[k], shapes[k], wi, wo) * wo[2] / density
        out[k] /= len(points)
    return out


def directional_albedo(fit: Fit, theta_i: float) -> Array:
    """Share of the light from `theta_i` (radians) that the model reflects, shape (C,)."""
    kinds, shapes, weights = fit.terms()
    n = np.arange(_LATTICE)
    # rank-1 lattice of the golden ratio
    points = np.stack([(n + 0.5) / _LATTICE, (n * (math.sqrt(5.0) - 1.0) / 2.0 + 0.5) % 1.0], axis=1)
    wi = (math.sin(theta_i), 0.0, math.cos(theta_i))
    return _albedo(kinds, shapes, wi, points) @ weights


def albedo_check(fit: Fit) -> dict[str, Any]:
    """Directional albedo at a few angles; energy counts as conserved up to 1.001, the lattice's error."""
    values = np.array([directional_albedo(fit, math.radians(a)) for a in _ANGLES_DEG])
    largest = float(values.max())
    return {
        "theta_i_deg": list(_ANGLES_DEG),
        "values": {c: values[:, k].tolist() for k, c in enumerate(fit.channels)},
        "largest": largest,
        "conserves_energy": largest <= 1.0 + 1e-3,
    }


def reciprocity_check(fit: Fit) -> dict[str, Any]:
    """Largest difference of f(i, o) and f(o, i), relative to their mean, over pairs of directions and channels."""
    kinds, shapes, weights = fit.terms()
    n = np.arange(_PAIRS)
    # low-discrepancy angles: Kronecker's sequence (Roberts 2018)
    u = (n[:, None] * np.array([0.8191725, 0.6710436, 0.5497005]) + 0.5) % 1.0
    largest = 0.0
    for theta_i, theta_o, phi in u * np.array([0.47, 0.47, 1.0]) * np.pi:
        wi = (math.sin(theta_i), 0.0, math.cos(theta_i))
        wo = (math.sin(theta_o) * math.cos(phi), math.sin(theta_o) * math.sin(phi), math.cos(theta_o))
        there, back = np.zeros(len(fit.channels)), np.zeros(len(fit.channels))
        for kind, shape, weight in zip(kinds, shapes, weights, strict=True):
            there += weight * lobe_eval(kind, shape, wi, wo)
            back += weight * lobe_eval(kind, shape, wo, wi)
        total = there + back
        lit = total > 0.0
        largest = max(largest, float(np.max(2.0 * np.abs(there - back)[lit] / total[lit], initial=0.0)))
    return {"largest_difference": largest, "reciprocal": largest < 1e-6}
