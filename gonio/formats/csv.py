"""CSV files: a line of names, then one line for each cell, with error bars; readable by anything.

Columns: theta_i_deg, theta_r_deg, delta_phi_deg, then for each channel its name and, where error bars are
known, its name with ``_std_error``. Values are f in 1/sr without cosine; delta_phi is 0 at
retro-reflection. Cells that are gaps have no line. What the columns cannot say stands in front, in lines of
``# name: JSON``: the cells' edges, albedo, delta term, wavelengths, and how many lines of cells follow.
Without those lines the numbers are taken as samples, and a cell is put around each; so any list of measurements
with these columns is read.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.files import atomic
from gonio.formats.cells import check_size, justified_bytes
from gonio.formats.losses import common_losses
from gonio.formats.points import table_from_points
from gonio.formats.samples import Samples
from gonio.formats.text import content, to_numbers
from gonio.table.table import Table
from microgeometry.errors import InputError

Array = NDArray[np.float64]

_ANGLES = ("theta_i_deg", "theta_r_deg", "delta_phi_deg")
_ERROR = "_std_error"
_EDGES = ("theta_i_edges", "theta_r_edges", "delta_phi_edges")
_ROWS = ("row_albedo", "albedo_std_error", "specular", "specular_std_error")


def read(path: Path) -> Table:
    """Read a CSV file.

    Raises
    ------
    InputError
        A column that is missing, a line of another length, or no numbers.
    """
    notes, samples, std_error, channels, fields = _read(path)
    if "theta_r_edges" in notes:
        return _from_cells(path, notes, samples, std_error, channels, fields)
    return table_from_points(path, samples, channels, std_error, **fields)


def samples_of(path: Path) -> dict[str, Samples]:
    """The file's samples, as `gonio.formats` has them, none where they are cells; errors as `read`."""
    notes, samples, *_ = _read(path)
    return {} if "theta_r_edges" in notes else {"": samples}


def _read(path: Path) -> tuple[dict[str, Any], Samples, Array | None, tuple[str, ...], dict[str, Any]]:
    """Notes, samples, their error bars, channels, and the other fields of `Table`."""
    text = content(path).decode("utf-8", "replace")
    lines = text.splitlines()
    notes = _notes([line for line in lines if line.startswith("#")], path)
    lines = [line for line in lines if line.strip() and not line.startswith("#")]
    if not lines:
        raise InputError(f"{path}: empty; a line of column names is expected")
    names = [name.strip() for name in lines[0].split(",")]
    for name in _ANGLES:
        if names.count(name) != 1:
            raise InputError(
                f"{path}: {names.count(name)} columns {name}; the columns are {', '.join(names)[:200]}"
            )
    columns = {name: n for n, name in enumerate(names)}
    channels = [n for n in names if n not in _ANGLES and not n.endswith(_ERROR)]
    if not channels or len(columns) != len(names) or "" in channels:
        raise InputError(
            f"{path}: columns of values with a name each are expected beside {', '.join(_ANGLES)}"
        )
    words = ",".join(lines[1:]).split(",") if len(lines) > 1 else []
    if "lines" in notes and (notes["lines"] != len(lines) - 1 or not text.endswith("\n")):
        raise InputError(
            f"{path}: {len(lines) - 1} lines of cells, its line # lines says {str(notes['lines'])[:20]}; "
            "it is truncated, copy it again"
        )
    if len(words) != (len(lines) - 1) * len(names) or any(
        line.count(",") != len(names) - 1 for line in lines
    ):
        raise InputError(f"{path}: lines of other than {len(names)} columns")
    numbers = to_numbers(words, "the columns", path, infinite=True).reshape(-1, len(names))
    if not np.all(np.isfinite(numbers[:, [n for n, name in enumerate(names) if not name.endswith(_ERROR)]])):
        raise InputError(f"{path}: the columns hold infinity; it is allowed in error bars")
    values = numbers[:, [columns[c] for c in channels]]
    errors = [columns[c + _ERROR] for c in channels if c + _ERROR in columns]
    if len(errors) not in (0, len(channels)):
        raise InputError(
            f"{path}: {len(errors)} columns of error bars for {len(channels)} channels; all or none"
        )
    std_error = numbers[:, errors] if errors else None
    angles = [np.radians(numbers[:, columns[name]]) for name in _ANGLES]
    provenance = {"source": path.name, "format": "CSV"}
    wavelengths = _numbers(notes, "wavelengths_nm", path)
    fields: dict[str, Any] = {"provenance": provenance}
    fields["wavelengths_nm"] = None if wavelengths is None else tuple(np.ravel(wavelengths).tolist())
    return notes, Samples(angles[0], angles[1], angles[2], values), std_error, tuple(channels), fields


