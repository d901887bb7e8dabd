"""The table's own format: HDF5 with dimension scales, version 1.7.

Root attributes: ``format`` = "gonio-table", ``version``, ``conventions`` (angles and units in words), and
``ledger`` and ``provenance`` as JSON. Datasets carry the field names of `Table`, their ``units``, and a
dimension scale on every axis, so that xarray opens the file with its coordinates. ``theta_r`` and
``delta_phi`` (cell centres) and ``channel`` exist as scales; the edges are what is read back.

The table's parts are groups ``parts/<name>`` of the same schema, each with its own scales, so that xarray opens
a group like the file. A highlight on a grid of its own is the group ``peak`` (see `gonio.table.peak`). Readers
accept any minor version of their own major version. Compressed tables are laid out otherwise, for size
(`gonio.formats.hdf5_compressed`); saved again they become plain ones.

Version 1.1 added parts, version 1.2 the peak, version 1.7 compressed tables as they are now.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from gonio.files import atomic
from gonio.formats import hdf5_anisotropic, hdf5_compressed
from gonio.formats.hdf5_data import (
    at,
    check_links,
    child,
    read_array,
    read_channels,
    read_json,
    write_data,
    write_scale,
)
from gonio.formats.hdf5_heaps import check_heaps
from gonio.table.anisotropic import AnisotropicTable
from gonio.table.peak import Peak
from gonio.table.table import Table
from microgeometry.errors import InputError

FORMAT = "gonio-table"
VERSION = "1.7"
_CONVENTIONS = (
    "values are BRDF f_r in 1/sr without cosine, averaged over cells in projected solid angle; theta_i and "
    "theta_r are polar angles of the outward directions to light and detector; delta_phi = |phi_i - phi_r| "
    "is 0 at retro-reflection and pi on the mirror side; in parts/transmission theta_r is the angle from -z, "
    "and delta_phi = pi is straight through"
)
_GRID = ("theta_i", "theta_r", "delta_phi", "channel")
# Dataset: axes and units. In the order written; the scales come first.
_SCALES = {
    "theta_i": "rad",
    "theta_r": "rad",
    "delta_phi": "rad",
    "theta_i_edges": "rad",
    "theta_r_edges": "rad",
    "delta_phi_edges": "rad",
}
_DATA: dict[str, tuple[tuple[str, ...], str]] = {
    "values": (_GRID, "1/sr"),
    "std_error": (_GRID, "1/sr"),
    "hits": (_GRID[:3], "1"),
    "gaps": (_GRID[:3], "1"),
    "row_albedo": (("theta_i", "channel"), "1"),
    "albedo_std_error": (("theta_i", "channel"), "1"),
    "specular": (("theta_i", "channel"), "1"),
    "specular_std_error": (("theta_i", "channel"), "1"),
    "wavelengths_nm": (("channel",), "nm"),
}
_OPTIONAL = {"theta_i_edges", "std_error", "hits", "gaps", "wavelengths_nm"}
_PEAK_SCALES = {"theta_i": "rad", "slope": "1", "psi": "rad", "slope_edges": "1", "psi_edges": "rad"}
_PEAK_AXES = ("theta_i", "slope", "psi", "channel")
_MAX_DEPTH = 8  # of parts in parts: in a damaged file a group may hold itself


Compressed = Mapping[str, Mapping[str, Any]]


def write(table: Table | AnisotropicTable, path: Path, compressed: Compressed | None = None) -> list[str]:
    """Write a table; nothing is lost.

    Parameters
    ----------
    table : Table or AnisotropicTable
    path : Path
    compressed : mapping of str to mapping, optional
        What stands in for ``values`` in a compressed table (see `gonio.table.compress`): arrays, numbers and
        text by their names. One for the table, under "", and one for each of its parts, under its path
        ("transmission/L1").

    Returns
    -------
    list of str
        Always empty.

    Raises
    ------
    OSError
        The disk is full or the folder missing; whatever stood under `path` before is still there.
    """
    # Built in memory: HDF5 does not survive a disk that fills while it writes, a plain write does
    blocks = 2048 if compressed is None else 0  # of what describes the data
    with h5py.File(
        path.name, "w", driver="core", backing_store=False, libver="v110", meta_block_size=blocks
    ) as file:
        if isinstance(table, AnisotropicTable):
            hdf5_anisotropic.write(file, table)
        elif compressed is not None:
            # texts of a fixed length: others take a heap of 4 kB
            file.attrs.update(format=np.bytes_(FORMAT), version=np.bytes_(VERSION))
            hdf5_compressed.write(file, table, compressed)
        else:
            file.attrs.update(format=FORMAT, version=VERSION, conventions=_CONVENTIONS)
            _write(file, table)
        file.flush()
        image = file.id.get_file_image()
    with atomic(path) as temporary:
        temporary.write_bytes(image)
    return []


def read(path: Path) -> Table | AnisotropicTable:
    """Read a table.

    Raises
    ------
    InputError
        Missing, not HDF5, truncated, not a table, of a newer major version, or a dataset that is missing,
        of a wrong shape or type, or holds NaN: one line with file, dataset, expectation and remedy.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    check_heaps(path)
    try:
        with h5py.File(path, "r") as file:
            anisotropic = _is_anisotropic(file, path)
            check_links(file, path)
            if anisotropic:
                return hdf5_anisotropic.read(file, path)
            if hdf5_compressed.holds(file):
                return hdf5_compressed.read(file, path, _version(file))
            return _read(file, path)
    except InputError as error:
        text = str(error)
        raise InputError(text if text.startswith(str(path)) else f"{path}: {text}") from error
    except (OSError, KeyError, RuntimeError, ValueError, TypeError) as error:  # also text that is not UTF-8
        with open(path, "rb") as raw:
            signed = raw.read(8) == b"\x89HDF\r\n\x1a\n"
        if not signed:
            raise InputError(
                f"{path}: not an HDF5 file; a table written by `gonio trace` or `gonio convert` is expected"
            ) from None
        reason = " ".join(str(error).split())
        raise InputError(
            f"{path}: damaged or truncated HDF5 file ({reason}); copy or trace it again"
        ) from error


