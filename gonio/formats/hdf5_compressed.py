"""Compressed tables in HDF5: as few bytes as the library lets a file have.

A dimension scale, an attribute, a group of more than eight members cost from a hundred bytes to ten thousand. So
all that a compressed table holds is one dataset of bytes, ``compressed``, a record of `gonio.formats.packed`:
the table's fields under their names, the content of its method (see `gonio.table.compress`) under
``content/<name>``, the edges of a highlight's grid under ``peak/<name>``, and the names of its parts. Arrays that
a filter of HDF5 packs are datasets ``compressed_<name>`` beside it. Parts are groups ``parts/<name>`` alike; what
they share with their table they do not repeat.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from gonio.formats.hdf5_content import Filtered
from gonio.formats.hdf5_data import at, child, read_array
from gonio.formats.packed import pack_record, unpack_record
from gonio.table.peak import Peak, slope_areas
from gonio.table.table import Table
from microgeometry.errors import InputError

Content = Mapping[str, Any]

_NAME = "compressed"
_AXES = ("theta_i", "theta_r_edges", "delta_phi_edges", "theta_i_edges")
_SHARED = (*_AXES, "channels", "wavelengths_nm")
"""Of a table and its parts."""
_NUMBERS = ("row_albedo", "albedo_std_error", "specular", "specular_std_error")
_ZERO = _NUMBERS[1:]
"""Left out where they are 0 everywhere."""
_FACTS = ("ledger", "provenance")
_EDGES = ("slope_edges", "psi_edges")
_LARGEST = 2**30  # bytes of an array from a codec that can shrink without limit
_MOST_CELLS = 2**24  # of a highlight
_MAX_DEPTH = 8  # of parts in parts: in a damaged file a group may hold itself


def holds(group: h5py.Group) -> bool:
    """Whether the table in the group is a compressed one."""
    return _NAME in group


def write(group: h5py.Group, table: Table, contents: Mapping[str, Content], path: str = "") -> None:
    """Write a table and its parts; `contents` by their paths, as in `gonio.formats.hdf5.write`."""
    own = _fields(table)
    if path:
        own = {name: item for name, item in own.items() if name not in _SHARED}
    if table.peak is not None:
        own |= {f"peak/{name}": getattr(table.peak, name) for name in _EDGES}
    filtered = {n: item for n, item in contents[path].items() if isinstance(item, Filtered)}
    own |= {f"content/{n}": item for n, item in contents[path].items() if n not in filtered}
    own["parts"] = list(table.parts)
    group.create_dataset(_NAME, data=pack_record(own), track_times=False, fill_time="never")
    for name, item in filtered.items():
        item.create(group, f"{_NAME}_{name}")
    for name, part in table.parts.items():
        write(group.create_group(f"parts/{name}"), part, contents, f"{path}/{name}".lstrip("/"))


def _fields(table: Table) -> dict[str, Any]:
    """All that is kept of a table but its values, as a record."""
    record = {
        name: getattr(table, name) for name in (*_SHARED, *_NUMBERS) if getattr(table, name) is not None
    }
    for name in _ZERO:
        if not np.any(record[name]):
            del record[name]
    if table.gaps is not None:
        record["gaps"] = np.packbits(table.gaps)
    return record | {name: dict(getattr(table, name)) for name in _FACTS}


def read(group: h5py.Group, path: Path, where: str = "", shared: Content | None = None) -> Table:
    """The table in the file or in the group of a part, whose place `where` ends in a slash; inverse of `write`.

    `shared` is what a part has in common with its table.

    Raises
    ------
    InputError
        Damaged, or of an older version.
    """
    if where.count("/") > 2 * _MAX_DEPTH:
        raise InputError(f"{path}: {where}: parts in parts, {_MAX_DEPTH} deep; compress the table again")
    if isinstance(group[_NAME], h5py.Group):
        raise InputError(f"{path}: {where}{_NAME} is of an older version of gonio; compress the table again")
    packed = read_array(group[_NAME], where + _NAME, path, "u")
    try:
        record = {**unpack_record(packed), **(shared or {})}
        fields = _checked(record)
        names = [str(name) for name in record["parts"]]
    except (KeyError, TypeError, ValueError, ArithmeticError, RecursionError) as error:
        reason = f"{error} is missing" if isinstance(error, KeyError) else error
        raise InputError(
            f"{path}: {where}{_NAME}: damaged content ({reason}); compress the table again"
        ) from error
    content = {n.removeprefix("content/"): item for n, item in record.items() if n.startswith("content/")}
    # an array that a codec packs to nothing may still be as large as the table that its axes span
    room = 4 * math.prod(len(fields[name]) for name in _AXES[:3])
    room = min(room * len(fields["channels"]), _LARGEST)
    for name in group:
        if name.startswith(f"{_NAME}_"):
            array = read_array(group[name], where + name, path, "fiu", room)
            content[name.removeprefix(f"{_NAME}_")] = array
    from gonio.table.compress import decode, decode_peak  # which write through `gonio.formats.hdf5`

    with at(where):
        fields["values"] = decode(content, fields)
        if "peak/slope_edges" in record:
            edges = [_array(record.get(f"peak/{name}"), name) for name in _EDGES]
            if edges[0].size * edges[1].size > _MOST_CELLS:
                raise InputError(f"peak: {edges[0].size} x {edges[1].size} cells; compress the table again")
            fields["peak"] = Peak(decode_peak(content, slope_areas(*edges)), *edges)
    shared = {name: item for name, item in record.items() if name in _SHARED}
    fields["parts"] = {}
    for name in names:
        inner = child(child(group, "parts", path, where), name, path, f"{where}parts/")
        if not holds(inner):
            raise InputError(f"{path}: {where}parts/{name}/{_NAME} is missing; compress the table again")
        fields["parts"][name] = read(inner, path, f"{where}parts/{name}/", shared)
    with at(where):
        return Table(**fields)


def _checked(record: Content) -> dict[str, Any]:
    """A table's fields, of the right types; `Table` checks what they hold."""
    fields: dict[str, Any] = {n: _array(record[n], n) for n in (*_AXES, *_NUMBERS) if n in record}
    fields["channels"] = tuple(str(name) for name in record["channels"])
    for name in (*_AXES[:3], "row_albedo"):
        if fields[name].ndim == 0:
            raise ValueError(f"{name} is a single number")
    if "wavelengths_nm" in record:
        fields["wavelengths_nm"] = tuple(float(w) for w in record["wavelengths_nm"])
    if "gaps" in record:
        rows, rings, sectors = (len(fields[name]) for name in _AXES[:3])
        cells, packed = rows * (rings - 1) * (sectors - 1), _array(record["gaps"], "gaps")
        if 8 * packed.size - cells not in range(8):
            raise ValueError(f"{packed.size} bytes of gaps for {cells} cells")
        bits = np.unpackbits(packed.astype(np.uint8), count=cells).astype(bool)
        fields["gaps"] = bits.reshape(rows, rings - 1, sectors - 1)
    for name in _FACTS:
        if not isinstance(record[name], dict):
            raise ValueError(f"{name} is no object")
        fields[name] = record[name]
    return fields


def _array(item: Any, name: str) -> NDArray:
    if not isinstance(item, np.ndarray):
        raise InputError(f"{_NAME}/{name} is no array; compress the table again")
    return item
