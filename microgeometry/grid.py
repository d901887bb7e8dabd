"""What is to be measured on a specimen: its channels and its angles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from microgeometry.keys import Keys

RGB_WAVELENGTHS_NM = (630.0, 532.0, 467.0)


@dataclass(frozen=True)
class Grid:
    """Channels and angles of the table to be measured.

    Keys of [grid], all optional: ``wavelengths_nm``, a list, one channel each; or ``channels``, "rgb" or
    "grey". With "rgb", optical constants are taken at one representative wavelength each for red, green
    and blue, 630, 532 and 467 nm: the usual approximation, not a colour-matching integral. "grey" is one
    channel without a wavelength. With neither key: "rgb" if the material depends on wavelength (it has a
    name, or a list of three values), else "grey".
    ``theta_i_deg``: the rows to measure, increasing, 0 <= theta_i < 90; if absent, theta_i is binned
    like theta_r. ``theta_step_deg`` (1) divides 90, ``phi_step_deg`` (1) divides 180.

    Attributes
    ----------
    wavelengths_nm : tuple of float or None
        One per channel, nanometres; None for "grey".
    channels : tuple of str
        Names: ("R", "G", "B"), ("grey",), or the wavelengths as in "630 nm".
    theta_i_deg : tuple of float or None
        Degrees.
    theta_step_deg, phi_step_deg : float
        Width of the cells in theta and in delta phi, degrees.
    """

    wavelengths_nm: tuple[float, ...] | None
    channels: tuple[str, ...]
    theta_i_deg: tuple[float, ...] | None = None
    theta_step_deg: float = 1.0
    phi_step_deg: float = 1.0

    @classmethod
    def from_keys(cls, keys: Keys, material: Mapping[str, Any]) -> Grid:
        """Build from the [grid] table and, for the default channels, the [material] table."""
        keys.allow("wavelengths_nm", "channels", "theta_i_deg", "theta_step_deg", "phi_step_deg")
        wavelengths, channels = _channels(keys, material)
        theta_i = None
        if "theta_i_deg" in keys:
            theta_i = keys.numbers("theta_i_deg", at_least=0, below=90)
            if any(b <= a for a, b in pairwise(theta_i)):
                raise keys.error("theta_i_deg", "must increase from angle to angle; sort them, each once")
        theta_step, phi_step = _step(keys, "theta_step_deg", 90), _step(keys, "phi_step_deg", 180)
        return cls(wavelengths, channels, theta_i, theta_step, phi_step)


def _channels(keys: Keys, material: Mapping[str, Any]) -> tuple[tuple[float, ...] | None, tuple[str, ...]]:
    if "wavelengths_nm" in keys:
        if "channels" in keys:
            raise keys.error("channels", "give channels or wavelengths_nm, not both")
        wavelengths = keys.numbers("wavelengths_nm", above=0)
        channels = tuple(f"{w:.10g} nm" for w in wavelengths)
        if len(set(channels)) < len(channels):
            raise keys.error("wavelengths_nm", "the same wavelength stands there twice; give each once")
        return wavelengths, channels
    # A list of one is as good as a number; a list of another length is an error of the material's.
    depends_on_wavelength = "name" in material or any(
        isinstance(value, list | tuple) and len(value) == 3 for value in material.values()
    )
    if keys.choice("channels", "rgb" if depends_on_wavelength else "grey", ("rgb", "grey")) == "rgb":
        return RGB_WAVELENGTHS_NM, ("R", "G", "B")
    return None, ("grey",)


def _step(keys: Keys, key: str, whole: int) -> float:
    step = keys.number(key, 1.0, at_least=0.01, at_most=whole)
    n = round(whole / step)
    if abs(n * step - whole) > 1e-9 * whole:
        raise keys.error(key, f"must divide {whole} degrees evenly, as {whole / n:.10g} does")
    return whole / n
