"""Arrays of a compressed table that a filter of HDF5 packs, and what its content takes in a file."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from typing import Any, NamedTuple
from uuid import uuid4

import h5py
from numpy.typing import NDArray

from gonio.formats.packed import pack_record


class Filtered(NamedTuple):
    """An array and the HDF5 filter it is to be stored through."""

    data: NDArray
    options: Mapping[str, Any]
    """Keywords of `h5py.Group.create_dataset` that name the filter."""

    def create(self, group: h5py.Group, name: str) -> None:
        """Write it as a dataset of one chunk, with a checksum over what the filter made of it."""
        dataset = group.create_dataset(name, data=self.data, chunks=self.data.shape, **self.options)
        group.file.flush()
        dataset.attrs["crc32"] = chunk_checksum(dataset)

    def through(self) -> NDArray:
        """What a file would give back."""
        with _memory() as file:
            self.create(file, "array")
            file.flush()
            return file["array"][()]


def chunk_checksum(dataset: h5py.Dataset) -> int:
    """CRC-32 of a dataset's only chunk as it is stored.

    HDF5's own checksum (Fletcher's) takes 0x0000 for 0xFFFF, and decoders trust what passes.

    Raises
    ------
    OSError
        Damaged, or not one chunk that all filters were applied to.
    """
    if dataset.chunks != dataset.shape:
        raise OSError("it is not one chunk")
    skipped, stored = dataset.id.read_direct_chunk((0,) * dataset.ndim)
    if skipped:
        raise OSError("filters were skipped")
    return zlib.crc32(stored)


def _memory() -> h5py.File:
    # HDF5 knows files by their names, even those it never writes: one a thread. Laid out as `gonio.formats.hdf5` does
    name = f"memory-{uuid4()}"
    return h5py.File(name, "w", driver="core", backing_store=False, libver="v110", meta_block_size=0)


def stored_bytes(content: Mapping[str, Any]) -> int:
    """Bytes that the content takes in a file; of what HDF5 keeps to describe arrays behind filters only a part."""
    filtered = {name: item for name, item in content.items() if isinstance(item, Filtered)}
    size = pack_record({n: item for n, item in content.items() if n not in filtered}).size
    with _memory() as file:
        empty = _image_size(file)
        for name, item in filtered.items():
            item.create(file, name)
        return int(size) + _image_size(file) - empty


def _image_size(file: h5py.File) -> int:
    file.flush()
    return len(file.id.get_file_image())
