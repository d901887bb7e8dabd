"""NPZ files: a table's fields as numpy arrays under their own names; read with `numpy.load`.

Arrays are those of `Table`, angles in radians; ``channels`` is an array of text, ``ledger`` and
``provenance`` are JSON in arrays of text. Those of a highlight's own grid (`gonio.table.peak.Peak`) are named
``peak/values`` and so on, a part's ``parts/<name>/values``.
"""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.files import atomic
from gonio.table.peak import Peak
from gonio.table.table import Table
from microgeometry.errors import InputError

_ARRAYS = (
    "values", "std_error", "hits", "gaps", "theta_i", "theta_i_edges", "theta_r_edges", "delta_phi_edges",
    "row_albedo", "albedo_std_error", "specular", "specular_std_error",
)  # fmt: skip
_PEAK = ("values", "slope_edges", "psi_edges", "std_error")
_NEEDED = ("values", "theta_i", "theta_r_edges", "delta_phi_edges", "row_albedo", "channels")
_MAX_RATIO = 1100  # deflate cannot shrink more
_MAX_DEPTH = 8
_MAX_HEADER = 4096


def read(path: Path) -> Table:
    """Read an NPZ file.

    Raises
    ------
    InputError
        No NPZ, an array that is missing or does not fit, or one that claims more than the file can hold.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            arrays = {
                info.filename.removesuffix(".npy"): _member(archive, info, path)
                for info in archive.infolist()
            }
    except (
        zipfile.BadZipFile,
        zlib.error,
        NotImplementedError,
        RuntimeError,
        OSError,
        EOFError,
        ValueError,
    ) as error:
        if isinstance(error, InputError):
            raise
        reason = " ".join(str(error).split())[:120]
        raise InputError(f"{path}: no NPZ file, or a damaged one ({reason}); write it again") from error
    return _table(arrays, path, "")


def write(table: Table, path: Path) -> list[str]:
    """Write a table; nothing is lost.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    arrays: dict[str, NDArray] = {}
    _collect(table, "", arrays)
    with atomic(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    return []


def _collect(table: Table, prefix: str, arrays: dict[str, NDArray]) -> None:
    for name in _ARRAYS:
        if (array := getattr(table, name)) is not None:
            arrays[prefix + name] = array
    if table.peak is not None:
        for name in _PEAK:
            if (array := getattr(table.peak, name)) is not None:
                arrays[f"{prefix}peak/{name}"] = array
    arrays[prefix + "channels"] = np.array(table.channels)
    if table.wavelengths_nm is not None:
        arrays[prefix + "wavelengths_nm"] = np.array(table.wavelengths_nm)
    arrays[prefix + "ledger"] = np.array(json.dumps(dict(table.ledger)))
    arrays[prefix + "provenance"] = np.array(json.dumps(dict(table.provenance)))
    for name, part in table.parts.items():
        _collect(part, f"{prefix}parts/{name}/", arrays)


def _member(archive: zipfile.ZipFile, info: zipfile.ZipInfo, path: Path) -> NDArray:
    """One array, of no more bytes than the archive can hold."""
    there = path.stat().st_size
    if info.compress_size > there or info.file_size > _MAX_RATIO * max(1, info.compress_size):
        raise InputError(
            f"{path}: {info.filename[:80]} claims {info.file_size} bytes in {info.compress_size}, more than a file "
            f"of {there} bytes can hold; write it again"
        )
    data = archive.read(info)
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        reader = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}[
            version
        ]
        shape, fortran, dtype = reader(stream, max_header_size=_MAX_HEADER)
    except (ValueError, KeyError, TypeError, SyntaxError, EOFError, RecursionError, MemoryError) as error:
        raise InputError(f"{path}: {info.filename[:80]} is no numpy array; write the file again") from error
    count = 1
    for n in shape:
        count *= n
    if dtype.kind not in "fiubU" or count < 0 or count * dtype.itemsize != len(data) - stream.tell():
        raise InputError(
            f"{path}: {info.filename[:80]} of shape {shape} and type {str(dtype)[:20]} does not fit its "
            f"{len(data)} bytes; write the file again"
        )
    if count == 0 or dtype.itemsize == 0:
        raise InputError(f"{path}: {info.filename[:80]} is empty; write the file again")
    array: NDArray = np.frombuffer(data, dtype, count, stream.tell())
    return array.reshape(shape, order="F" if fortran else "C")


def _table(arrays: dict[str, NDArray], path: Path, prefix: str) -> Table:
    """The table, or the part whose arrays' names begin with `prefix`."""
    if prefix.count("/") > 2 * _MAX_DEPTH:
        raise InputError(f"{path}: {prefix[:80]}: parts in parts, {_MAX_DEPTH} deep; write the file again")
    for name in _NEEDED:
        if prefix + name not in arrays:
            raise InputError(f"{path}: array {prefix[:80]}{name} is missing; {', '.join(_NEEDED)} are needed")
    fields: dict[str, Any] = _numbers(arrays, path, prefix, (*_ARRAYS, "wavelengths_nm"))
    if "wavelengths_nm" in fields:
        fields["wavelengths_nm"] = tuple(np.ravel(fields["wavelengths_nm"]).tolist())
    fields["channels"] = tuple(_text(arrays, f"{prefix}channels", path))
    for name in ("ledger", "provenance"):
        try:
            fields[name] = (
                json.loads(_text(arrays, prefix + name, path)[0]) if prefix + name in arrays else {}
            )
        except (ValueError, RecursionError):
            fields[name] = None
        if not isinstance(fields[name], dict):
            raise InputError(f"{path}: array {prefix[:80]}{name} is no JSON object; write the file again")
    start = f"{prefix}parts/"
    names = dict.fromkeys(n[len(start) :].split("/")[0] for n in arrays if n.startswith(start))
    fields["parts"] = {name: _table(arrays, path, f"{start}{name}/") for name in names}
    peak = _numbers(arrays, path, f"{prefix}peak/", _PEAK)
    try:
        if peak:
            if missing := [name for name in _PEAK[:3] if name not in peak]:
                raise InputError(f"array peak/{missing[0]} is missing; write the file again")
            fields["peak"] = Peak(**peak)
        return Table(**fields)
    except InputError as error:
        raise InputError(f"{path}: {prefix[:80]}{error}") from error


def _numbers(
    arrays: dict[str, NDArray], path: Path, prefix: str, names: tuple[str, ...]
) -> dict[str, NDArray]:
    """Those arrays of numbers that are there, by their names without the prefix."""
    found = {name: arrays[prefix + name] for name in names if prefix + name in arrays}
    for name, array in found.items():
        if array.dtype.kind == "U":
            raise InputError(f"{path}: array {prefix[:80]}{name} holds text; numbers are expected")
    return found


def _text(arrays: dict[str, NDArray], name: str, path: Path) -> list[str]:
    array = np.atleast_1d(arrays[name])
    try:
        if array.dtype.kind != "U" or array.ndim != 1:
            raise ValueError("no text")
        return [str(item) for item in array.tolist()]
    except ValueError as error:  # also characters beyond Unicode
        raise InputError(f"{path}: array {name[:80]} is no list of text; write the file again") from error
