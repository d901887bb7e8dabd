"""Compressed tables in HDF5: as few bytes as the library lets a file have.

A dimension scale, an attribute, a group cost from a hundred bytes to ten thousand. So all that a compressed table
and its parts hold is one dataset of bytes, ``compressed``, a record of `gonio.formats.packed`: the table's fields
under their names, albedo (of the cells) and delta term to a millionth, their error bars to a hundredth, in
logarithmic steps, the content of its method (see `gonio.table.compress`) under ``content/<name>``, the edges of a
highlight's grid under ``peak/<name>``, and the names of its parts. What a part holds has ``<part>/`` before its
names; what it shares with the table it does not repeat. Arrays that a filter of HDF5 packs are datasets of their own,
``compressed_<name in the record>`` with dots for slashes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from gonio.formats.hdf5_content import Filtered
from gonio.formats.hdf5_data import at, read_array
from gonio.formats.packed import pack_record, unpack_record
from gonio.table.parts import walk
from gonio.table.peak import Peak, slope_areas
from gonio.table.table import Table
from microgeometry.errors import InputError

Array = NDArray[np.float64]
Content = Mapping[str, Any]

_NAME = "compressed"
_AXES = ("theta_i", "theta_r_edges", "delta_phi_edges", "theta_i_edges")
_SHARED = (*_AXES, "channels", "wavelengths_nm")
"""Of a table and its parts."""
_CELLS = "albedo_of_cells"
_STEPS = {_CELLS: 1e-6, "specular": 1e-6, "albedo_std_error": 0.01, "specular_std_error": 0.01}
"""Numbers of rows and channels, and the relative steps they are kept in; left out where they are 0 everywhere."""
_FACTS = ("ledger", "provenance")
_EDGES = ("slope_edges", "psi_edges")
_LARGEST = 2**30  # bytes of an array from a codec that can shrink without limit
_MOST_NUMBERS = 2**18  # of rows and channels
_MOST_CELLS = 2**24  # of a highlight
_MOST_GAPS = 2**28  # cells that may be marked
_MAX_DEPTH = 8  # of parts in parts
_SINCE = 7  # minor version of files that are laid out so


def holds(group: h5py.Group) -> bool:
    """Whether the table in the group is a compressed one."""
    return _NAME in group


def write(group: h5py.Group, table: Table, contents: Mapping[str, Content]) -> None:
    """Write a table and its parts; `contents` by their paths, as in `gonio.formats.hdf5.write`."""
    record: dict[str, Any] = {}
    for path, one in {"": table, **dict(walk(table))}.items():
        prefix = f"{path}/" if path else ""
        own = _fields(one)
        if path:
            own = {name: item for name, item in own.items() if name not in _SHARED}
        if one.peak is not None:
            own |= {f"peak/{name}": getattr(one.peak, name) for name in _EDGES}
        own |= {f"content/{name}": item for name, item in contents[path].items()}
        own["parts"] = list(one.parts)
        record |= {prefix + name: item for name, item in own.items()}
    filtered = {name: item for name, item in record.items() if isinstance(item, Filtered)}
    packed = pack_record({name: item for name, item in record.items() if name not in filtered})
    group.create_dataset(_NAME, data=packed, track_times=False, fill_time="never")
    for name, item in filtered.items():
        item.create(group, _dataset(name))


def _dataset(name: str) -> str:
    """Where an array stands that a filter packs; a slash would make a group."""
    return f"{_NAME}_{name.replace('/', '.')}"


def _fields(table: Table) -> dict[str, Any]:
    """All that is kept of a table but its values, as a record."""
    # of a package that writes through `gonio.formats.hdf5`
    from gonio.table.compress.codes import Steps
    from gonio.table.compress.packing import pack_flags

    record = {name: getattr(table, name) for name in _SHARED if getattr(table, name) is not None}
    for name, step in _STEPS.items():
        numbers = table.row_albedo - table.specular if name == _CELLS else getattr(table, name)
        if np.any(numbers):
            record |= Steps.of(numbers, step).content(name)
    if table.gaps is not None:
        record["gaps"] = pack_flags(table.gaps)
    return record | {name: dict(getattr(table, name)) for name in _FACTS}


def read(group: h5py.Group, path: Path, version: str) -> Table:
    """The table and its parts, of a file of the version "1.7" or the like; inverse of `write`.

    Raises
    ------
    InputError
        Damaged, or of an older version.
    """
    minor = version.partition(".")[2]
    if not minor.isdigit() or int(minor) < _SINCE:
        raise InputError(f"{path}: compressed by an older version of gonio; compress the table again")
    packed = read_array(group[_NAME], _NAME, path, "u")
    with _undamaged(path, ""):
        record = unpack_record(packed)
    return _table(record, "", group, path)


def _table(record: Content, prefix: str, group: h5py.Group, path: Path) -> Table:
    """The table, or the part whose names in the record begin with `prefix`."""
    if prefix.count("/") > _MAX_DEPTH:
        raise InputError(f"{path}: {prefix}: parts in parts, {_MAX_DEPTH} deep; compress the table again")
    own = {name: item for name, item in record.items() if name in _SHARED}
    own |= {n.removeprefix(prefix): item for n, item in record.items() if n.startswith(prefix)}
    with _undamaged(path, prefix):
        fields = _checked(own)
        names = dict.fromkeys(map(str, own["parts"]))  # each once, whatever a damaged file says
    content = {n.removeprefix("content/"): item for n, item in own.items() if n.startswith("content/")}
    # an array that a codec packs to nothing may still be as large as the table that its axes span
    room = 4 * math.prod(len(fields[name]) for name in _AXES[:3])
    room = min(room * len(fields["channels"]), _LARGEST)
    begins = _dataset(prefix + "content/")
    for name in group:
        if name.startswith(begins):
            content[name.removeprefix(begins)] = read_array(group[name], name, path, "fiu", room)
    from gonio.table.compress import decode, decode_peak  # which write through `gonio.formats.hdf5`

    with at(prefix):
        fields["values"] = decode(content, fields)
        if "peak/slope_edges" in own:
            edges = [_array(own.get(f"peak/{name}"), name) for name in _EDGES]
            if edges[0].size * edges[1].size > _MOST_CELLS:
                raise InputError(f"peak: {edges[0].size} x {edges[1].size} cells; compress the table again")
            shape = len(fields["theta_i"]), len(fields["channels"])
            fields["peak"] = Peak(decode_peak(content, slope_areas(*edges), shape), *edges)
    fields["parts"] = {name: _table(record, f"{prefix}{name}/", group, path) for name in names}
    with at(prefix):
        return Table(**fields)


@contextmanager
def _undamaged(path: Path, prefix: str) -> Iterator[None]:
    try:
        yield
    except (KeyError, TypeError, ValueError, ArithmeticError, RecursionError) as error:
        reason = f"{error} is missing" if isinstance(error, KeyError) else error
        where = f"{_NAME}/{prefix}".rstrip("/")
        raise InputError(f"{path}: {where}: damaged content ({reason}); compress the table again") from error


def _checked(record: Content) -> dict[str, Any]:
    """A table's fields, of the right types; `Table` checks what they hold."""
    fields: dict[str, Any] = {n: _array(record[n], n) for n in _AXES if n in record}
    fields["channels"] = tuple(str(name) for name in record["channels"])
    for name in _AXES[:3]:
        if fields[name].ndim == 0:
            raise ValueError(f"{name} is a single number")
    fields |= _numbers(record, (len(fields["theta_i"]), len(fields["channels"])))
    if "wavelengths_nm" in record:
        fields["wavelengths_nm"] = tuple(float(w) for w in record["wavelengths_nm"])
    if "gaps" in record:
        from gonio.table.compress.packing import unpack_flags

        cells = tuple(len(fields[name]) - (name != "theta_i") for name in _AXES[:3])
        if math.prod(cells) > _MOST_GAPS:
            raise ValueError(f"gaps of {cells} cells")
        fields["gaps"] = unpack_flags(record["gaps"], cells)
    for name in _FACTS:
        if not isinstance(record[name], dict):
            raise ValueError(f"{name} is no object")
        fields[name] = record[name]
    return fields


def _numbers(record: Content, shape: tuple[int, int]) -> dict[str, Array]:
    """Albedo, delta term and their error bars, of as many rows and channels."""
    from gonio.table.compress.codes import Steps

    if math.prod(shape) > _MOST_NUMBERS:
        raise ValueError(f"{shape} rows and channels")
    found = {_CELLS: np.zeros(shape), "specular": np.zeros(shape)}
    for name in record.keys() & _STEPS:
        item = _array(record[name], name)
        found[name] = Steps.read(record, name, shape, _STEPS[name]).values if item.dtype == np.uint8 else item
        if found[name].shape != shape:
            raise ValueError(f"{name} of shape {found[name].shape} for {shape} rows and channels")
    return {"row_albedo": found.pop(_CELLS) + found["specular"], **found}


def _array(item: Any, name: str) -> NDArray:
    if not isinstance(item, np.ndarray):
        raise InputError(f"{_NAME}/{name} is no array; compress the table again")
    return item
