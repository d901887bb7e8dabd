r"""The container of RGL's `.bsdf` files: named arrays of numbers in one binary file, little-endian.

Layout: ``"tensor_file\0"``, two bytes of version (1, 0), uint32 number of fields; per field uint16 length
of the name, the name, uint16 number of dimensions, uint8 type, uint64 offset, uint64 for each dimension;
then the arrays, each on a multiple of 8 bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.files import atomic
from microgeometry.errors import InputError

MAGIC = b"tensor_file\0"
_TYPES = {
    1: "u1", 2: "i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<u8", 8: "<i8", 9: "<f2", 10: "<f4", 11: "<f8",
}  # fmt: skip
_MAX_DIMENSIONS = 8


def read_tensors(path: Path) -> dict[str, NDArray]:
    """All arrays of a tensor file, by name; each is a view into the file's bytes.

    Raises
    ------
    InputError
        Not a tensor file, of another version, or a field that does not fit into the file.
    """
    data = path.read_bytes()
    if not data.startswith(MAGIC):
        raise InputError(f"{path}: not a tensor file; it must begin with 'tensor_file'")
    found: dict[str, NDArray] = {}
    try:
        major, minor, n_fields = struct.unpack_from("<BBI", data, len(MAGIC))
        if (major, minor) != (1, 0):
            raise InputError(f"{path}: tensor file of version {major}.{minor}; 1.0 is expected")
        at = len(MAGIC) + 6
        for _ in range(n_fields):
            (length,) = struct.unpack_from("<H", data, at)
            name = data[at + 2 : at + 2 + length].decode("utf-8", "replace")
            at += 2 + length
            n_dimensions, kind, offset = struct.unpack_from("<HBQ", data, at)
            at += 11
            if n_dimensions > _MAX_DIMENSIONS or kind not in _TYPES:
                raise InputError(
                    f"{path}: field {name!r}: {n_dimensions} dimensions of type {kind}; is it damaged?"
                )
            shape = struct.unpack_from(f"<{n_dimensions}Q", data, at)
            at += 8 * n_dimensions
            found[name] = _view(data, np.dtype(_TYPES[kind]), offset, shape, name, path)
    except struct.error as error:
        raise InputError(f"{path}: ends in the middle of its list of fields; copy it again") from error
    return found


def _view(
    data: bytes, dtype: np.dtype, offset: int, shape: tuple[int, ...], name: str, path: Path
) -> NDArray:
    count = 1
    for n in shape:  # in Python's integers, which do not overflow
        count *= n
    if count == 0 or offset + count * dtype.itemsize > len(data):
        raise InputError(
            f"{path}: field {name!r} of shape {shape} at byte {offset} is not within the file's {len(data)} bytes; "
            "copy it again"
        )
    return np.frombuffer(data, dtype, count, offset).reshape(shape)


def write_tensors(path: Path, tensors: Mapping[str, NDArray]) -> None:
    """Write arrays under their names; types are those of the arrays.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    kinds = {np.dtype(text): kind for kind, text in _TYPES.items()}
    offset = len(MAGIC) + 6
    offset += sum(13 + len(name.encode()) + 8 * array.ndim for name, array in tensors.items())
    header = MAGIC + struct.pack("<BBI", 1, 0, len(tensors))
    blobs = []
    for name, array in tensors.items():
        offset += -offset % 8
        text = name.encode()
        header += struct.pack("<H", len(text)) + text
        header += struct.pack("<HBQ", array.ndim, kinds[array.dtype], offset)
        header += struct.pack(f"<{array.ndim}Q", *array.shape)
        blobs.append((offset, array.tobytes()))
        offset += array.nbytes
    with atomic(path) as temporary, open(temporary, "wb") as file:
        file.write(header)
        for start, blob in blobs:
            file.write(b"\0" * (start - file.tell()))
            file.write(blob)
