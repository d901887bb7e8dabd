"""In-plane measurements as CSV: what Ansys's BRDF viewer reads, spectra at angles in the plane of incidence.

Columns ``Incident_angle`` and ``Measure_angle`` in degrees, then one a wavelength, named like ``390nm``. The
angle of measurement counts from the normal: positive on the mirror side, negative on the light's. Values are
radiance factors, pi f: a matt white stands at 1. A 0 at all wavelengths is no value: there the source stands
in the way of the detector.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from gonio.formats.points import table_from_points
from gonio.formats.samples import Samples
from gonio.formats.text import content, to_numbers
from gonio.table.table import Table
from microgeometry.errors import InputError

_ANGLES = ("incident_angle", "measure_angle")


def read(path: Path) -> Table:
    """Read samples of the plane of incidence; everything out of reach of them is a gap.

    Returns
    -------
    Table
        A row for each angle of incidence, a channel for each wavelength; no error bars. Its albedo is of the
        plane's neighbourhood only, which the provenance says under ``lost``.

    Raises
    ------
    InputError
        A column that is missing or is no wavelength, a line of another length, or no numbers.
    """
    samples, fields = _read(path)
    return table_from_points(path, samples, **fields)


def samples_of(path: Path) -> dict[str, Samples]:
    """The file's samples, as `gonio.formats` has them; errors as `read`."""
    return {"": _read(path)[0]}


def _read(path: Path) -> tuple[Samples, dict[str, Any]]:
    """The samples, and the other arguments of `table_from_points`."""
    text = content(path).decode("utf-8", "replace")
    lines = [line for line in text.splitlines() if line.strip()]
    names = [name.strip().lower() for name in lines[0].split(",")] if lines else []
    if tuple(names[:2]) != _ANGLES or len(names) < 3:
        raise InputError(f"{path}: columns {names[:3]}; {', '.join(_ANGLES)} and wavelengths are expected")
    wavelengths = []
    for name in names[2:]:
        if not (match := re.fullmatch(r"(\d+(?:\.\d+)?) ?nm", name)) or float(match[1]) <= 0:
            raise InputError(f"{path}: column {name!r}; a wavelength like 550nm is expected")
        wavelengths.append(float(match[1]))
    words = ",".join(lines[1:]).split(",") if len(lines) > 1 else []
    if len(words) != len(names) * (len(lines) - 1):
        raise InputError(f"{path}: {len(words)} numbers in {len(lines) - 1} lines of {len(names)} columns")
    numbers = to_numbers(words, "the columns", path).reshape(-1, len(names))
    numbers = numbers[np.any(numbers[:, 2:] != 0, axis=1)]
    measured = np.radians(numbers[:, 1])
    # a sample speaks for no more of the azimuth than of theta: a highlight is as narrow there
    taken = np.unique(measured)
    reach = 0.5 * float(np.median(np.diff(taken))) if len(taken) > 1 else None
    samples = Samples(
        np.radians(numbers[:, 0]),
        np.abs(measured),
        np.where(measured >= 0, np.pi, 0.0),
        numbers[:, 2:] / np.pi,
    )
    return samples, {
        "channels": tuple(f"{w:g} nm" for w in wavelengths),
        "azimuth_reach": reach,
        "wavelengths_nm": tuple(wavelengths),
        "provenance": {
            "source": path.name,
            "format": "CSV of the plane of incidence",
            "lost": [
                "the albedo, but for the neighbourhood of the plane of incidence, all that was measured"
            ],
        },
    }
