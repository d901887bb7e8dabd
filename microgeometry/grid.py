"""What is to be measured on a specimen: its channels, the wavelengths traced for them, and its angles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from microgeometry.colour import ILLUMINANTS, rgb_luminance, rgb_matrix
from microgeometry.keys import Keys

CIE_RANGE_NM = (405.0, 705.0)
"""First and last wavelength traced for "rgb"; they stand for what lies beyond them, too."""


@dataclass(frozen=True)
class Grid:
    """Channels and angles of the table to be measured.

    Keys of [grid], all optional:

    - ``wavelengths_nm``, a list, one channel each; or ``channels``, "rgb" or "grey". With neither: "rgb" if
      a material depends on wavelength (optical constants by name or from a file, films, or a list of three
      values), else "grey", one channel without a wavelength.
    - "rgb" of numbers, as in ``albedo = [0.8, 0.5, 0.2]``, is three channels that mean what the numbers
      mean. "rgb" of spectra is linear sRGB: wavelengths from 405 to 705 nm every ``wavelength_step_nm`` (15)
      are traced together and summed by the CIE 1931 2-degree observer under ``illuminant``: "D65" (default),
      "A" or "E". A perfect white is (1, 1, 1) under any of them; a colour outside sRGB's gamut has a
      component below 0 (see `microgeometry.colour`). Films of more than a micrometre want a finer step: see
      Notes.
    - ``theta_i_deg``: the rows to measure, increasing, 0 <= theta_i < 90; if absent, theta_i is binned
      like theta_r. ``theta_step_deg`` (1) divides 90, ``phi_step_deg`` (1) divides 180.
    - ``orders`` (1): with K > 1 there are also tables of the light after exactly 1, 2, ..., K - 1 bounces
      and after K or more.

    Attributes
    ----------
    wavelengths_nm : tuple of float or None
        One per channel, nanometres; None for "grey" and "rgb".
    channels : tuple of str
        Names of the C channels: ("R", "G", "B"), ("grey",), or the wavelengths as in "630 nm".
    theta_i_deg : tuple of float or None
        Degrees.
    theta_step_deg, phi_step_deg : float
        Width of the cells in theta and in delta phi, degrees.
    samples_nm : tuple of float or None
        The S wavelengths traced along one path, nanometres; None if the samples have no wavelength.
    to_channels : tuple of tuple of float, or None
        Matrix (C, S), channels = matrix @ samples; each row sums to 1. None where the channels are the samples.
    orders : int
        K.
    luminance : tuple of float, or None
        Weights of the channels in the luminance Y, where `to_channels` leads to sRGB.

    Notes
    -----
    Largest error of R, G or B at normal incidence under D65, against wavelengths every nanometre from 380 to
    780 nm (under "A" up to twice as large; the last column is limited by what is cut off at the ends):

    ====  ==  ======  ======  ==========  ============  ===========  ===========
    step   S  Au      Cu      Ag, Al, Cr  300 nm SiO2   1 um SiO2    2 um SiO2
                                          on Si         on Si        on Si
    ====  ==  ======  ======  ==========  ============  ===========  ===========
    20    16  2.2e-3  3.2e-3  3e-4        2.1e-3        6.1e-3       7.3e-3
    15    21  1.3e-3  1.2e-3  1.4e-4      1.2e-3        3.7e-3       8.5e-3
    10    31  6.5e-4  5.6e-4  8e-5        3.9e-4        2.1e-3       1.3e-3
    5     61  1.1e-4  1.2e-4  2e-5        8e-5          8e-4         1.0e-3
    ====  ==  ======  ======  ==========  ============  ===========  ===========
    """

    wavelengths_nm: tuple[float, ...] | None
    channels: tuple[str, ...]
    theta_i_deg: tuple[float, ...] | None = None
    theta_step_deg: float = 1.0
    phi_step_deg: float = 1.0
    samples_nm: tuple[float, ...] | None = None
    to_channels: tuple[tuple[float, ...], ...] | None = None
    orders: int = 1
    luminance: tuple[float, ...] | None = None

    @property
    def n_samples(self) -> int:
        """S, the number of spectral samples: of values in every optical quantity of the specimen."""
        return len(self.channels) if self.samples_nm is None else len(self.samples_nm)

    @classmethod
    def from_keys(cls, keys: Keys, optics: Iterable[Mapping[str, Any]]) -> Grid:
        """Build from the [grid] table.

        Parameters
        ----------
        keys : Keys
        optics : iterable of Mapping
            The tables of all materials, films and media: whether they hold spectra decides what "rgb" means.
        """
        keys.allow(
            "wavelengths_nm", "channels", "wavelength_step_nm", "illuminant",
            "theta_i_deg", "theta_step_deg", "phi_step_deg", "orders",
        )  # fmt: skip
        theta_i = None
        if "theta_i_deg" in keys:
            theta_i = keys.numbers("theta_i_deg", at_least=0, below=90)
            if any(b <= a for a, b in pairwise(theta_i)):
                raise keys.error("theta_i_deg", "must increase from angle to angle; sort them, each once")
        wavelengths, channels, samples, matrix = _channels(keys, list(optics))
        luminance = None if matrix is None else rgb_luminance(_illuminant(keys))
        return cls(
            wavelengths,
            channels,
            theta_i,
            _step(keys, "theta_step_deg", 1.0, 90, "degrees"),
            _step(keys, "phi_step_deg", 1.0, 180, "degrees"),
            samples,
            matrix,
            keys.integer("orders", 1, at_least=1, at_most=16),
            None if luminance is None else tuple(luminance.tolist()),
        )


_Channels = tuple[
    tuple[float, ...] | None, tuple[str, ...], tuple[float, ...] | None, tuple[tuple[float, ...], ...] | None
]


def _channels(keys: Keys, optics: list[Mapping[str, Any]]) -> _Channels:
    """Wavelengths, names, samples and matrix."""
    spectral = any(_is_spectral(table) for table in optics)
    three = any(_is_list_of_three(value) for table in optics for value in table.values())
    if "wavelengths_nm" in keys:
        if "channels" in keys:
            raise keys.error("channels", "give channels or wavelengths_nm, not both")
        wavelengths = keys.numbers("wavelengths_nm", above=0)
        channels = tuple(f"{w:.10g} nm" for w in wavelengths)
        if len(set(channels)) < len(channels):
            raise keys.error("wavelengths_nm", "the same wavelength stands there twice; give each once")
        chosen: _Channels = (wavelengths, channels, wavelengths, None)
    elif keys.choice("channels", "rgb" if spectral or three else "grey", ("rgb", "grey")) == "grey":
        chosen = (None, ("grey",), None, None)
    elif not spectral:
        chosen = (None, ("R", "G", "B"), None, None)
    else:
        first, last = CIE_RANGE_NM
        step = _step(keys, "wavelength_step_nm", 15.0, last - first, "nm")
        samples = np.linspace(first, last, 1 + round((last - first) / step))
        matrix = rgb_matrix(samples, _illuminant(keys))
        rows = tuple(tuple(row) for row in matrix.tolist())
        return None, ("R", "G", "B"), tuple(samples.tolist()), rows
    for key in ("wavelength_step_nm", "illuminant"):
        if key in keys:
            raise keys.error(
                key,
                'only for channels = "rgb" with spectra (optical constants by name or from a file, or '
                "films); leave it out",
            )
    return chosen


def _illuminant(keys: Keys) -> str:
    return keys.choice("illuminant", "D65", ILLUMINANTS)


def _is_spectral(table: Mapping[str, Any]) -> bool:
    """Whether a table of a material or film has something to say at any wavelength."""
    if table.get("kind") == "coated":  # interference, even of films with a constant index
        return True
    return "name" in table or ("file" in table and table.get("kind") != "table" and "phase" not in table)


def _is_list_of_three(value: Any) -> bool:
    # A list of one is as good as a number; a list of another length is an error of the material's.
    return len(value) == 3 if isinstance(value, list | tuple) else getattr(value, "shape", None) == (3,)


def _step(keys: Keys, key: str, default: float, whole: float, unit: str) -> float:
    step = keys.number(key, default, at_least=0.01 if unit == "degrees" else 1, at_most=whole)
    n = round(whole / step)
    if abs(n * step - whole) > 1e-9 * whole:
        raise keys.error(key, f"must divide {whole:g} {unit} evenly, as {whole / n:.10g} does")
    return whole / n
