"""Ansys SPEOS (OPTIS) text files: `.brdf` and `.anisotropicbsdf`, version 8.0.

Header, by line: title with version; 0 for text; comment; number of characters of the description that
follows; the description; (anisotropic only) the anisotropy vector; whether there is reflection and
transmission; 1 if values are proportional to f, 0 if to intensity, f cos(theta).

A ``.brdf`` goes on with the numbers of angles of incidence and of wavelengths, their lists, and for
reflection and then transmission, each angle of incidence and wavelength a block that begins with its
reflectance in percent. An ``.anisotropicbsdf`` has lists of anisotropy angles and, for each, of angles of
incidence; then for each side the direction (theta, phi) at which its spectrum was measured, a comment, and
the spectrum in percent; then the blocks. A block: numbers of theta and phi, the list of phi, and rows of
theta and values.

Angles are from the normal: phi = 0 is the mirror direction, or straight through in transmission, where theta
runs from 90 to 180 degrees. So delta phi = pi - phi.

Values of a ``.brdf`` that are proportional to f are read as f; SPEOS scales them to the percentage, which
need not fit, as OpticStudio does with the same numbers in Zemax's format. All other values have no scale of their
own: they are scaled to the reflectance the file states. If that holds light that no sample does, they are too
bright: Ansys's converter gave each row of a measurement in Zemax's format the sum TIS, 1.03 to 1.18 times its own,
and so much brighter it is read here. Both reflectances are kept in the provenance, under ``tis`` and ``integral``
(of the values as they stand), and ``lost`` says by how much they differ.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import projected_solid_angles
from gonio.formats.cells import cells_around, check_size, table_of
from gonio.formats.grid import interpolate
from gonio.formats.losses import stated_reflectance
from gonio.formats.samples import Samples
from gonio.formats.speos_text import Block, Lines, Side, anisotropic_body, isotropic_body
from gonio.table.parts import TRANSMISSION
from gonio.table.table import Table
from microgeometry.errors import InputError

Array = NDArray[np.float64]

_TITLES = {".brdf": "OPTIS - brdf surface file", ".anisotropicbsdf": "OPTIS - Anisotropic BSDF surface file"}


def read(path: Path) -> Table:
    """Read a SPEOS file; cells are those around the file's own angles, both signs of delta phi averaged.

    Returns
    -------
    Table
        One channel per wavelength; one, Y, where a spectrum is the same at all. Transmission is a part; a
        file of transmission alone is a table of gaps with that part.

    Raises
    ------
    InputError
        Binary, encrypted, of another version, or damaged.
    """
    tables, _, lost = _read(path)
    main = tables.get("reflection")
    if main is None:
        main = tables[TRANSMISSION].replace(
            values=0 * tables[TRANSMISSION].values,
            row_albedo=0 * tables[TRANSMISSION].row_albedo,
            gaps=np.ones(tables[TRANSMISSION].values.shape[:3], bool),
        )
    parts = {name: table.replace(provenance={}) for name, table in tables.items() if name == TRANSMISSION}
    return main.replace(parts=parts, provenance={**main.provenance, "lost": lost})


def samples_of(path: Path) -> dict[str, Samples]:
    """The file's samples, scaled as in `read`, as `gonio.formats` has them; errors as `read`."""
    _, samples, _ = _read(path)
    return {"" if name == "reflection" else name: found for name, found in samples.items()}


def _read(path: Path) -> tuple[dict[str, Table], dict[str, Samples], list[str]]:
    """A table and the samples of each side, and what was lost."""
    lines = Lines(path)
    suffix = path.suffix.lower()
    anisotropic = suffix == ".anisotropicbsdf"
    title = lines.line("the title")
    if not title.startswith(_TITLES[suffix]):
        raise InputError(f"{path}: begins with {title[:40]!r}; {_TITLES[suffix]!r} is expected")
    if title.split()[-1] != "v8.0":
        raise InputError(f"{path}: version {title.split()[-1][:20]!r}; v8.0 is read; save it anew in SPEOS")
    if lines.line("the mode").strip() != "0":
        raise InputError(f"{path}: a binary SPEOS file; only text is read; save it as text")
    lines.line("the comment")
    lines.skip(int(lines.numbers(1, "the length of the description")[0]))
    if anisotropic:
        lines.numbers(3, "the anisotropy vector")
    flags = lines.numbers(2, "what there is")
    is_f = bool(lines.numbers(1, "the type of value")[0])
    names = [name for name, there in zip(("reflection", TRANSMISSION), flags, strict=True) if there]
    if not names:
        raise InputError(f"{path}: neither reflection nor transmission")
    lost: list[str] = []
    read_body = anisotropic_body if anisotropic else isotropic_body
    theta_i, wavelengths, sides = read_body(lines, names, lost)
    tables, samples = _tabulate(path, theta_i, wavelengths, sides, is_f, not anisotropic, lost)
    return tables, samples, lost


def _mean(blocks: list[Block]) -> Block:
    """Mean of several distributions on the angles of the first."""
    first = blocks[0]
    return Block(first.theta, first.phi, np.mean([_on(b, first.theta, first.phi)[0] for b in blocks], axis=0))


