"""The text of SPEOS files, block by block; what stands where is said in `gonio.formats.speos`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.formats.text import angles, content, to_numbers
from gonio.table.parts import TRANSMISSION
from microgeometry.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Block:
    """One distribution: angles in radians, theta from the normal of its side, phi as delta phi."""

    theta: Array
    phi: Array
    values: Array  # (theta, phi)


@dataclass(frozen=True)
class Side:
    """Reflection or transmission."""

    turns: list[list[list[Block]]]  # [anisotropy angle][angle of incidence][wavelength]
    stated: (
        Array  # reflectance by angle of incidence and wavelength; one row where only the spectrum is known
    )
    reference: float  # the angle of incidence of that spectrum


class Lines:
    """The lines of a file, taken one after another."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.text = content(path).decode("latin-1").replace("\r\n", "\n")
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


def isotropic_body(lines: Lines, names: list[str], lost: list[str]) -> tuple[Array, Array, dict[str, Side]]:
    """What follows the type of value in a ``.brdf``: angles of incidence, wavelengths in nm, and the sides."""
    n_incident, n_wavelengths = lines.counts(2, "angles of incidence and wavelengths")
    theta_i = angles(lines.numbers(n_incident, "angles of incidence"), "angles of incidence", lines.path, 90)
    wavelengths = lines.numbers(n_wavelengths, "wavelengths")
    sides = {}
    for name in names:
        stated = np.empty((n_incident, n_wavelengths))
        blocks: list[list[Block]] = []
        for i in range(n_incident):
            blocks.append([])
            for w in range(n_wavelengths):
                stated[i, w] = lines.numbers(1, "a reflectance")[0] / 100
                blocks[i].append(_block(lines, name))
        sides[name] = Side([blocks], stated, 0.0)
    return theta_i, wavelengths, sides


def anisotropic_body(lines: Lines, names: list[str], lost: list[str]) -> tuple[Array, Array, dict[str, Side]]:
    """The same of an ``.anisotropicbsdf``; no wavelengths where the spectrum is the same at all.

    `lost` is told of rotations that will be averaged.
    """
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
        rotations = [[[_block(lines, name)] for _ in theta_i] for _ in range(turns[name])]
        sides[name] = Side(rotations, spectra[name][None, :, 1] / 100, references[name])
        if turns[name] > 1:
            lost.append(f"{turns[name]} anisotropy angles of {name}: they are averaged")
    return theta_i, wavelengths, sides


def _block(lines: Lines, name: str) -> Block:
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
    return Block(theta, np.radians(delta), values @ to_delta.T)
