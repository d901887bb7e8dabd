"""CIE XYZ and linear sRGB (IEC 61966-2-1), for formats that hold tristimulus values.

A perfect white has equal R, G and B; its XYZ is the white point D65 with Y = 1. Reflectances in such files
are per unit of Y.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.table.table import Table
from microgeometry.errors import InputError

RGB_TO_XYZ = np.array(
    [[0.4123908, 0.3575843, 0.1804808], [0.2126390, 0.7151687, 0.0721923], [0.0193308, 0.1191948, 0.9505322]]
)
XYZ_TO_RGB = np.linalg.inv(RGB_TO_XYZ)


def as_colour(table: Table, path: Path, name: str) -> Table:
    """For formats that hold one channel or a colour: the table, three wavelengths in the order of R, G and B.

    Parameters
    ----------
    table : Table
        That is to be written.
    path : Path
        The file it is written to.
    name : str
        Of such files, with its article.

    Raises
    ------
    InputError
        The table has other than one or three channels.
    """
    if len(table.channels) not in (1, 3):
        shown = ", ".join(table.channels[:3]) + ", ..." * (len(table.channels) > 3)
        raise InputError(
            f"{path}: {name} holds one channel or three, the table has {len(table.channels)} channels ({shown}); "
            ".csv, .npz and .h5 hold any number, RGL's .bsdf any number of wavelengths"
        )
    return reordered(table, from_longest(table))


def from_longest(table: Table) -> NDArray[np.int64]:
    """Channels from the longest wavelength to the shortest; as they are where they are no wavelengths."""
    if table.wavelengths_nm is None:
        return np.arange(len(table.channels))
    return np.argsort(-np.array(table.wavelengths_nm), kind="stable")


def reordered(table: Table, order: NDArray[np.int64]) -> Table:
    """The table and its parts with their channels in another order."""
    if np.array_equal(order, np.arange(len(table.channels))):
        return table
    columns = ("values", "std_error", "row_albedo", "albedo_std_error", "specular", "specular_std_error")
    changes = {n: getattr(table, n)[..., order] for n in columns if getattr(table, n) is not None}
    peak = table.peak
    if peak is not None:
        error = None if peak.std_error is None else peak.std_error[..., order]
        peak = replace(peak, values=peak.values[..., order], std_error=error)
    wavelengths = table.wavelengths_nm
    return table.replace(
        **changes,
        peak=peak,
        channels=tuple(table.channels[n] for n in order),
        wavelengths_nm=None if wavelengths is None else tuple(wavelengths[n] for n in order),
        parts={name: reordered(part, order) for name, part in table.parts.items()},
    )