def _on(block: Block, theta: Array, phi: Array) -> tuple[Array, NDArray[np.bool_]]:
    """A block's values at other angles, and which of them it covers."""
    t, p = (a.ravel() for a in np.meshgrid(theta, phi, indexing="ij"))
    values, inside = interpolate(block.values, block.theta, block.phi, t, p)
    shape = (len(theta), len(phi))
    return values.reshape(shape), inside.reshape(shape)


def _tabulate(
    path: Path,
    theta_i: Array,
    wavelengths: Array,
    sides: dict[str, Side],
    is_f: bool,
    own_scale: bool,
    lost: list[str],
) -> tuple[dict[str, Table], dict[str, Samples]]:
    """A table for each side, all on the angles of the block that has most, and the samples in its scale."""
    blocks = (b for s in sides.values() for rows in s.turns for row in rows for b in row)
    finest = max(blocks, key=lambda b: b.values.size)
    edges, theta_source = cells_around(finest.theta, np.pi / 2)
    phi_edges, phi_source = cells_around(finest.phi, np.pi)
    areas = projected_solid_angles(edges, phi_edges)
    n_channels = max(1, len(wavelengths))
    check_size(path, len(theta_i) * areas.size * n_channels * len(sides), "angles and wavelengths")
    unsampled = (theta_source < 0)[:, None] | (phi_source < 0)
    names = tuple(f"{w:g} nm" for w in wavelengths) or ("Y",)
    tables, samples = {}, {}
    for name, side in sides.items():
        values = np.zeros((len(theta_i), *areas.shape, n_channels))
        gaps = np.broadcast_to(unsampled, values.shape[:3]).copy()
        for i, w in np.ndindex(len(theta_i), n_channels):
            block = _mean([rows[i][min(w, len(rows[i]) - 1)] for rows in side.turns])
            found, inside = _on(block, finest.theta, finest.phi)
            found = found if is_f else found * _per_cosine(finest.theta)
            values[i, :, :, w] = found[theta_source][:, phi_source]
            gaps[i] |= ~inside[theta_source][:, phi_source]
        values[gaps] = 0.0
        integral = np.einsum("irpc,rp->ic", values, areas)
        scale = np.ones((len(theta_i), 1, 1, n_channels))
        if is_f and own_scale:
            lost += stated_reflectance(side.stated, integral, f"the percentage of {name}", "SPEOS scales")
        else:
            scale = _scale(path, side, theta_i, integral)
            lost.append(
                f"the scale of the values of {name}, if they had one: times {_range(scale)} they add up to the "
                f"{_range(100 * side.stated)} % that the file states"
            )
        values *= scale
        samples[name] = Samples.joined(_side_samples(side, theta_i, scale, is_f))
        provenance = {
            "source": path.name,
            "format": "SPEOS",
            "tis": np.broadcast_to(side.stated, integral.shape).tolist()
            if own_scale
            else side.stated.tolist(),
            "integral": integral.tolist(),
        }
        tables[name] = table_of(
            values,
            gaps,
            theta_i,
            edges,
            phi_edges,
            names,
            wavelengths_nm=tuple(wavelengths.tolist()) or None,
            provenance=provenance,
        )
    return tables, samples


def _side_samples(side: Side, theta_i: Array, scale: Array, is_f: bool) -> Iterator[Samples]:
    """All blocks' samples as scaled; of each wavelength where that has blocks of its own."""
    n_channels = scale.shape[3]
    for rows in side.turns:
        for i, row in enumerate(rows):
            for w, block in enumerate(row):
                channels = np.arange(n_channels) if len(row) == 1 else np.array([w])
                f = block.values if is_f else block.values * _per_cosine(block.theta)
                values = np.full((*f.shape, n_channels), np.nan)
                values[..., channels] = f[..., None] * scale[i, 0, 0, channels]
                yield Samples.on_grid(theta_i[i], block.theta[:, None], block.phi, values)


def _per_cosine(theta: Array) -> Array:
    """From intensity to f, shape (theta, 1); 0 at the horizon."""
    cosine = np.cos(theta)[:, None]
    return np.divide(1.0, cosine, out=np.zeros_like(cosine), where=cosine > 1e-6)


def _range(numbers: Array) -> str:
    low, high = f"{numbers.min():.4g}", f"{numbers.max():.4g}"
    return low if low == high else f"{low} to {high}"


def _scale(path: Path, side: Side, theta_i: Array, integral: Array) -> Array:
    """Factor on the values, (angle of incidence, 1, 1, channel), that gives the reflectance stated."""
    known = integral
    if len(side.stated) != len(theta_i) or len(theta_i) == 1:
        # the spectrum was measured at one angle; between rows its integral is interpolated
        at = np.clip(side.reference, theta_i[0], theta_i[-1])
        known = np.array([[np.interp(at, theta_i, column) for column in integral.T]])
    if not np.all(known > 0):
        raise InputError(f"{path}: values that are 0 everywhere cannot be scaled to the reflectance stated")
    return np.broadcast_to(side.stated / known, integral.shape)[:, None, None, :]
