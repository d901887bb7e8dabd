"""Compression of tables with a bound on the error, checked after writing.

The error of a row of incidence and channel is relative and cosine-weighted,
E = ||f' - f|| / ||f||, norms over the row's cells in projected solid angle (cosine times solid angle). Each row is
held to max_error, or to its own noise where that is larger: to follow noise more closely than its error bar
would store chance. So is its albedo, the sum over its cells.

A method has ``encode(table, bounds, quick) -> content``, the content a mapping of arrays, numbers and text,
and ``decode(content, fields) -> values``; it is one line in `METHODS`. Other packages register theirs under
the entry points ``gonio.compression``: modules that add their line when they are imported. The file is an
HDF5 table that holds the content in place of its values (see `gonio.formats.hdf5`): `Table.load` opens it
like any other. The table's parts are in the same file, each held to the bound as a table of its own.
Axes, gaps, ledger and provenance are kept in full, albedo and delta term to a millionth; the cells of a highlight's
own grid are held to the rows' bounds on their own (`highlight`). Error bars of cells and hits are
dropped; what is known of the error stands in ``provenance["compression"]``.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gonio.core.parallel import processors
from gonio.files import atomic
from gonio.formats import hdf5
from gonio.formats.hdf5_content import stored_bytes
from gonio.table.compress import codecs, dct, highlight, low_rank, tree
from gonio.table.compress.metric import cosine_weights, excess, row_bounds, row_errors, row_noise
from gonio.table.parts import walk
from gonio.table.table import Table
from microgeometry.errors import InputError

__all__ = [
    "AUTO",
    "METHODS",
    "CompressionReport",
    "Method",
    "compress",
    "cosine_weights",
    "decode",
    "decode_peak",
    "methods",
    "row_bounds",
    "row_errors",
    "row_noise",
]


_TRIALS_AT_ONCE = 4


class Method(Protocol):
    """A method of compression: a module, or an object like one."""

    def encode(self, table: Table, bounds: NDArray, quick: bool = ..., /) -> dict[str, Any]:
        """Content whose decoded values hold the bounds, shape (I, C); InputError where it cannot.

        `quick`: the size need only be good enough to compare methods by.
        """

    def decode(self, content: Mapping[str, Any], fields: Mapping[str, Any], /) -> NDArray[np.float64]:
        """Values, shape (I, R, P, C), from the content and the table's other fields.

        KeyError, TypeError, ValueError, ArithmeticError, OSError or EOFError: the content is damaged.
        """


METHODS: dict[str, Method] = {
    "tree": tree,
    "dct": dct,
    "low_rank": low_rank,
    "zfp": codecs.ZFP,
    "sz3": codecs.SZ3,
    "blosc2": codecs.BLOSC2,
}
"""Methods by the name a file gives to the one that wrote it; see `methods` for those of other packages."""

AUTO = "auto"
"""In place of a method's name: the one of the smallest file."""

FALLBACK = "tree"
"""For a part of a table that the method chosen for the table cannot hold to its bound."""


@dataclass(frozen=True)
class CompressionReport:
    """What compression reached over the table and all its parts, measured on the file as read back.

    Parameters
    ----------
    bytes : int
        Size of the file.
    content : int
        Of these, what stands for the values.
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
        The one used, also where the best was asked for.
    sizes : dict of str to int
        Where the best was asked for: bytes of the content by method, of quick trials; without those that
        cannot hold the bound.
    """

    bytes: int
    content: int
    ratio: float
    max_error: float
    error_worst: float
    error_median: float
    noise_worst: float
    noise_median: float
    albedo_error: float
    method: str
    sizes: dict[str, int]


def methods() -> dict[str, Method]:
    """`METHODS` with those that installed packages register."""
    for entry in entry_points(group="gonio.compression"):
        entry.load()
    return METHODS


