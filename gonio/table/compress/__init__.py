"""Compression of tables with a bound on the error, checked after writing.

The error of a row of incidence and channel is relative and cosine-weighted,
E = ||f' - f|| / ||f||, norms over the row's cells in projected solid angle (cosine times solid angle). Each row is
held to max(max_error, its own noise): to follow noise more closely than its error bar would store chance.

A method is a module with ``encode(table, bound) -> content``, the content a mapping of arrays,
numbers and text, and ``decode(content, fields) -> values``; it is one line in `METHODS`. The file is an
HDF5 table that holds the content in place of its values (see `gonio.formats.hdf5`): `Table.load` opens it
like any other. The table's parts are in the same file, each held to the bound as a table of its own.
Albedo, delta term, axes, gaps, ledger and provenance are kept in full; error bars of cells and hits are
dropped, and what is known of the error stands in ``provenance["compression"]``.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.files import atomic
from gonio.formats import hdf5
from gonio.table.compress import dct
from gonio.table.compress.metric import cosine_weights, row_errors, row_noise
from gonio.table.parts import walk
from gonio.table.table import Table
from microgeometry.errors import InputError

__all__ = ["METHODS", "CompressionReport", "compress", "cosine_weights", "decode", "row_errors", "row_noise"]

METHODS: dict[str, ModuleType] = {"dct": dct}
"""Methods by the name a file gives to the one that wrote it."""


@dataclass(frozen=True)
class CompressionReport:
    """What compression reached over the table and all its parts, measured on the file as read back.

    Parameters
    ----------
    bytes : int
        Size of the file.
    ratio : float
        Size of all values as float32 over the size of the file.
    max_error : float
        The bound asked for.
    error_worst, error_median : float
        Over rows and channels of all: relative, cosine-weighted RMS error against the original.
    noise_worst, noise_median : float
        The original's own noise in the same measure; 0 where it has no error bars.
    albedo_error : float
        Largest difference of a row's albedo, summed over the cells, from the original's.
    method : str
    """

    bytes: int
    ratio: float
    max_error: float
    error_worst: float
    error_median: float
    noise_worst: float
    noise_median: float
    albedo_error: float
    method: str


def compress(
    table: Table, path: str | os.PathLike[str], max_error: float = 0.01, method: str = "dct"
) -> CompressionReport:
    """Write a compressed table (.h5) that holds the error bound.

    Parameters
    ----------
    table : Table
    path : path
    max_error : float
        Largest relative, cosine-weighted RMS error of any row and channel; rows noisier than that are held
        to their noise.
    method : str
        One of `METHODS`.

    Returns
    -------
    CompressionReport

    Raises
    ------
    InputError
        A suffix other than .h5, an unknown method, or a bound outside 1e-6 to 1.
    OSError
        The file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".h5":
        raise InputError(f"{path}: a compressed table is an HDF5 file, its suffix must be .h5")
    if not 1e-6 <= max_error <= 1:
        raise InputError(f"max_error: {max_error}; a number from 1e-6 to 1 is expected")
    if method not in METHODS:
        raise InputError(f"method: {method!r} is unknown; allowed are {', '.join(METHODS)}")
    tables = {"": table, **dict(walk(table))}
    noise = {part: row_noise(t) for part, t in tables.items()}
    bounds = {part: np.maximum(max_error, n) for part, n in noise.items()}
    content = {
        part: {"method": method, **METHODS[method].encode(t, bounds[part])} for part, t in tables.items()
    }
    facts = {
        part: {
            "method": method,
            "max_error": max_error,
            "noise_worst": float(noise[part].max()),
            "noise_median": float(np.median(noise[part])),
            "cells_had_std_error": t.std_error is not None,
        }
        for part, t in tables.items()
    }
    with atomic(path) as temporary:
        hdf5.write(_slim(table, facts), temporary, content)
        written = hdf5.read(temporary)
        decoded = {"": written, **dict(walk(written))}
        errors = {part: row_errors(t, decoded[part].values) for part, t in tables.items()}
        excess = max(float(np.max(errors[part] / bounds[part])) for part in tables)
        if excess > 1 + 1e-9:
            raise RuntimeError(
                f"{path}: {method} exceeds its bound by a factor of {excess:.3g} when read back"
            )
    areas = table.projected_solid_angles
    albedo_errors = [
        np.abs(np.einsum("irpc,rp->ic", decoded[part].values - t.values, areas)).max()
        for part, t in tables.items()
    ]
    every_error, every_noise = (np.stack([*of.values()]) for of in (errors, noise))
    size = path.stat().st_size
    return CompressionReport(
        bytes=size,
        ratio=4 * table.values.size * len(tables) / size,
        max_error=max_error,
        error_worst=float(every_error.max()),
        error_median=float(np.median(every_error)),
        noise_worst=float(every_noise.max()),
        noise_median=float(np.median(every_noise)),
        albedo_error=float(max(albedo_errors)),
        method=method,
    )


def _slim(table: Table, facts: Mapping[str, Any], path: str = "") -> Table:
    """The table and its parts without error bars of cells and hits, with the facts of each by its path."""
    parts = {name: _slim(part, facts, f"{path}/{name}".lstrip("/")) for name, part in table.parts.items()}
    provenance = {**table.provenance, "compression": facts[path]}
    return table.replace(std_error=None, hits=None, provenance=provenance, parts=parts)


def decode(content: Mapping[str, Any], fields: Mapping[str, Any]) -> NDArray[np.float64]:
    """Values from a compressed file's content and the table's other fields, shape (I, R, P, C).

    Raises
    ------
    InputError
        An unknown method, or content that does not fit the axes.
    """
    method = content.get("method")
    if method not in METHODS:
        raise InputError(
            f"compressed: method {method!r} is unknown; this version reads {', '.join(METHODS)}, update gonio"
        )
    return METHODS[method].decode(content, fields)
