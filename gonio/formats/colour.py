"""CIE XYZ and linear sRGB (IEC 61966-2-1), for formats that hold tristimulus values.

A perfect white has equal R, G and B; its XYZ is the white point D65 with Y = 1. Reflectances in such files
are per unit of Y.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gonio.table.table import Table
from microgeometry.errors import InputError

RGB_TO_XYZ = np.array(
    [[0.4123908, 0.3575843, 0.1804808], [0.2126390, 0.7151687, 0.0721923], [0.0193308, 0.1191948, 0.9505322]]
)
XYZ_TO_RGB = np.linalg.inv(RGB_TO_XYZ)


def check_colour(table: Table, path: Path, name: str) -> None:
    """For formats that hold one channel or a colour.

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
        raise InputError(
            f"{path}: {name} holds one channel or three, the table has {len(table.channels)} channels "
            f"{table.channels}; select or convert to three first"
        )