def compress(
    table: Table, path: str | os.PathLike[str], max_error: float = 0.01, method: str = AUTO
) -> CompressionReport:
    """Write a compressed table (.h5) that holds the error bound.

    Parameters
    ----------
    table : Table
    path : path
    max_error : float
        Largest relative, cosine-weighted RMS error of any row and channel, and largest relative error of its
        albedo; rows noisier than that are held to their noise (`row_bounds`).
    method : str
        One of `methods`, or "auto": each is tried, and the one of the smallest content is used.

    Returns
    -------
    CompressionReport

    Raises
    ------
    InputError
        A suffix other than .h5, an unknown method, a bound outside 1e-6 to 1, or one that the method cannot
        hold.
    OSError
        The file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".h5":
        raise InputError(f"{path}: a compressed table is an HDF5 file, its suffix must be .h5")
    if not 1e-6 <= max_error <= 1:
        raise InputError(f"max_error: {max_error}; a number from 1e-6 to 1 is expected")
    known = methods()
    if method not in (AUTO, *known):
        raise InputError(f"method: {method!r} is unknown; allowed are {AUTO}, {', '.join(known)}")
    tables = {"": table, **dict(walk(table))}
    noise = {part: row_noise(t) for part, t in tables.items()}
    bounds = {part: row_bounds(t, max_error) for part, t in tables.items()}
    sizes: dict[str, int] = {}
    if method == AUTO:
        sizes = trial_sizes(table, bounds[""])
        if not sizes:
            raise InputError(f"max_error: {max_error}; no method holds it, allow more")
        method = min(sizes, key=lambda name: sizes[name])
    content = {
        part: _content(t, bounds[part], method, FALLBACK if sizes else None) for part, t in tables.items()
    }
    for part, t in tables.items():
        if t.peak is not None:
            content[part] |= highlight.encode(t.peak, bounds[part])
    facts = {
        part: {
            "method": content[part]["method"],
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
        assert isinstance(written, Table)  # as it was written
        decoded = {"": written, **dict(walk(written))}
        errors = {part: row_errors(t, decoded[part].values) for part, t in tables.items()}
        worst = max(float(excess(t, decoded[part].values, bounds[part]).max()) for part, t in tables.items())
        if worst > 1 + 1e-9:
            raise RuntimeError(
                f"{path}: {method} exceeds its bound by a factor of {worst:.3g} when read back"
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
        content=sum(stored_bytes(each) for each in content.values()),
        ratio=4 * table.values.size * len(tables) / size,
        max_error=max_error,
        error_worst=float(every_error.max()),
        error_median=float(np.median(every_error)),
        noise_worst=float(every_noise.max()),
        noise_median=float(np.median(every_noise)),
        albedo_error=float(max(albedo_errors)),
        method=method,
        sizes=sizes,
    )


def _content(table: Table, bounds: NDArray, method: str, fallback: str | None) -> dict[str, Any]:
    """What stands for the values; by `fallback`, if any, where the method cannot hold the bounds."""
    try:
        return {"method": method, **METHODS[method].encode(table, bounds)}
    except InputError:
        if fallback is None or fallback == method:
            raise
    return {"method": fallback, **METHODS[fallback].encode(table, bounds)}


def trial_sizes(table: Table, bounds: NDArray[np.float64]) -> dict[str, int]:
    """Bytes of content by method, of a quick trial of each; without those that cannot hold the bounds."""

    def size(method: Method) -> int | None:
        try:
            return stored_bytes(method.encode(table, bounds, True))
        except InputError:
            return None

    known = methods()
    # a trial takes some ten times the table's memory, and most of its time numpy's, without Python's lock
    with ThreadPoolExecutor(min(_TRIALS_AT_ONCE, processors())) as pool:
        sizes = dict(zip(known, pool.map(size, known.values()), strict=True))
    return {name: found for name, found in sizes.items() if found is not None}


def _slim(table: Table, facts: Mapping[str, Any], path: str = "") -> Table:
    """The table and its parts without error bars of cells and hits, with the facts of each by its path."""
    parts = {name: _slim(part, facts, f"{path}/{name}".lstrip("/")) for name, part in table.parts.items()}
    provenance = {**table.provenance, "compression": facts[path]}
    peak = None if table.peak is None else replace(table.peak, std_error=None)
    return table.replace(std_error=None, hits=None, peak=peak, provenance=provenance, parts=parts)


def decode(content: Mapping[str, Any], fields: Mapping[str, Any]) -> NDArray[np.float64]:
    """Values from a compressed file's content and the table's other fields, shape (I, R, P, C).

    Raises
    ------
    InputError
        An unknown method, or content that does not fit the axes.
    """
    method = content.get("method")
    known = METHODS if method in METHODS else methods()
    if method not in known:
        raise InputError(
            f"compressed: method {method!r} is unknown; this version reads {', '.join(known)}, update gonio"
        )
    with _undamaged():
        return known[method].decode(content, fields)


def decode_peak(
    content: Mapping[str, Any], areas: NDArray[np.float64], shape: tuple[int, int]
) -> NDArray[np.float64]:
    """Values of a highlight's own cells, of as many rows and channels, as `decode`; `areas` as `Peak.areas`."""
    with _undamaged():
        return highlight.decode(content, areas, shape)


@contextmanager
def _undamaged() -> Iterator[None]:
    try:
        yield
    except (KeyError, TypeError, ValueError, ArithmeticError, OSError, EOFError) as error:
        raise InputError(f"compressed: damaged content ({error}); compress the table again") from error
