"""From spectra to linear sRGB: CIE 1931 2-degree observer, a stated illuminant, sRGB primaries."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from microgeometry.columns import read_columns

ILLUMINANTS = ("D65", "A", "E")
"""CIE standard illuminants D65 (daylight) and A (a tungsten lamp), and the equal-energy spectrum E."""

SRGB_FROM_XYZ = np.array(
    (
        (3.2406255, -1.5372080, -0.4986286),
        (-0.9689307, 1.8757561, 0.0415175),
        (0.0557101, -0.2040211, 1.0569959),
    )
)
"""Linear sRGB from CIE XYZ with Y = 1 for white (IEC 61966-2-1:1999 with its amendment of 2003)."""

_CIE = Path(__file__).with_name("cie.csv")


def xyz_weights(samples_nm: ArrayLike, illuminant: str) -> NDArray[np.float64]:
    """Weights that turn reflectances at a few wavelengths into CIE XYZ.

    The reflectance is taken as linear in wavelength between the samples and constant beyond the first
    and the last; that line, times illuminant and colour-matching functions, is summed every nanometre from
    380 to 780 nm. Between the CIE's 5 nm steps the functions follow a cubic spline and the illuminant a
    straight line; that is within 2e-5 of sums over the CIE's 1 nm tables.

    Parameters
    ----------
    samples_nm : array_like, shape (S,)
        Wavelengths, nanometres, increasing.
    illuminant : str
        One of `ILLUMINANTS`.

    Returns
    -------
    ndarray, shape (3, S)
        XYZ = weights @ reflectances; Y of a perfect white is 1.
    """
    samples = np.asarray(samples_nm, dtype=np.float64)
    wavelengths, observer, power = _observer(illuminant)
    hats = np.array([np.interp(wavelengths, samples, unit) for unit in np.eye(len(samples))])
    weights = (observer * power) @ hats.T
    return weights / weights[1].sum()


def rgb_matrix(samples_nm: ArrayLike, illuminant: str) -> NDArray[np.float64]:
    """Weights that turn reflectances at a few wavelengths into linear sRGB.

    Each row is divided by its sum: a perfect white is (1, 1, 1) under any illuminant. Under D65, sRGB's own
    white, that only takes out rounding (4e-4); under another it adapts the eye to the lamp, as a camera's
    white balance does. A colour outside sRGB's gamut has a negative component.

    Parameters
    ----------
    samples_nm : array_like, shape (S,)
        Wavelengths, nanometres, increasing.
    illuminant : str
        One of `ILLUMINANTS`.

    Returns
    -------
    ndarray, shape (3, S)
    """
    matrix = SRGB_FROM_XYZ @ xyz_weights(samples_nm, illuminant)
    return matrix / matrix.sum(axis=1, keepdims=True)


def rgb_luminance(illuminant: str) -> NDArray[np.float64]:
    """Weights of R, G and B of `rgb_matrix` in the luminance Y; they sum to 1.

    R, G or B of a colour outside the gamut lie outside 0 to 1, its luminance never does.

    Returns
    -------
    ndarray, shape (3,)
    """
    white = SRGB_FROM_XYZ @ xyz_weights([550.0], illuminant).sum(axis=1)
    return np.linalg.inv(SRGB_FROM_XYZ)[1] * white


@cache
def _observer(illuminant: str) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Wavelengths (401,), colour-matching functions (3, 401) and the illuminant's power (401,)."""
    columns = read_columns(_CIE, ("wavelength_nm", "x_bar", "y_bar", "z_bar", "A", "D65"))
    given = columns["wavelength_nm"]
    wavelengths = np.arange(given[0], given[-1] + 0.5)
    observer = CubicSpline(given, [columns[c] for c in ("x_bar", "y_bar", "z_bar")], axis=1)(wavelengths)
    power = (
        np.interp(wavelengths, given, columns[illuminant]) if illuminant != "E" else np.ones(len(wavelengths))
    )
    return wavelengths, observer, power
