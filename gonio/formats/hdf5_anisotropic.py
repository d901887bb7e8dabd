"""Anisotropic tables in HDF5, in the manner of `gonio.formats.hdf5`, under a format name of their own.

Datasets carry the field names of `AnisotropicTable`, their units, and a dimension scale on every axis; `tilt_x` and
`tilt_y` (middles of the cells) and `channel` exist as scales, the edges are what is read back. Cells are float32.

Version 2 stretches slopes to the horizon along one axis after the other; version 1 did so radially.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from gonio.formats.hdf5_data import at, child, read_array, read_channels, read_json, write_data, write_scale
from gonio.table.anisotropic import AnisotropicTable
from microgeometry.errors import InputError

FORMAT = "gonio-anisotropic-table"
VERSION = "2.0"
_CONVENTIONS = (
    "energy is the fraction of the light from (theta_i, phi_i) that leaves into each cell, the delta term apart; "
    "phi_i counts from the specimen's x axis; tilt_x, tilt_y are atan(w) of the slopes s = (i + o)_xy / (i + o)_z of "
    "the half vector, w = s but for the horizon, which is sent to infinity (gonio.table.tilts); over its projected "
    "solid angle a cell's energy is the mean BRDF f_r in 1/sr; in parts/transmission o is turned up at the plane"
)
_CELLS = ("theta_i", "phi_i", "tilt_x", "tilt_y", "channel")
_ROWS = ("theta_i", "phi_i", "channel")
_EDGES = ("tilt_x_edges", "tilt_y_edges")
_DATA: dict[str, tuple[str, ...]] = {
    "energy": _CELLS,
    "std_error": _CELLS,
    "row_albedo": _ROWS,
    "albedo_std_error": _ROWS,
    "specular": _ROWS,
    "specular_std_error": _ROWS,
}
_OPTIONAL = "std_error"
_MAX_DEPTH = 8  # of parts in parts: in a damaged file a group may hold itself


def write(file: h5py.File, table: AnisotropicTable) -> None:
    """Write a table and its parts; nothing is lost."""
    file.attrs.update(format=FORMAT, version=VERSION, conventions=_CONVENTIONS)
    _write(file, table)


def read(file: h5py.File, path: Path) -> AnisotropicTable:
    """Read a table; errors as `gonio.formats.hdf5.read`."""
    return _read(file, path, "", 0)


def _write(group: h5py.Group, table: AnisotropicTable) -> None:
    group.attrs.update(ledger=json.dumps(dict(table.ledger)), provenance=json.dumps(dict(table.provenance)))
    for name in ("theta_i", "phi_i", *_EDGES):
        write_scale(group, name, getattr(table, name), "rad")
    for name in _EDGES:
        edges = getattr(table, name)
        write_scale(group, name.removesuffix("_edges"), 0.5 * (edges[1:] + edges[:-1]), "rad")
    write_scale(group, "channel", np.array(table.channels, h5py.string_dtype()), "")
    for name, axes in _DATA.items():
        if (data := getattr(table, name)) is not None:
            write_data(group, name, data, axes, "1")
    if table.wavelengths_nm is not None:
        write_data(group, "wavelengths_nm", np.array(table.wavelengths_nm), ("channel",), "nm")
    if table.parts:
        parts = group.create_group("parts", track_order=True)
        for name, part in table.parts.items():
            _write(parts.create_group(name), part)


def _read(group: h5py.Group, path: Path, where: str, depth: int) -> AnisotropicTable:
    if depth > _MAX_DEPTH:
        raise InputError(f"{path}: {where}: parts in parts, {_MAX_DEPTH} deep; trace the file again")
    fields: dict[str, Any] = {}
    for name in ("theta_i", "phi_i", *_EDGES, *_DATA):
        if name in group:
            fields[name] = read_array(group[name], where + name, path, "fiu")
        elif name != _OPTIONAL:
            raise InputError(
                f"{path}: dataset {where}{name} is missing; the file is incomplete, trace it again"
            )
    fields["channels"] = read_channels(group, path, where)
    if "wavelengths_nm" in group:
        wavelengths = read_array(group["wavelengths_nm"], where + "wavelengths_nm", path, "fiu")
        fields["wavelengths_nm"] = tuple(np.ravel(wavelengths).tolist())
    for name in ("ledger", "provenance"):
        fields[name] = read_json(group, name, path, where)
    if "parts" in group:
        parts = child(group, "parts", path, where)
        fields["parts"] = {
            name: _read(child(parts, name, path, where), path, f"{where}parts/{name}/", depth + 1)
            for name in parts
        }
    with at(where):
        return AnisotropicTable(**fields)
