"""Reading a CSV file of numbers by the names of its columns."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from microgeometry.errors import InputError


def read_columns(
    file: Path, names: Sequence[str], optional: Sequence[str] = ()
) -> dict[str, NDArray[np.float64]]:
    """Read columns of finite numbers from a CSV file.

    The first line that is not empty and not a comment (#) holds the names of the columns, in any order.

    Parameters
    ----------
    file : Path
    names : sequence of str
        Columns that must be there.
    optional : sequence of str
        Columns that may be there. Any other is an error.

    Returns
    -------
    dict of ndarray, shape (rows,)
        By name; at least one row.

    Raises
    ------
    InputError
        The file cannot be read, a column is missing or unknown, or a value is not a finite number: one
        line that names the file and the line.
    """
    try:
        lines = file.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); check the path") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{file}: not a text file in UTF-8; a CSV file is expected") from error
    numbered = [
        (n, line) for n, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")
    ]
    expected = ", ".join(names) + "".join(f"[, {name}]" for name in optional)
    if not numbered:
        raise InputError(f"{file}: empty; a CSV file with the columns {expected} is expected")
    header = [name.strip() for name in next(csv.reader([numbered[0][1]]))]
    if (
        not set(names) <= set(header)
        or not set(header) <= {*names, *optional}
        or len(set(header)) < len(header)
    ):
        raise InputError(
            f"{file}, line {numbered[0][0]}: the columns are {', '.join(header)[:60]!r}; "
            f"a header line with {expected} is expected"
        )
    if len(numbered) == 1:
        raise InputError(f"{file}: no row of numbers below the header; at least one is needed")
    rows = [_numbers(file, n, line, len(header)) for n, line in numbered[1:]]
    return dict(zip(header, np.array(rows).T, strict=True))


def _numbers(file: Path, n: int, line: str, count: int) -> list[float]:
    fields = next(csv.reader([line]))
    try:
        numbers = [float(field) for field in fields]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(math.isfinite(x) for x in numbers):
        raise InputError(f"{file}, line {n}: {line.strip()[:60]!r}; {count} finite numbers are expected")
    return numbers
