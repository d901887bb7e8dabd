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

ANISOTROPIC_THETA_I_DEG = (0, 10, 20, 30, 40, 50, 57, 63, 68, 72, 76, 79, 82, 84, 86, 87.5, 89)
"""Rows of an anisotropic table, unless it is said which: closer where shadows grow."""


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
    - ``anisotropic = true``: a table over phi_i as well, which counts from the specimen's x axis. Its rows are
      exactly ``theta_i_deg`` (default: 17 angles from 0 to 89) times every ``phi_i_step_deg`` (10, divides 360), and
      its cells ``tilt_cells`` (65, odd) to either side of the tilts of the half vector, as fine as the slopes are
      narrow (see `gonio.table.tilts`); the steps above have no meaning then.
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
    anisotropic : bool
    phi_i_step_deg : float
        Between the azimuths of incidence of an anisotropic table, degrees.
    tilt_cells : int
        Cells of an anisotropic table along each of the two tilts.
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
    anisotropic: bool = False
    phi_i_step_deg: float = 10.0
    tilt_cells: int = 65

    @property
    def n_rows(self) -> int:
        """Rows of incidence of the table."""
        if self.theta_i_deg is None:
            return round(90 / self.theta_step_deg)
        return len(self.theta_i_deg) * (round(360 / self.phi_i_step_deg) if self.anisotropic else 1)

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
            "anisotropic", "phi_i_step_deg", "tilt_cells",
        )  # fmt: skip
        theta_i = None
        if "theta_i_deg" in keys:
            theta_i = keys.numbers("theta_i_deg", at_least=0, below=90)
            if any(b <= a for a, b in pairwise(theta_i)):
                raise keys.error("theta_i_deg", "must increase from angle to angle; sort them, each once")
        anisotropic = _check_anisotropic(keys)
        if anisotropic and theta_i is None:
            theta_i = ANISOTROPIC_THETA_I_DEG
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
            anisotropic,
            _step(keys, "phi_i_step_deg", 10.0, 360, "degrees"),
            keys.integer("tilt_cells", 65, at_least=9, at_most=513),
        )


def _check_anisotropic(keys: Keys) -> bool:
    """Whether the table is to be anisotropic; refuses keys that mean nothing then, or otherwise."""
    anisotropic = keys.flag("anisotropic")
    for key in ("theta_step_deg", "phi_step_deg") if anisotropic else ("phi_i_step_deg", "tilt_cells"):
        if key in keys:
            raise keys.error(
                key,
                "an anisotropic table has no such cells; give theta_i_deg, phi_i_step_deg or tilt_cells"
                if anisotropic
                else "only of an anisotropic table; add anisotropic = true, or leave it out",
            )
    if "tilt_cells" in keys and keys.integer("tilt_cells", 65, at_least=9, at_most=513) % 2 == 0:
        raise keys.error("tilt_cells", "must be odd, so that a cell lies in the middle")
    return anisotropic


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
