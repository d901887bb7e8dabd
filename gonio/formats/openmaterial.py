"""ASAM OpenMATERIAL 3D look-up tables `.xompt` (JSON): wavelength, angles and BRDF of each sample, in SI units.

Rows of ``brdf.lookupTable`` are wavelength (m), zenith angle of incidence, zenith angle of exit, azimuth
between them (rad), f (1/sr); null where a column does not apply. The azimuth is counted from the direction of
the light, so that 0 is retro-reflection.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from gonio.formats.cells import check_size
from gonio.formats.points import table_from_points
from gonio.formats.samples import Samples
from gonio.table.table import Table
from microgeometry.errors import InputError


def read(path: Path) -> Table:
    """Read a look-up table; places of its grid of angles without a sample are gaps.

    Raises
    ------
    InputError
        No JSON, another layout, or numbers out of range.
    """
    samples, fields = _read(path)
    return table_from_points(path, samples, **fields)


def samples_of(path: Path) -> dict[str, Samples]:
    """The file's samples, as `gonio.formats` has them; errors as `read`."""
    return {"": _read(path)[0]}


def _read(path: Path) -> tuple[Samples, dict[str, Any]]:
    """The samples, and the other arguments of `table_from_points`."""
    try:
        content = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: no JSON ({str(error)[:80]}); copy it again") from error
    rows = _get(_get(content, "brdf", path), "lookupTable", path)
    if (
        not isinstance(rows, list)
        or not rows
        or not all(isinstance(row, list) and len(row) == 5 for row in rows)
    ):
        raise InputError(f"{path}: brdf.lookupTable: a list of samples of five numbers is expected")
    try:
        numbers = np.array([[0.0 if cell is None else cell for cell in row] for row in rows], dtype=float)
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(f"{path}: brdf.lookupTable: numbers are expected") from error
    if not np.all(np.isfinite(numbers)):
        raise InputError(f"{path}: brdf.lookupTable holds NaN or infinity; finite numbers are expected")
    wavelengths, channel = np.unique(numbers[:, 0], return_inverse=True)
    if len(wavelengths) > 1:
        numbers, values = _by_direction(path, numbers, channel, len(wavelengths))
    else:
        values = numbers[:, 4:]
    known = wavelengths.min() > 0
    names = tuple(f"{w * 1e9:g} nm" for w in wavelengths) if known else ("Y",) * len(wavelengths)
    metadata = content.get("metadata")
    return Samples(numbers[:, 1], numbers[:, 2], numbers[:, 3], values), {
        "channels": names,
        "wavelengths_nm": tuple((wavelengths * 1e9).tolist()) if known else None,
        "provenance": {
            "source": path.name,
            "format": "OpenMATERIAL",
            "description": str(metadata.get("name", ""))[:200] if isinstance(metadata, dict) else "",
        },
    }


def _get(content: Any, key: str, path: Path) -> Any:
    if not isinstance(content, dict) or key not in content:
        raise InputError(f"{path}: key {key!r} is missing; is it an OpenMATERIAL BRDF look-up table?")
    return content[key]


def _by_direction(path: Path, numbers: Any, channel: Any, n: int) -> tuple[Any, Any]:
    """Samples of one direction each with all wavelengths; every wavelength must have the same directions."""
    directions, index = np.unique(np.round(numbers[:, 1:4], 7), axis=0, return_inverse=True)
    index = index.ravel()
    check_size(path, float(len(directions)) * n, "wavelengths and directions")
    values = np.full((len(directions), n), np.nan)
    values[index, channel] = numbers[:, 4]
    if np.any(np.isnan(values)):
        raise InputError(f"{path}: brdf.lookupTable: every wavelength must have the same directions")
    return np.column_stack([np.zeros(len(directions)), directions]), values
