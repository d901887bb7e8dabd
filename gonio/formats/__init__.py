"""BRDF files, one module a format, chosen by the file's suffix.

A format is a module with ``read(path) -> Table`` and ``write(table, path) -> list[str]``, which returns
what the format could not keep, and one line in `FORMATS`.
"""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from gonio.table.parts import extract
from microgeometry.errors import InputError

if TYPE_CHECKING:
    from gonio.table.table import Table

FORMATS = {
    ".h5": "gonio.formats.hdf5",
    ".binary": "gonio.formats.merl",
}
"""Suffix to module; imported when first needed."""


def read(path: str | os.PathLike[str]) -> Table:
    """Read a table from a file of any known format.

    Raises
    ------
    InputError
        The file is missing, of an unknown suffix, damaged or not a table.
    """
    path = Path(path)
    module = _module(path)
    if not path.is_file():
        raise InputError(f"{path}: {'is not a file' if path.exists() else 'no such file'}")
    return module.read(path)


def write(table: Table, path: str | os.PathLike[str]) -> list[str]:
    """Write a table in the format of the suffix of `path`; nothing half-written stays on failure.

    Returns
    -------
    list of str
        What was lost, one sentence each; empty for .h5.
    """
    return _module(Path(path)).write(table, Path(path))


def convert(
    source: str | os.PathLike[str], target: str | os.PathLike[str], part: str | None = None
) -> list[str]:
    """Read one format and write another, both chosen by suffix.

    Parameters
    ----------
    source, target : path
    part : str, optional
        Write only this part, as a table of its own: "transmission", "L1", "transmission/L1".

    Returns
    -------
    list of str
        What was lost in writing.

    Raises
    ------
    InputError
        As `read`; an unknown suffix, a missing folder, or no such part.
    """
    check_target(target)
    table = read(source)
    if part is not None:
        try:
            table = extract(table, part)
        except InputError as error:
            raise InputError(f"{source}: {error}") from error
    return write(table, target)


def check_target(path: str | os.PathLike[str]) -> None:
    """Fail now rather than after a long run: is `path` of a known format, in a folder that exists?

    Raises
    ------
    InputError
        The suffix is unknown or the folder missing.
    """
    path = Path(path)
    _module(path)
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist; create it first")


def _module(path: Path) -> ModuleType:
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise InputError(f"{path}: unknown suffix {suffix!r}; allowed are {', '.join(FORMATS)}")
    return import_module(FORMATS[suffix])