def write(table: Table, path: Path) -> list[str]:
    """Write the cells of a table.

    Returns
    -------
    list of str
        What was lost.

    Raises
    ------
    InputError
        A channel whose name cannot be a column's, or a table of so many gaps that the file would not be read.
    OSError
        The file cannot be written.
    """
    for name in table.channels:
        if not name.strip() or any(c in name for c in ',"\n\r#') or name.endswith(_ERROR) or name in _ANGLES:
            raise InputError(f"{path}: a channel named {name!r} cannot be a column; rename it")
    if len(set(table.channels)) != len(table.channels):
        raise InputError(f"{path}: channels {table.channels} of one name cannot be columns; rename them")
    known = np.ones(table.values.shape[:3], bool) if table.gaps is None else ~table.gaps
    angles = np.meshgrid(table.theta_i, table.theta_r, table.delta_phi, indexing="ij")
    columns = [np.degrees(a[known]) for a in angles]
    names = list(_ANGLES)
    for c, name in enumerate(table.channels):
        columns.append(table.values[known, c])
        names.append(name)
        if table.std_error is not None:
            columns.append(table.std_error[known, c])
            names.append(name + _ERROR)
    notes: dict[str, Any] = {"lines": int(known.sum()), "theta_i": np.degrees(table.theta_i).tolist()}
    for name in _EDGES:
        if (edges := getattr(table, name)) is not None:
            notes[name] = np.degrees(edges).tolist()
    notes |= {name: getattr(table, name).tolist() for name in _ROWS}
    if table.wavelengths_nm is not None:
        notes["wavelengths_nm"] = list(table.wavelengths_nm)
    with atomic(path) as temporary, open(temporary, "w", encoding="utf-8") as file:
        file.write("# BRDF table by gonio: f_r in 1/sr without cosine; delta_phi is 0 at retro-reflection\n")
        for name, value in notes.items():
            file.write(f"# {name}: {json.dumps(value)}\n")
        file.write(",".join(names) + "\n")
        np.savetxt(
            file, np.column_stack(columns), fmt=["%.10g"] * 3 + ["%.9g"] * (len(names) - 3), delimiter=","
        )
        file.flush()
        if 8 * table.values.size > justified_bytes(temporary):
            raise InputError(
                f"{path}: {known.sum()} of {known.size} cells are no gaps: a CSV of so few lines for so many cells "
                "would be taken for damaged; write .h5 or .npz"
            )
    losses = common_losses(table, "CSV", keeps=("error bars", "delta", "wavelengths", "gaps", "rows"))
    if table.hits is not None:
        losses.append("the number of paths in each cell")
    return [*losses, "provenance and ledger"]


def _notes(lines: list[str], path: Path) -> dict[str, Any]:
    notes = {}
    for line in lines:
        name, colon, text = line[1:].partition(":")
        if colon and name.strip() in (*_EDGES, *_ROWS, "theta_i", "wavelengths_nm", "lines"):
            try:
                notes[name.strip()] = json.loads(text)
            except (ValueError, RecursionError) as error:
                raise InputError(f"{path}: line # {name.strip()}: no JSON; copy the file again") from error
    return notes


def _numbers(notes: dict[str, Any], name: str, path: Path) -> Array | None:
    if name not in notes:
        return None
    try:
        found = np.array(notes[name], dtype=float)
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(f"{path}: line # {name}: numbers are expected") from error
    if found.size == 0 or not np.all(np.isfinite(found)):
        raise InputError(f"{path}: line # {name}: finite numbers are expected")
    return found


def _from_cells(
    path: Path,
    notes: dict[str, Any],
    samples: Samples,
    std_error: Array | None,
    channels: tuple[str, ...],
    fields: dict[str, Any],
) -> Table:
    """The table whose edges stand in front of the columns."""
    axes: dict[str, Array] = {}
    for name in ("theta_i", *_EDGES):
        found = _numbers(notes, name, path)
        if found is not None:
            axes[name] = np.radians(np.ravel(found))
        elif name != "theta_i_edges":
            raise InputError(f"{path}: line # {name} is missing; with theta_r_edges all of them are expected")
    shape = (len(axes["theta_i"]), len(axes["theta_r_edges"]) - 1, len(axes["delta_phi_edges"]) - 1)
    check_size(path, float(np.prod(shape)) * len(channels), "the edges")
    if min(shape) < 1:
        raise InputError(f"{path}: edges of no cells")
    nodes = (axes["theta_i"], *(0.5 * (axes[e][1:] + axes[e][:-1]) for e in _EDGES[1:]))
    index = []
    angles = samples.theta_i, samples.theta_r, samples.delta_phi
    for name, node, angle in zip(_ANGLES, nodes, angles, strict=True):
        nearest = (
            np.abs(angle[:, None] - node).argmin(axis=1)
            if angle.size * node.size < 1e7
            else _nearest(node, angle)
        )
        if np.any(np.abs(node[nearest] - angle) > 1e-6):
            raise InputError(f"{path}: column {name}: angles that are not those of the lines in front")
        index.append(nearest)
    place = np.ravel_multi_index(tuple(index), shape)
    gaps = np.ones(int(np.prod(shape)), bool)
    gaps[place] = False
    full = np.zeros((gaps.size, len(channels)))
    full[place] = samples.values
    if std_error is not None:
        errors = np.full(full.shape, np.inf)
        errors[place] = std_error
        fields["std_error"] = errors.reshape(*shape, -1)
    for name in _ROWS:
        if (found := _numbers(notes, name, path)) is not None:
            fields[name] = found
    fields.setdefault("row_albedo", np.zeros((shape[0], len(channels))))
    for name in axes:
        fields[name] = axes[name]
    try:
        return Table(
            values=full.reshape(*shape, -1),
            channels=channels,
            gaps=gaps.reshape(shape) if gaps.any() else None,
            **fields,
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _nearest(nodes: Array, angles: Array) -> NDArray[np.int64]:
    """Index of the nearest of increasing nodes."""
    high = np.clip(np.searchsorted(nodes, angles), 1, max(1, len(nodes) - 1))
    high = np.minimum(high, len(nodes) - 1)
    low = np.maximum(high - 1, 0)
    return np.where(np.abs(nodes[low] - angles) <= np.abs(nodes[high] - angles), low, high)
