"""Materials of many wavelengths as linear RGB: what a renderer of three channels can show of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gonio.table.anisotropic import AnisotropicTable
from gonio.table.table import Table
from microgeometry.colour import rgb_matrix
from microgeometry.errors import InputError
from renderer.scene import Array

_RGB = ("R", "G", "B")


def rgb_weights(channels: Sequence[str], wavelengths_nm: Sequence[float] | None, name: str) -> Array | None:
    """What turns a material's channels into red, green and blue.

    Channels by the names R, G and B, and a single channel, are rendered as they are; so are three channels
    without wavelengths, in that order. Wavelengths are summed by the CIE 1931 observer under D65, the white
    of the picture's own primaries.

    Parameters
    ----------
    channels : sequence of str
    wavelengths_nm : sequence of float or None
    name : str
        Of the material, for the error.

    Returns
    -------
    ndarray, shape (3, C), or None
        None: there is nothing to be done.

    Raises
    ------
    InputError
        Several channels that are neither RGB nor wavelengths.
    """
    count = len(channels)
    if count == 1 or tuple(channels) == _RGB or (wavelengths_nm is None and count == 3):
        return None
    if wavelengths_nm is None:
        raise InputError(
            f"{name}: has {count} channels without wavelengths; one (grey), three (red, green, blue) or "
            "wavelengths can be rendered"
        )
    order = np.argsort(wavelengths_nm)
    weights = np.empty((3, count))
    weights[:, order] = rgb_matrix(np.asarray(wavelengths_nm)[order], "D65")
    return weights


def rgb_table(table: Table, name: str) -> Table:
    """The table itself, or one of red, green and blue in place of its wavelengths.

    A colour outside the gamut is cut off at 0: reflectance below 0 cannot be rendered. Error bars are left
    out, as the picture does not use them.
    """
    weights = _weights(table, name)
    if weights is None:
        return table
    peak = table.peak
    return table.replace(
        values=_mixed(table.values, weights),
        **_rows(table, weights),
        peak=None if peak is None else replace(peak, values=_mixed(peak.values, weights), std_error=None),
    )


def rgb_anisotropic(table: AnisotropicTable, name: str) -> AnisotropicTable:
    """As `rgb_table`."""
    weights = _weights(table, name)
    if weights is None:
        return table
    return table.replace(energy=_mixed(table.energy.astype(float), weights), **_rows(table, weights))


def _weights(table: Table | AnisotropicTable, name: str) -> Array | None:
    """As `rgb_weights`; None where nothing is to be cut off either. Evaluation does it for all but the delta term."""
    weights = rgb_weights(table.channels, table.wavelengths_nm, name)
    if weights is None and len(table.channels) == 3 and np.any(table.specular < 0):
        return np.eye(3)
    return weights


def _mixed(values: Array, weights: Array) -> Array:
    return np.maximum(values @ weights.T, 0.0)


def _rows(table: Table | AnisotropicTable, weights: Array) -> dict[str, Any]:
    """The fields that tables of either kind have in common, in red, green and blue."""
    specular = _mixed(table.specular, weights)
    return {
        "row_albedo": _mixed(table.row_albedo - table.specular, weights) + specular,
        "specular": specular,
        "channels": _RGB,
        "wavelengths_nm": None,
        "std_error": None,
        "albedo_std_error": np.zeros(()),
        "specular_std_error": np.zeros(()),
        "parts": {},
    }
