"""ASTM E1392 files `.astm` (text): one line a sample, angles in radians.

Lines ``KEY value``, then ``VARS theta_i,phi_i,theta_s,phi_s,<channels>``, then samples separated by commas.
Channels are R,G,B or X,Y,Z, or wavelengths such as 400nm; any other single name is kept. Azimuths are those of
the outward directions to light and detector, so delta phi = |phi_i - phi_s|.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from gonio.formats.colour import XYZ_TO_RGB
from gonio.formats.points import table_from_points
from gonio.formats.samples import Samples
from gonio.formats.text import content, to_numbers
from gonio.table.table import Table
from microgeometry.errors import InputError

_ANGLES = ["theta_i", "phi_i", "theta_s", "phi_s"]


def read(path: Path) -> Table:
    """Read an ASTM file; places of the grid of angles without a sample are gaps.

    Samples of several azimuths of the light are averaged. X, Y, Z become linear sRGB.

    Raises
    ------
    InputError
        No line VARS, other variables, a number of samples other than NUM_POINTS, or no numbers.
    """
    samples, fields = _read(path)
    return table_from_points(path, samples, **fields)


def samples_of(path: Path) -> dict[str, Samples]:
    """The file's samples, as `gonio.formats` has them; errors as `read`."""
    return {"": _read(path)[0]}


def _read(path: Path) -> tuple[Samples, dict[str, Any]]:
    """The samples, and the other arguments of `table_from_points`."""
    lines = content(path).decode("latin-1").splitlines()
    lines = [line.strip() for line in lines if line.strip()]
    starts = [n for n, line in enumerate(lines) if line.split(None, 1)[0] == "VARS"]
    if not starts:
        raise InputError(f"{path}: no line VARS; is it an ASTM E1392 file?")
    header = dict(line.partition(" ")[::2] for line in lines[: starts[0]])
    names = [name.strip() for name in lines[starts[0]][4:].split(",")]
    samples = lines[starts[0] + 1 :]
    if names[:4] != _ANGLES or len(names) < 5 or not all(names):
        raise InputError(
            f"{path}: VARS {','.join(names)[:100]}; {','.join(_ANGLES)} and channels are expected"
        )
    stated = header.get("NUM_POINTS", "").strip()
    if stated and stated != str(len(samples)):
        raise InputError(f"{path}: {len(samples)} samples, NUM_POINTS is {stated[:20]}; copy it again")
    if any(line.count(",") != len(names) - 1 for line in samples):
        raise InputError(f"{path}: samples of other than {len(names)} numbers")
    words = ",".join(samples).split(",") if samples else []
    numbers = to_numbers(words, "the samples", path).reshape(-1, len(names))
    values, channels = numbers[:, 4:], tuple(names[4:])
    if channels == ("X", "Y", "Z"):
        values, channels = values @ XYZ_TO_RGB.T, ("R", "G", "B")
    found = [re.fullmatch(r"(\d{1,7}(?:\.\d{1,6})?) *nm", name) for name in channels]
    wavelengths = tuple(float(match[1]) for match in found if match)
    lost = []
    if len(np.unique(np.round(numbers[:, 1], 6))) > 1:
        lost.append("the azimuth of the light: its rotations are averaged")
    spectral = len(wavelengths) == len(channels) and min(wavelengths) > 0
    return Samples(numbers[:, 0], numbers[:, 2], numbers[:, 3] - numbers[:, 1], values), {
        "channels": channels,
        "wavelengths_nm": wavelengths if spectral else None,
        "provenance": {"source": path.name, "format": "ASTM E1392", "header": header, "lost": lost},
    }