def _write(group: h5py.Group, table: Table) -> None:
    """Write a table and its parts into the file, or a part into its group."""
    group.attrs.update(ledger=json.dumps(dict(table.ledger)), provenance=json.dumps(dict(table.provenance)))
    for name, unit in _SCALES.items():
        if (axis := getattr(table, name)) is not None:
            write_scale(group, name, axis, unit)
    write_scale(group, "channel", np.array(table.channels, h5py.string_dtype()), "")
    for name, (axes, unit) in _DATA.items():
        if (data := getattr(table, name)) is not None:
            write_data(group, name, np.asarray(data), axes, unit)
    if table.peak is not None:
        _write_peak(group.create_group("peak"), table, table.peak)
    if table.parts:
        parts = group.create_group("parts", track_order=True)
        for name, part in table.parts.items():
            _write(parts.create_group(name), part)


def _write_peak(group: h5py.Group, table: Table, peak: Peak) -> None:
    middles = {
        name: 0.5 * (e[1:] + e[:-1]) for name, e in (("slope", peak.slope_edges), ("psi", peak.psi_edges))
    }
    scales = {
        "theta_i": table.theta_i,
        "slope_edges": peak.slope_edges,
        "psi_edges": peak.psi_edges,
        **middles,
    }
    for name, unit in _PEAK_SCALES.items():
        write_scale(group, name, scales[name], unit)
    write_scale(group, "channel", np.array(table.channels, h5py.string_dtype()), "")
    for name in ("values", "std_error"):
        if (data := getattr(peak, name)) is not None:
            write_data(group, name, data, _PEAK_AXES, "1")


def _read_peak(group: h5py.Group, path: Path, where: str) -> Peak:
    fields = {}
    for name in ("slope_edges", "psi_edges", "values", "std_error"):
        if name in group:
            fields[name] = read_array(group[name], where + name, path, "fiu")
        elif name != "std_error":
            raise InputError(
                f"{path}: dataset {where}{name} is missing; the file is incomplete, trace it again"
            )
    return Peak(**fields)


def _is_anisotropic(file: h5py.File, path: Path) -> bool:
    """Check what the file says it is."""
    found = _text(file.attrs.get("format"))
    if not isinstance(found, str) or found not in (FORMAT, hdf5_anisotropic.FORMAT):
        names = ", ".join(sorted(file)[:6]) or "nothing"
        raise InputError(
            f"{path}: an HDF5 file of something else (it holds {names}); a BRDF table has the attribute "
            f"format = {FORMAT!r}"
        )
    version = _version(file)
    own = VERSION if found == FORMAT else hdf5_anisotropic.VERSION
    major, current = version.partition(".")[0], int(own.partition(".")[0])
    if not major.isdigit():
        raise InputError(f"{path}: attribute version is {version!r}; {own!r} is expected; trace it again")
    if int(major) > current:
        raise InputError(f"{path}: table version {version} is newer than {own}, update gonio to read it")
    if int(major) < current:
        raise InputError(
            f"{path}: table version {version} has its cells laid out otherwise than {own}; trace it again"
        )
    return found == hdf5_anisotropic.FORMAT


def _version(file: h5py.File) -> str:
    return str(_text(file.attrs.get("version", "")))


def _text(attribute: Any) -> Any:
    """Texts of a fixed length are bytes."""
    return attribute.decode() if isinstance(attribute, bytes) else attribute


def _read(group: h5py.Group, path: Path, where: str = "") -> Table:
    """The table in the file or in the group of a part, whose place `where` ends in a slash."""
    fields: dict[str, Any] = {}
    kinds = {"hits": "iu", "gaps": "iub"}
    for name in ("theta_i", "theta_i_edges", "theta_r_edges", "delta_phi_edges", *_DATA):
        if name not in group:
            if name in _OPTIONAL:
                continue
            raise InputError(
                f"{path}: dataset {where}{name} is missing; the file is incomplete, trace it again"
            )
        fields[name] = read_array(group[name], where + name, path, kinds.get(name, "fiu"))
    fields["channels"] = read_channels(group, path, where)
    for name in ("ledger", "provenance"):
        fields[name] = read_json(group, name, path, where)
    if (wavelengths := fields.get("wavelengths_nm")) is not None:
        fields["wavelengths_nm"] = tuple(np.ravel(wavelengths).tolist())
    if "peak" in group:
        with at(where):
            fields["peak"] = _read_peak(child(group, "peak", path, where), path, f"{where}peak/")
    if "parts" in group:
        fields["parts"] = _read_parts(child(group, "parts", path, where), path, f"{where}parts/")
    with at(where):
        return Table(**fields)


def _read_parts(parts: h5py.Group, path: Path, where: str) -> dict[str, Table]:
    if (where.count("/") + 1) // 2 > _MAX_DEPTH:
        raise InputError(f"{path}: {where}: parts in parts, {_MAX_DEPTH} deep; trace the file again")
    return {name: _read(child(parts, name, path, where), path, f"{where}{name}/") for name in parts}
