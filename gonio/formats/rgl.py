"""RGL tensor files `.bsdf` (Dupuy & Jakob 2018), isotropic, RGB and spectral; what Mitsuba's `measured` loads.

The file holds f cos(theta_o) in coordinates adapted to the lobe. With m the half vector, u(theta, phi) =
(sqrt(2 theta/pi), (phi + pi)/(2 pi)), and azimuths counted from the light's::

    s = vndf(theta_i).invert(u(m)),  f cos(theta_o) = spectra(theta_i, s) ndf(u(m)) / (4 sigma(u(wi)))

theta_i is the light's, linear between the angles of the file; arrays have theta on their last axis. A file
written here has its own ndf: an estimate from the table, since any positive one will do; the spectra make up
for the difference. In the renderers that read these files phi_m - phi_i runs over the full circle; both
signs are averaged in reading.

Measured files are not reciprocal: at 90 degrees of azimuth chm_light_blue has f(20, 60) = 0.0089 and f(60, 20) =
0.0045. Mitsuba, which follows light from the camera, puts the camera where theta_i is. So its pictures of such a file
are those of the table with light and detector exchanged; under light from everywhere they are the same.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import direction
from gonio.formats.cells import average_cells, row_centres, table_of, uniform_grid
from gonio.formats.colour import RGB_TO_XYZ, as_colour, reordered
from gonio.formats.highlights import Brdf, resolved
from gonio.formats.losses import common_losses
from gonio.formats.rgl_tensors import N_THETA_I, tensors_of, to_unit
from gonio.formats.tensor_file import read_tensors, write_tensors
from gonio.formats.warp import Warp, bilinear
from gonio.table.table import Table
from microgeometry.errors import InputError

Array = NDArray[np.float64]

_RGB = ("R", "G", "B")


def read(path: Path) -> Table:
    """Read an isotropic RGL file onto cells of 1 degree, or coarser ones where wavelengths are many or nodes few.

    Returns
    -------
    Table
        Rows that are cells of incidence; channels R, G, B or wavelengths; a grid of its own for a highlight that
        is narrower than three cells. No error bars, and no gaps: RGL has
        extrapolated what was not measured, and the marks of its field ``valid`` contradict each other
        between files. Colours outside of sRGB are negative in a channel, as in the file.

    Raises
    ------
    InputError
        Damaged, anisotropic, or a field that is missing, of a wrong shape, negative or not finite.
    """
    fields = _check(read_tensors(path), path)
    spectra = fields["spectra"]
    n_channels = spectra.shape[1]
    n = uniform_grid(path, n_channels, max(spectra.shape[-2:] + fields["vndf"].shape[-2:]))
    edges, phi_edges = np.linspace(0, np.pi / 2, n + 1), np.linspace(0, np.pi, 2 * n + 1)
    rows = row_centres(edges)

    brdf = _brdf(fields)

    def look(row: int, theta_o: Array, phi: Array) -> tuple[Array, NDArray[np.bool_]]:
        return brdf(float(rows[row]), theta_o, phi), np.ones(len(phi), bool)

    values, gaps = average_cells(look, n, edges, phi_edges, n_channels)
    wavelengths = fields.get("wavelengths")
    names = _RGB if wavelengths is None else tuple(f"{w:g} nm" for w in wavelengths)
    # outside the gamut of sRGB a channel is below 0; the luminance is what must not be
    colour = {"colour": {"luminance": RGB_TO_XYZ[1].tolist()}} if wavelengths is None else {}
    description = bytes(fields["description"].astype(np.uint8)).decode("utf-8", "replace")
    table = table_of(
        values,
        gaps,
        0.5 * (edges[1:] + edges[:-1]),
        edges,
        phi_edges,
        names,
        theta_i_edges=edges,
        wavelengths_nm=None if wavelengths is None else tuple(wavelengths.tolist()),
        provenance={"source": path.name, "format": "RGL", "description": description, **colour},
    )
    return resolved(table, brdf)


def brdf_of(path: Path) -> Brdf:
    """What a file gives between the cells that `read` averages over; errors as there."""
    return _brdf(_check(read_tensors(path), path))


def _brdf(fields: dict[str, Array]) -> Brdf:
    return lambda theta_i, theta_o, phi: (_evaluate(fields, theta_i, theta_o, phi) / np.cos(theta_o)).T


def write(table: Table, path: Path) -> list[str]:
    """Write a table's interpolated values as an RGL file.

    Parameters
    ----------
    table : Table
        With wavelengths: a spectral file. Without: three channels, taken as R, G, B, or one, written
        three times.
    path : Path

    Returns
    -------
    list of str
        What was lost.

    Raises
    ------
    InputError
        Channels that are neither colours nor wavelengths, a wavelength twice, or a table that reflects nothing.
    OSError
        The file cannot be written.
    """
    if table.wavelengths_nm is None:
        table = as_colour(table, path, "an RGL file without wavelengths")
    if table.wavelengths_nm is not None:
        table = reordered(table, np.argsort(table.wavelengths_nm, kind="stable"))
        wavelengths = np.array(table.wavelengths_nm, np.float32)
        same = np.diff(wavelengths) <= 0
        if same.any():
            raise InputError(
                f"{path}: two channels of {wavelengths[:-1][same][0]:g} nm; an RGL file holds each wavelength once"
            )
    if not np.any(table.row_albedo - table.specular > 0):
        raise InputError(
            f"{path}: the table reflects nothing but its delta term; an RGL file cannot hold that"
        )
    fields = tensors_of(table)
    write_tensors(path, fields)
    losses = common_losses(table, "RGL", keeps=("wavelengths", "peak"))
    if len(table.channels) == 1 and table.wavelengths_nm is None:
        losses.append("nothing of the one channel: it is written as R, G and B")
    losses.append(f"rows of incidence other than {N_THETA_I} from 0 to 90 degrees: they are interpolated")
    return [*losses, "provenance, ledger and the grid of the rows"]


# --- the mapping ---------------------------------------------------------------------------------------


def _between(angles: Array, theta: float) -> tuple[int, int, float]:
    """The two angles that enclose theta, and the weight of the second."""
    if len(angles) == 1:
        return 0, 0, 0.0
    high = int(np.clip(np.searchsorted(angles, theta), 1, len(angles) - 1))
    weight = (theta - angles[high - 1]) / (angles[high] - angles[high - 1])
    return high - 1, high, float(np.clip(weight, 0, 1))


def _evaluate(fields: dict[str, Array], theta_i: float, theta_o: Array, phi: Array) -> Array:
    """Value f cos(theta_o) for light at azimuth 0, shape (C, N)."""
    a, b, w = _between(fields["theta_i"], theta_i)
    # the map is linear in the density, each slice normalised by itself
    warp = Warp((1 - w) * Warp(fields["vndf"][a]).density + w * Warp(fields["vndf"][b]).density)
    spectra = (1 - w) * fields["spectra"][a] + w * fields["spectra"][b]
    half = direction(np.full_like(theta_o, theta_i)) + direction(theta_o, phi)
    across = np.hypot(half[:, 0], half[:, 1])
    theta_m, phi_m = np.arctan2(across, half[:, 2]), np.arctan2(half[:, 1], half[:, 0])
    x, y = to_unit(theta_m, phi_m)
    values = bilinear(spectra, *warp.invert(x, y))
    if not fields["jacobian"]:
        return values
    x_i, y_i = to_unit(np.array([theta_i]), np.zeros(1))
    return values * bilinear(fields["ndf"], x, y) / (4 * bilinear(fields["sigma"], x_i, y_i))


# --- reading -------------------------------------------------------------------------------------------


def _check(tensors: dict[str, NDArray], path: Path) -> dict[str, Array]:
    """The fields used, checked and as float64, without the axis of phi_i."""

    def field(name: str, n_dimensions: int) -> Array:
        if name not in tensors:
            raise InputError(f"{path}: field {name!r} is missing; is it an RGL BRDF?")
        array = tensors[name]
        if array.ndim != n_dimensions:
            raise InputError(
                f"{path}: field {name!r} has shape {array.shape}; {n_dimensions} axes are expected"
            )
        array = array.astype(float)
        if not np.all(np.isfinite(array)):
            raise InputError(f"{path}: field {name!r} holds NaN or infinity; copy it again")
        # values of measured colours may be negative: noise, and spectra outside of sRGB
        if name not in ("rgb", "spectra") and array.min() < 0:
            raise InputError(f"{path}: field {name!r} holds negative numbers; copy it again")
        return array

    if "phi_i" not in tensors or tensors["phi_i"].ndim != 1:
        raise InputError(f"{path}: field 'phi_i' is missing or no list; is it an RGL BRDF?")
    if tensors["phi_i"].size > 2:
        raise InputError(
            f"{path}: anisotropic, {tensors['phi_i'].size} angles phi_i; only isotropic RGL files (at most 2) are read"
        )
    theta_i, vndf = field("theta_i", 1), field("vndf", 4)
    found = {"theta_i": theta_i, "ndf": field("ndf", 2), "sigma": field("sigma", 2)}
    if "wavelengths" in tensors and "spectra" in tensors:
        found["wavelengths"] = field("wavelengths", 1)
        spectra = field("spectra", 5)
        channels = len(found["wavelengths"])
        if not np.all(np.diff(found["wavelengths"]) > 0) or found["wavelengths"][0] <= 0:
            raise InputError(f"{path}: field 'wavelengths' must be positive and increase")
    else:
        spectra, channels = field("rgb", 5), 3
    leading = (tensors["phi_i"].size, len(theta_i))
    expected = {"vndf": (vndf.shape[:2], leading), "spectra": (spectra.shape[:3], (*leading, channels))}
    for name, (shape, want) in expected.items():
        if shape != want:
            raise InputError(f"{path}: field {name!r} begins with shape {shape}; {want} is expected")
    if not np.all(np.diff(theta_i) > 0) or theta_i[-1] > np.pi / 2 + 1e-3:
        raise InputError(f"{path}: field 'theta_i' must increase within 0 to pi/2 radians")
    grids = (vndf, spectra, found["ndf"], found["sigma"])
    if min(min(grid.shape[-2:]) for grid in grids) < 2:
        raise InputError(f"{path}: a grid with a single node on an axis; at least 2 are expected")
    # with two azimuths of the light an isotropic file repeats itself
    found["vndf"], found["spectra"] = vndf.mean(axis=0), spectra.mean(axis=0)
    if found["vndf"].sum(axis=(1, 2)).min() <= 0 or found["sigma"].min() <= 0:
        raise InputError(f"{path}: a vndf that is 0 everywhere, or a sigma of 0, cannot be inverted")
    found["description"] = np.ravel(tensors.get("description", np.zeros(0)))[:1000]
    found["jacobian"] = np.array(bool(np.any(tensors.get("jacobian", np.ones(1)))))
    return found
