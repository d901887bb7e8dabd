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
need not fit, as OpticStudio does with the same numbers in Zemax's format. Both reflectances are kept in the
provenance, under ``tis`` and ``integral``. All other values have no scale of their own: they are scaled to
the reflectance the file states.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import projected_solid_angles
from gonio.formats.cells import cells_around, check_size, table_of
from gonio.formats.grid import interpolate
from gonio.formats.text import angles, to_numbers
from gonio.table.parts import TRANSMISSION
from gonio.table.table import Table
from microgeometry.errors import InputError

Array = NDArray[np.float64]

_TITLES = {".brdf": "OPTIS - brdf surface file", ".anisotropicbsdf": "OPTIS - Anisotropic BSDF surface file"}


@dataclass(frozen=True)
class _Block:
    """One distribution: angles in radians, theta from the normal of its side, phi as delta phi."""

    theta: Array
    phi: Array
    values: Array  # (theta, phi)


@dataclass(frozen=True)
class _Side:
    """Reflection or transmission."""

    blocks: list[list[_Block]]  # [angle of incidence][wavelength]
    stated: (
        Array  # reflectance by angle of incidence and wavelength; one row where only the spectrum is known
    )
    reference: float  # the angle of incidence of that spectrum


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
    lines = _Lines(path)
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
    read_body = _anisotropic if anisotropic else _isotropic
    theta_i, wavelengths, sides = read_body(lines, names, lost)
    tables = _tabulate(path, theta_i, wavelengths, sides, is_f, not anisotropic)
    main = tables.get("reflection")
    if main is None:
        main = tables[TRANSMISSION].replace(
            values=0 * tables[TRANSMISSION].values,
            row_albedo=0 * tables[TRANSMISSION].row_albedo,
            gaps=np.ones(tables[TRANSMISSION].values.shape[:3], bool),
        )
    parts = {name: table.replace(provenance={}) for name, table in tables.items() if name == TRANSMISSION}
    return main.replace(parts=parts, provenance={**main.provenance, "lost": lost})


class _Lines:
    """The lines of a file, taken one after another."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.text = path.read_bytes().decode("latin-1").replace("\r\n", "\n")
        self.at = 0

    def line(self, what: str) -> str:
        """The next line."""
        if self.at >= len(self.text):
            raise InputError(f"{self.path}: ends where {what} is expected; copy it again")
        end = self.text.find("\n", self.at)
        end = len(self.text) if end < 0 else end
        found = self.text[self.at : end]
        self.at = end + 1
        return found

    def skip(self, n: int) -> None:
        """So many characters, and what is left of the last line."""
        if n < 0:
            raise InputError(f"{self.path}: a description of {n} characters; 0 or more are expected")
        self.at = min(len(self.text), self.at + n)
        self.line("the end of the description")

    def numbers(self, n: int, what: str) -> Array:
        """All numbers of the next line, n of them."""
        words = self.line(what).split()
        if len(words) != n:
            raise InputError(f"{self.path}: {len(words)} numbers of {what}; {n} are expected")
        return to_numbers(words, what, self.path)

    def counts(self, n: int, what: str) -> list[int]:
        """Numbers of things that can still follow in the file."""
        found = self.numbers(n, f"the number of {what}")
        for count in found:
            if not (1 <= count <= len(self.text) - self.at and count == int(count)):
                raise InputError(
                    f"{self.path}: {count:g} {what}; a whole number that the file can hold is expected"
                )
        return [int(count) for count in found]


def _isotropic(lines: _Lines, names: list[str], lost: list[str]) -> tuple[Array, Array, dict[str, _Side]]:
    n_incident, n_wavelengths = lines.counts(2, "angles of incidence and wavelengths")
    theta_i = angles(lines.numbers(n_incident, "angles of incidence"), "angles of incidence", lines.path, 90)
    wavelengths = lines.numbers(n_wavelengths, "wavelengths")
    sides = {}
    for name in names:
        stated = np.empty((n_incident, n_wavelengths))
        blocks: list[list[_Block]] = []
        for i in range(n_incident):
            blocks.append([])
            for w in range(n_wavelengths):
                stated[i, w] = lines.numbers(1, "a reflectance")[0] / 100
                blocks[i].append(_block(lines, name))
        sides[name] = _Side(blocks, stated, 0.0)
    return theta_i, wavelengths, sides


def _anisotropic(lines: _Lines, names: list[str], lost: list[str]) -> tuple[Array, Array, dict[str, _Side]]:
    lists, turns = [], {}
    for name in names:
        (n_turns,) = lines.counts(1, "anisotropy angles")
        lines.numbers(n_turns, "anisotropy angles")
        turns[name] = n_turns
        for _ in range(n_turns):
            (n,) = lines.counts(1, "angles of incidence")
            lists.append(lines.numbers(n, "angles of incidence"))
    if any(len(other) != len(lists[0]) or np.any(other != lists[0]) for other in lists):
        raise InputError(
            f"{lines.path}: angles of incidence that differ by side or anisotropy angle are not read"
        )
    theta_i = angles(lists[0], "angles of incidence", lines.path, 90)
    spectra, references = {}, {}
    for name in names:
        references[name] = np.radians(lines.numbers(2, "the direction of the spectrum")[0])
        lines.line("the comment of the spectrum")
        (n,) = lines.counts(1, "wavelengths")
        spectra[name] = np.array([lines.numbers(2, "a wavelength and its percentage") for _ in range(n)])
    wavelengths = spectra[names[0]][:, 0]
    if any(not np.array_equal(spectrum[:, 0], wavelengths) for spectrum in spectra.values()):
        raise InputError(
            f"{lines.path}: wavelengths that differ between reflection and transmission are not read"
        )
    if all(np.ptp(spectrum[:, 1]) == 0 for spectrum in spectra.values()):
        wavelengths = wavelengths[:0]
        spectra = {name: spectrum[:1] for name, spectrum in spectra.items()}
    sides = {}
    for name in names:
        rotations = [[_block(lines, name) for _ in theta_i] for _ in range(turns[name])]
        blocks = [[_mean([rotation[i] for rotation in rotations])] for i in range(len(theta_i))]
        sides[name] = _Side(blocks, spectra[name][None, :, 1] / 100, references[name])
        if turns[name] > 1:
            lost.append(f"{turns[name]} anisotropy angles of {name}: they are averaged")
    return theta_i, wavelengths, sides


def _block(lines: _Lines, name: str) -> _Block:
    n_theta, n_phi = lines.counts(2, "angles theta and phi")
    phi = lines.numbers(n_phi, "angles phi")
    theta, values = np.empty(n_theta), np.empty((n_theta, n_phi))
    for n in range(n_theta):
        row = lines.numbers(n_phi + 1, "an angle theta and its values")
        theta[n], values[n] = row[0], row[1:]
    if name == TRANSMISSION:
        theta, values = 180.0 - theta[::-1], values[::-1]
    theta = angles(theta, f"angles theta of {name}", lines.path, 90)
    angles(phi, "angles phi", lines.path, 360)
    # both signs of delta phi, and 0 and 360 degrees, are one
    delta, inverse = np.unique(np.round(np.abs(180.0 - phi), 9), return_inverse=True)
    to_delta = (inverse == np.arange(len(delta))[:, None]) / np.bincount(inverse)[:, None]
    return _Block(theta, np.radians(delta), values @ to_delta.T)


def _mean(blocks: list[_Block]) -> _Block:
    """Mean of several distributions on the angles of the first."""
    first = blocks[0]
    return _Block(
        first.theta, first.phi, np.mean([_on(b, first.theta, first.phi)[0] for b in blocks], axis=0)
    )


def _on(block: _Block, theta: Array, phi: Array) -> tuple[Array, NDArray[np.bool_]]:
    """A block's values at other angles, and which of them it covers."""
    t, p = (a.ravel() for a in np.meshgrid(theta, phi, indexing="ij"))
    values, inside = interpolate(block.values, block.theta, block.phi, t, p)
    shape = (len(theta), len(phi))
    return values.reshape(shape), inside.reshape(shape)


