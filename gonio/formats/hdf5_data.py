"""Datasets of tables in HDF5: written with units and scales, read with one clear error."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from gonio.formats.hdf5_content import chunk_checksum
from microgeometry.errors import InputError

# Deflate cannot shrink more than this; a dataset that claims more is damaged or hostile.
_MAX_RATIO = 1100
_LAST_OWN_FILTER = 255  # codes from 256 on are registered by others


def write_scale(group: h5py.Group, name: str, data: NDArray, unit: str) -> None:
    """Write an axis as a dimension scale."""
    group[name] = data
    group[name].make_scale(name)
    if unit:
        group[name].attrs["units"] = unit


def write_data(group: h5py.Group, name: str, data: NDArray, axes: tuple[str, ...], unit: str) -> None:
    """Write an array on scales that stand in the group."""
    options: dict[str, Any] = {}
    if data.ndim >= 2:
        # One row of incidence a chunk, as large as one is read at a time. Level 1: level 4 saves 2 % more.
        chunks = (1, *data.shape[1:]) if data.ndim >= 3 else data.shape
        options = {"chunks": chunks, "shuffle": True, "compression": "gzip", "compression_opts": 1}
    if data.dtype == bool:
        data = data.astype(np.uint8)
    dataset = group.create_dataset(name, data=data, **options)
    dataset.attrs["units"] = unit
    for axis, scale in enumerate(axes):
        dataset.dims[axis].label = scale
        dataset.dims[axis].attach_scale(group[scale])


@contextmanager
def at(where: str) -> Iterator[None]:
    """Put the place in the file in front of errors that only know the field."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{where}{error}") from error


def check_links(file: h5py.File, path: Path) -> None:
    """Refuse a file that reaches a group or dataset by more than one link: it would be read as often.

    Raises
    ------
    InputError
        More links than objects; soft and external ones have none.
    """
    links, objects = len(file), 0

    def count(_: str, found: Any) -> None:
        nonlocal links, objects
        objects += 1
        links += len(found) if isinstance(found, h5py.Group) else 0

    file.visititems(count)
    if links != objects:
        raise InputError(
            f"{path}: {links} links to {objects} groups and datasets; one to each is expected; copy or trace the "
            "file again"
        )


def child(group: h5py.Group, name: str, path: Path, where: str) -> h5py.Group:
    """A group in a group."""
    found = group[name]
    if not isinstance(found, h5py.Group):
        raise InputError(f"{path}: {where}{name} is a dataset; a group is expected; trace the file again")
    return found


def read_array(dataset: Any, name: str, path: Path, kinds: str, room: int = 0) -> NDArray:
    """All of a dataset of numbers of the `kinds`; at most `room` bytes beyond what the file can hold."""
    if not isinstance(dataset, h5py.Dataset) or dataset.dtype.kind not in kinds:
        found = dataset.dtype if isinstance(dataset, h5py.Dataset) else "a group"
        want = "integers" if "f" not in kinds else "numbers"
        raise InputError(f"{path}: dataset {name} holds {found}; {want} are expected")
    if dataset.nbytes > max(_MAX_RATIO * path.stat().st_size, room):
        raise InputError(
            f"{path}: dataset {name} claims shape {dataset.shape}, more than a file of "
            f"{path.stat().st_size} bytes can hold; copy or trace the file again"
        )
    try:
        if _foreign(dataset) and dataset.attrs.get("crc32") != chunk_checksum(dataset):
            raise OSError("its checksum is another")
        return dataset[()]
    except OSError as error:
        reason = " ".join(str(error).split())
        raise InputError(
            f"{path}: dataset {name} is damaged or truncated ({reason}); copy or trace the file again"
        ) from error


def _foreign(dataset: h5py.Dataset) -> bool:
    """Whether filters other than HDF5's own, whose decoders trust every byte, packed it."""
    properties = dataset.id.get_create_plist()
    return any(properties.get_filter(n)[0] > _LAST_OWN_FILTER for n in range(properties.get_nfilters()))


def read_channels(group: h5py.Group, path: Path, where: str) -> tuple[str, ...]:
    """Names of the channels."""
    dataset = group.get("channel")
    if not isinstance(dataset, h5py.Dataset) or dataset.dtype.kind != "O" or dataset.ndim != 1:
        raise InputError(
            f"{path}: dataset {where}channel is missing or not a list of names; trace the file again"
        )
    return tuple(dataset.asstr()[()])


def read_json(group: h5py.Group, name: str, path: Path, where: str) -> dict[str, Any]:
    """A JSON object from an attribute; empty where it is missing."""
    try:
        found = json.loads(group.attrs.get(name, "{}"))
    except (TypeError, ValueError):
        found = None
    if not isinstance(found, dict):
        raise InputError(f"{path}: attribute {where}{name} is no JSON object; copy or trace the file again")
    return found
