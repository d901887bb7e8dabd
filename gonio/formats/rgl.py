"""RGL tensor files `.bsdf` (Dupuy & Jakob 2018), isotropic, RGB and spectral; what Mitsuba's `measured` loads.

The file holds f cos(theta_o) in coordinates adapted to the lobe. With m the half vector, u(theta, phi) =
(sqrt(2 theta/pi), (phi + pi)/(2 pi)), and azimuths counted from the light's::

    s = vndf(theta_i).invert(u(m)),  f cos(theta_o) = spectra(theta_i, s) ndf(u(m)) / (4 sigma(u(wi)))

theta_i is the light's, linear between the angles of the file; arrays have theta on their last axis. A file
written here has its own ndf: an estimate from the table, since any positive one will do; the spectra make up
for the difference. In the renderers that read these files phi_m - phi_i runs over the full circle; both
signs are averaged in reading.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import direction
from gonio.formats.cells import average_cells, row_centres, table_of, uniform_grid
from gonio.formats.losses import common_losses
from gonio.formats.tensor_file import read_tensors, write_tensors
from gonio.formats.warp import Warp, bilinear
from gonio.table.table import Table
from microgeometry.errors import InputError

Array = NDArray[np.float64]

_N_THETA_I = 19
_VNDF = 128
_NODES = 64  # of the spectra; 32 as in RGL's own files leave twice the error
_EVEN = 0.7  # share of the normals spread evenly over sqrt(theta)
_POLE = np.radians(2.0)  # down to about this theta
_RGB = ("R", "G", "B")


def read(path: Path) -> Table:
    """Read an isotropic RGL file onto cells of 1 degree, or coarser ones where wavelengths are many or nodes few.

    Returns
    -------
    Table
        Rows that are cells of incidence; channels R, G, B or wavelengths. No error bars, and no gaps: RGL has
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

    def look(row: int, theta_o: Array, phi: Array) -> tuple[Array, NDArray[np.bool_]]:
        values = _evaluate(fields, float(rows[row]), theta_o, phi)
        return (values / np.cos(theta_o)).T, np.ones(len(phi), bool)

    values, gaps = average_cells(look, n, edges, phi_edges, n_channels)
    wavelengths = fields.get("wavelengths")
    names = _RGB if wavelengths is None else tuple(f"{w:g} nm" for w in wavelengths)
    description = bytes(fields["description"].astype(np.uint8)).decode("utf-8", "replace")
    return table_of(
        values,
        gaps,
        0.5 * (edges[1:] + edges[:-1]),
        edges,
        phi_edges,
        names,
        theta_i_edges=edges,
        wavelengths_nm=None if wavelengths is None else tuple(wavelengths.tolist()),
        provenance={"source": path.name, "format": "RGL", "description": description},
    )


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
        Channels that are neither colours nor wavelengths, or a table that reflects nothing.
    OSError
        The file cannot be written.
    """
    n_channels = len(table.channels)
    if table.wavelengths_nm is None and n_channels not in (1, 3):
        raise InputError(
            f"{path}: an RGL file holds R, G and B or wavelengths, the table has {n_channels} channels "
            f"{table.channels}; select or convert to three first"
        )
    if table.wavelengths_nm is not None and not np.all(np.diff(table.wavelengths_nm) > 0):
        order = np.argsort(table.wavelengths_nm)
        table = _select(table, order)
    if not np.any(table.row_albedo - table.specular > 0):
        raise InputError(
            f"{path}: the table reflects nothing but its delta term; an RGL file cannot hold that"
        )
    fields = _tensors(table)
    write_tensors(path, fields)
    losses = common_losses(table, "RGL", keeps=("wavelengths",))
    if n_channels == 1 and table.wavelengths_nm is None:
        losses.append("nothing of the one channel: it is written as R, G and B")
    losses.append(f"rows of incidence other than {_N_THETA_I} from 0 to 90 degrees: they are interpolated")
    return [*losses, "provenance, ledger and the grid of the rows"]


def _select(table: Table, order: NDArray[np.int64]) -> Table:
    """The table with its channels in another order."""
    assert table.wavelengths_nm is not None
    return Table(
        values=table.values[..., order],
        theta_i=table.theta_i,
        theta_i_edges=table.theta_i_edges,
        theta_r_edges=table.theta_r_edges,
        delta_phi_edges=table.delta_phi_edges,
        channels=tuple(table.channels[n] for n in order),
        row_albedo=table.row_albedo[:, order],
        specular=table.specular[:, order],
        wavelengths_nm=tuple(table.wavelengths_nm[n] for n in order),
        std_error=None if table.std_error is None else table.std_error[..., order],
        gaps=table.gaps,
        provenance=table.provenance,
    )


# --- the mapping ---------------------------------------------------------------------------------------


def _to_unit(theta: Array, phi: Array) -> tuple[Array, Array]:
    return np.sqrt(theta * (2 / np.pi)), (phi + np.pi) / (2 * np.pi) % 1.0


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
    x, y = _to_unit(theta_m, phi_m)
    values = bilinear(spectra, *warp.invert(x, y))
    if not fields["jacobian"]:
        return values
    x_i, y_i = _to_unit(np.array([theta_i]), np.zeros(1))
    return values * bilinear(fields["ndf"], x, y) / (4 * bilinear(fields["sigma"], x_i, y_i))


def _tensors(table: Table) -> dict[str, NDArray]:
    """All fields of a file."""
    u = np.linspace(0, 1, _VNDF)
    theta = 0.5 * np.pi * u**2
    ndf = _normals(table, theta)
    theta_i = np.linspace(0, np.pi / 2, _N_THETA_I)
    sigma = _projected_area(theta, ndf)
    phi = np.linspace(-np.pi, np.pi, _VNDF)
    m = direction(theta[None, :], phi[:, None])
    jacobian = 2 * np.pi**2 * u * np.sin(theta)
    n_channels = len(table.channels)
    vndf = np.empty((_N_THETA_I, _VNDF, _VNDF), np.float32)
    spectra = np.empty((_N_THETA_I, n_channels, _NODES, _NODES), np.float32)
    s = np.linspace(0, 1, _NODES)
    sy, sx = (a.ravel() for a in np.meshgrid(s, s, indexing="ij"))
    two_rows = np.stack([ndf, ndf]).astype(np.float32)
    areas = np.stack([sigma, sigma]).astype(np.float32)
    for n, angle in enumerate(theta_i):
        wi = direction(angle)
        density = ndf * np.maximum(m @ wi, 0) * jacobian
        vndf[n] = density / density.max()
        x, y = Warp(vndf[n].astype(float)).sample(sx, sy)
        normal = direction(0.5 * np.pi * x**2, 2 * np.pi * y - np.pi)
        wo = 2 * (normal @ wi)[:, None] * normal - wi
        cosine = np.maximum(wo[:, 2], 0.0)
        # the renderer divides by what it interpolates, so do we
        x_i, y_i = _to_unit(np.array([angle]), np.zeros(1))
        factor = 4 * bilinear(areas.astype(float), x_i, y_i) / bilinear(two_rows.astype(float), x, y)
        f = table.eval(wi, wo)
        spectra[n] = (f * (cosine * factor)[:, None]).T.reshape(n_channels, _NODES, _NODES)
    luminance = spectra.mean(axis=1)
    luminance += 1e-3 * luminance.max(axis=(1, 2), keepdims=True) + np.finfo(np.float32).tiny
    fields: dict[str, NDArray] = {
        "description": np.frombuffer(b"BRDF table converted by gonio", np.uint8),
        "phi_i": np.zeros(1, np.float32),
        "theta_i": theta_i.astype(np.float32),
        "ndf": two_rows,
        "sigma": areas,
        "vndf": vndf[None],
        "luminance": luminance[None],
        "jacobian": np.ones(1, np.uint8),
    }
    if table.wavelengths_nm is not None:
        fields["wavelengths"] = np.array(table.wavelengths_nm, np.float32)
        fields["spectra"] = spectra[None]
    else:
        fields["rgb"] = np.ascontiguousarray(np.broadcast_to(spectra, (_N_THETA_I, 3, _NODES, _NODES)))[None]
    return fields


def _normals(table: Table, theta: Array) -> Array:
    """A distribution of normals at angles theta, positive, from the table.

    The mean of 4 cos(theta_i) cos(theta_r) f over the cells whose half vector is theta away from the normal:
    the distribution itself for facets without shadowing and Fresnel's dimming. A share of its mass is
    spread evenly over the coordinate sqrt(theta), so that nodes are dense at the normal and nowhere lacking.
    """
    mean = np.maximum(table.values.mean(axis=-1), 0.0)
    wi = direction(table.theta_i)[:, None, None]
    wo = direction(table.theta_r[:, None], table.delta_phi)[None]
    half = wi + wo
    theta_h = np.arctan2(np.hypot(half[..., 0], half[..., 1]), half[..., 2])
    weight = wi[..., 2] * table.projected_solid_angles * np.sin(table.theta_i)[:, None, None]
    known = 1.0 if table.gaps is None else ~table.gaps
    weight = weight * known + np.zeros_like(mean)
    edges = 0.5 * np.pi * np.linspace(0, 1, 65) ** 2
    index = np.clip(np.searchsorted(edges, theta_h.ravel(), "right") - 1, 0, 63)
    total = np.bincount(index, (weight * mean * 4 * wi[..., 2] * wo[..., 2]).ravel(), 64)
    count = np.bincount(index, weight.ravel(), 64)
    seen = count > 0
    centres = 0.5 * (edges[1:] + edges[:-1])
    estimate = np.interp(theta, centres[seen], total[seen] / count[seen])
    even = (theta**2 + _POLE**2) ** -0.75
    area = np.sin(2 * theta) * np.pi
    return (1 - _EVEN) * estimate / np.trapezoid(estimate * area, theta) + _EVEN * even / np.trapezoid(
        even * area, theta
    )


def _projected_area(theta: Array, ndf: Array) -> Array:
    """sigma(theta): integral of ndf max(0, wi.m) over the hemisphere of normals."""
    phi = (np.arange(256) + 0.5) * (2 * np.pi / 256)
    weights = np.zeros_like(theta)
    weights[:-1] += 0.5 * np.diff(theta)
    weights[1:] += 0.5 * np.diff(theta)
    m = direction(theta[:, None], phi)
    visible = np.maximum(np.einsum("tpk,ik->itp", m, direction(theta)), 0).mean(axis=2) * 2 * np.pi
    return visible @ (ndf * np.sin(theta) * weights)


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