def _tabulate(
    path: Path, theta_i: Array, wavelengths: Array, sides: dict[str, _Side], is_f: bool, own_scale: bool
) -> dict[str, Table]:
    """A table for each side, all on the angles of the block that has most."""
    finest = max((b for s in sides.values() for row in s.blocks for b in row), key=lambda b: b.values.size)
    edges, theta_source = cells_around(finest.theta, np.pi / 2)
    phi_edges, phi_source = cells_around(finest.phi, np.pi)
    areas = projected_solid_angles(edges, phi_edges)
    n_channels = max(1, len(wavelengths))
    check_size(path, len(theta_i) * areas.size * n_channels * len(sides), "angles and wavelengths")
    unsampled = (theta_source < 0)[:, None] | (phi_source < 0)
    cosine = np.cos(finest.theta)[:, None]
    intensity = np.divide(1.0, cosine, out=np.zeros_like(cosine), where=cosine > 1e-6)
    names = tuple(f"{w:g} nm" for w in wavelengths) or ("Y",)
    tables = {}
    for name, side in sides.items():
        values = np.zeros((len(theta_i), *areas.shape, n_channels))
        gaps = np.broadcast_to(unsampled, values.shape[:3]).copy()
        for i, row in enumerate(side.blocks):
            for w in range(n_channels):
                found, inside = _on(row[min(w, len(row) - 1)], finest.theta, finest.phi)
                found = found if is_f else found * intensity
                values[i, :, :, w] = found[theta_source][:, phi_source]
                gaps[i] |= ~inside[theta_source][:, phi_source]
        values[gaps] = 0.0
        integral = np.einsum("irpc,rp->ic", values, areas)
        if not (is_f and own_scale):
            values *= _scale(path, side, theta_i, integral)
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
    return tables


def _scale(path: Path, side: _Side, theta_i: Array, integral: Array) -> Array:
    """Factor on the values, (angle of incidence, 1, 1, channel), that gives the reflectance stated."""
    known = integral
    if len(side.stated) != len(theta_i) or len(theta_i) == 1:
        # the spectrum was measured at one angle; between rows its integral is interpolated
        at = np.clip(side.reference, theta_i[0], theta_i[-1])
        known = np.array([[np.interp(at, theta_i, column) for column in integral.T]])
    if not np.all(known > 0):
        raise InputError(f"{path}: values that are 0 everywhere cannot be scaled to the reflectance stated")
    return np.broadcast_to(side.stated / known, integral.shape)[:, None, None, :]
