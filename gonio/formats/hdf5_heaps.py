"""A check of HDF5 files that the HDF5 library does not survive."""

from __future__ import annotations

import mmap
from pathlib import Path

from microgeometry.errors import InputError

_HEAP = b"GCOL\x01\0\0\0"


def check_heaps(path: Path) -> None:
    """Refuse a damaged heap of texts in which the HDF5 library (2.0) would turn in circles for ever.

    A collection is "GCOL", version, size and objects: index, references, size, content. An object of index
    0 is free space, whose size includes its own header; with a smaller one the library never moves on.
    """
    if path.stat().st_size == 0:
        return
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        start = data.find(_HEAP)
        while start >= 0:
            at = start + 16
            end = start + int.from_bytes(data[start + 8 : at], "little")
            while at + 16 <= min(end, len(data)):
                size = int.from_bytes(data[at + 8 : at + 16], "little")
                free = data[at : at + 2] == b"\0\0"
                if free and size < 16:
                    raise InputError(
                        f"{path}: damaged HDF5 file (a heap object of {size} bytes at byte {at}); copy or trace "
                        "it again"
                    )
                at += size if free else 16 + (size + 7) // 8 * 8
            start = data.find(_HEAP, start + 1)
