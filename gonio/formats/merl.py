"""MERL `.binary` files (Matusik et al. 2003): RGB on a grid of half and difference angles.

Layout: three int32, the numbers of bins (90 theta_h, 90 theta_d, 180 phi_d); then float64 R, G and B, each
with phi_d fastest; 34 992 012 bytes. Bins are uniform in sqrt(theta_h), theta_d and phi_d. A stored number
is f_r / (1, 1.15, 1.66) x 1500; negative means no data. A file of 180 phi_d bins is reciprocal: phi_d and
phi_d + pi, which exchange light and detector, share a bin. Some files have 360 and are not.

MERL's phi_d runs from the half vector's own plane, so both signs of our delta phi occur in it; reading
averages them. Light and detector are `wi` and `wo` in the order of MERL's own reader.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import half_difference
from gonio.files import atomic
from gonio.formats.colour import as_colour
from gonio.formats.highlights import Brdf, resolved
from gonio.formats.losses import common_losses
from gonio.table.table import Table
from microgeometry.errors import InputError

Array = NDArray[np.float64]

N_THETA_H, N_THETA_D, N_PHI_D = 90, 90, 180
FACTORS = np.array([1.0, 1.15, 1.66]) / 1500.0
"""From a stored number to f_r in 1/sr, by channel."""

_POINTS = 2  # per cell and axis, at midpoints of equal projected solid angle


def read(path: Path) -> Table:
    """Read a MERL file onto cells of 1 degree.

    A cell's value is the mean of MERL's own nearest-bin look-up at 2 x 2 x 2 points of equal projected
    solid angle, each for both signs of delta phi. Points without data are left out; a cell without any is a
    gap. The albedo is integrated over the cells.

    Returns
    -------
    Table
        90 x 90 x 180 cells, channels R, G, B, rows that are cells of incidence; a grid of its own for a highlight
        that is narrower than three cells. No error bars.

    Raises
    ------
    InputError
        Wrong size or dimensions, or NaN.
    """
    bins = _read_bins(Path(path))
    edges_i = np.radians(np.arange(91.0))
    u = _midpoints(np.sin(edges_i) ** 2)
    theta = np.arcsin(np.sqrt(u))
    edges_phi = np.radians(np.arange(181.0))
    phi = _midpoints(edges_phi)
    values = np.empty((90, 90, 180, 3))
    gaps = np.empty((90, 90, 180), bool)
    for row in range(90):
        total, count = np.zeros((90, 180, 3)), np.zeros((90, 180))
        for theta_i in theta[row]:
            here = _look_up(bins, half_difference(theta_i, theta.reshape(-1, 1), phi.ravel()))
            here = here.reshape(90, _POINTS, 180, _POINTS, 2, 3)
            valid = np.all(here >= 0, axis=-1)
            total += np.einsum("rsptmc,rsptm->rpc", here, valid)
            count += valid.sum(axis=(1, 3, 4))
        gaps[row] = count == 0
        values[row] = total / np.maximum(count, 1)[..., None]
    table = Table(
        values=values,
        theta_i=np.radians(np.arange(90) + 0.5),
        theta_i_edges=edges_i,
        theta_r_edges=edges_i,
        delta_phi_edges=edges_phi,
        channels=("R", "G", "B"),
        row_albedo=np.zeros((90, 3)),
        gaps=gaps if gaps.any() else None,
        provenance={"source": Path(path).name, "format": "MERL", "phi_d_bins": bins.shape[2]},
    )
    table = table.replace(row_albedo=np.einsum("irpc,rp->ic", values, table.projected_solid_angles))
    return resolved(table, _brdf(bins))


def brdf_of(path: Path) -> Brdf:
    """What a file gives between the cells that `read` averages over, 0 without data; errors as there."""
    return _brdf(_read_bins(path))


def _brdf(bins: Array) -> Brdf:
    def look(theta_i: float, theta_o: Array, phi: Array) -> Array:
        found = _look_up(bins, half_difference(theta_i, theta_o, phi))[:, 0]
        return np.where(np.all(found >= 0, axis=-1, keepdims=True), found, 0.0)

    return look


def write(table: Table, path: Path) -> list[str]:
    """Write a table's interpolated values at the centres of MERL's bins, negative ones (no data) in its gaps.

    Parameters
    ----------
    table : Table
        Of three channels, taken as R, G, B, or of one, written three times.
    path : Path

    Returns
    -------
    list of str
        What was lost.

    Raises
    ------
    InputError
        Another number of channels.
    OSError
        The file cannot be written.
    """
    table = as_colour(table, path, "a MERL file")

    def both(wi: Array, wo: Array) -> Array:
        """A bin is read for light and detector exchanged as well; what is unknown both ways is no data."""
        ways = ((wi, wo), (wo, wi))
        known = np.array([~_in_gap(table, *way) for way in ways], float)[..., None]
        total = sum(k * np.maximum(table.eval(*way), 0.0) for k, way in zip(known, ways, strict=True))
        count = known.sum(axis=0)
        return np.where(count > 0, total / np.maximum(count, 1), -1.0)

    write_function(both, path)
    return [
        "values between MERL's bins: theta_h is resolved to 0.01 degree at the peak and 2 degrees at 90",
        "differences between light and detector exchanged: MERL holds their mean",
        *common_losses(table, "MERL", keeps=("gaps", "peak")),
        *(
            ["negative values, colours outside the gamut: they are written as 0"]
            if table.values.min() < 0
            else []
        ),
        *(["nothing of the one channel: it is written as R, G and B"] if len(table.channels) == 1 else []),
        "provenance, ledger and the grid of the rows",
    ]


def _in_gap(table: Table, wi: Array, wo: Array) -> NDArray[np.bool_]:
    """Whether two directions are in a cell that nobody measured, of the row that is nearest."""
    if table.gaps is None:
        return np.zeros(len(wi), bool)
    theta_i, theta_r = (np.arccos(np.clip(w[:, 2], 0.0, 1.0)) for w in (wi, wo))
    delta_phi = np.arctan2(wi[:, 0] * wo[:, 1] - wi[:, 1] * wo[:, 0], np.sum(wi[:, :2] * wo[:, :2], axis=1))
    rows = table.theta_i_edges
    if rows is None:
        rows = np.concatenate([[0.0], 0.5 * (table.theta_i[1:] + table.theta_i[:-1]), [0.5 * np.pi]])
    edges = (rows, theta_i), (table.theta_r_edges, theta_r), (table.delta_phi_edges, np.abs(delta_phi))
    cells = (np.clip(np.searchsorted(e, x, "right") - 1, 0, len(e) - 2) for e, x in edges)
    return table.gaps[tuple(cells)]


def write_function(brdf: Callable[[Array, Array], Array], path: Path) -> None:
    """Write any BRDF on MERL's own grid: a file of 34 992 012 bytes.

    Parameters
    ----------
    brdf : callable
        From directions to light and detector, shape (N, 3) each, both above the horizon, to f in 1/sr, shape
        (N, 3) or (N, 1): R, G, B or grey; negative for no data.
    path : Path

    Raises
    ------
    OSError
        The file cannot be written.
    """
    wi, wo = bin_directions()
    above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
    stored = np.full((len(wi), 3), -1.0)
    stored[above] = brdf(wi[above], wo[above]) / FACTORS
    with atomic(path) as temporary, open(temporary, "wb") as file:
        np.array([N_THETA_H, N_THETA_D, N_PHI_D], "<i4").tofile(file)
        stored.T.astype("<f8").tofile(file)


def bin_directions() -> tuple[Array, Array]:
    """Directions to light and detector at the centres of all bins, in file order, shape (1458000, 3) each.

    Light or detector stand below the horizon in bins that no reflection can reach.
    """
    theta_h = 0.5 * np.pi * ((np.arange(N_THETA_H) + 0.5) / N_THETA_H) ** 2
    theta_d = 0.5 * np.pi * (np.arange(N_THETA_D) + 0.5) / N_THETA_D
    phi_d = np.pi * (np.arange(N_PHI_D) + 0.5) / N_PHI_D
    h, d, p = (a.ravel() for a in np.meshgrid(theta_h, theta_d, phi_d, indexing="ij"))
    x, y, z = np.sin(d) * np.cos(p), np.sin(d) * np.sin(p), np.cos(d)
    # The difference vector and its mirror image at the half vector, both turned by theta_h about y
    turned = [
        np.stack([np.cos(h) * a + np.sin(h) * z, b, np.cos(h) * z - np.sin(h) * a], axis=-1)
        for a, b in ((x, y), (-x, -y))
    ]
    return turned[0], turned[1]


def _read_bins(path: Path) -> Array:
    """Values in 1/sr, negative where there is no data, shape (theta_h, theta_d, phi_d, 3)."""
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    size = path.stat().st_size
    with open(path, "rb") as file:
        dims = tuple(int(n) for n in np.frombuffer(file.read(12).ljust(12, b"\0"), "<i4"))
        if dims[:2] != (N_THETA_H, N_THETA_D) or dims[2] not in (N_PHI_D, 2 * N_PHI_D):
            raise InputError(f"{path}: MERL dimensions {dims}; (90, 90, 180) or (90, 90, 360) is expected")
        n = int(np.prod(dims))
        if size != 12 + 24 * n:
            raise InputError(
                f"{path}: {size} bytes, {12 + 24 * n} are expected for dimensions {dims}; the file is "
                "truncated or not MERL, copy it again"
            )
        stored = np.fromfile(file, "<f8", 3 * n)
    if not np.all(np.isfinite(stored)):
        raise InputError(
            f"{path}: contains NaN or infinity; finite numbers, negative for no data, are expected"
        )
    return np.moveaxis(stored.reshape(3, *dims), 0, -1) * FACTORS


def _midpoints(edges: Array) -> Array:
    """`_POINTS` midpoints of equal parts of each interval, shape (intervals, _POINTS)."""
    inside = (np.arange(_POINTS) + 0.5) / _POINTS
    return edges[:-1, None] + inside * np.diff(edges)[:, None]


def _look_up(bins: Array, angles: tuple[Array, Array, Array]) -> Array:
    """MERL's nearest-bin look-up for delta phi and for -delta phi, shape (..., 2, 3)."""
    theta_h, theta_d, phi_d = angles
    n_phi = bins.shape[2]
    span = np.pi * n_phi / N_PHI_D  # 360 bins cover the full turn
    h = np.minimum((N_THETA_H * np.sqrt(theta_h / (0.5 * np.pi))).astype(int), N_THETA_H - 1)
    d = np.minimum((N_THETA_D * theta_d / (0.5 * np.pi)).astype(int), N_THETA_D - 1)
    first = (h * N_THETA_D + d) * n_phi
    flat = bins.reshape(-1, 3)
    both = [
        flat[first + np.minimum((n_phi / span * (phi % span)).astype(int), n_phi - 1)]
        for phi in (phi_d, -phi_d)
    ]
    return np.stack(both, axis=-2)
