"""Records of numbers, texts and arrays as few bytes: one deflated line of JSON and what it names.

Floats are stored as second differences of their bits along the first axis, in byte planes: axes and albedos,
which are smooth, leave mostly zeros, and every bit comes back.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

_TYPES: dict[str, Any] = {"f8": np.int64, "f4": np.int32, "u1": None}
"""Types of arrays, and the integers whose differences stand for them, on a little-endian machine."""


def pack_record(record: Mapping[str, Any]) -> NDArray[np.uint8]:
    """Bytes of a record: names to what JSON holds, or to arrays of float64, float32 or uint8.

    Raises
    ------
    KeyError, TypeError
        An array of another type, or what JSON does not hold.
    """
    arrays = {name: item for name, item in record.items() if isinstance(item, np.ndarray)}
    rest = {name: item for name, item in record.items() if name not in arrays}
    shapes = {name: [item.dtype.str[1:], *item.shape] for name, item in arrays.items()}
    line = json.dumps([rest, shapes], separators=(",", ":"), ensure_ascii=False).encode()
    planes = [_planes(item) for item in arrays.values()]
    return np.frombuffer(zlib.compress(b"\n".join([line, b"".join(planes)]), 9), np.uint8)


def unpack_record(packed: NDArray) -> dict[str, Any]:
    """What `pack_record` packed.

    Raises
    ------
    ValueError, TypeError, RecursionError
        Damaged.
    """
    try:
        # never more than 1032 times what is packed
        raw = zlib.decompress(np.asarray(packed, np.uint8).tobytes())
    except zlib.error as error:
        raise ValueError(str(error)) from error
    line, _, planes = raw.partition(b"\n")
    rest, shapes = json.loads(line)
    record, at = dict(rest), 0
    for name, (kind, *shape) in dict(shapes).items():
        if kind not in _TYPES or not all(type(n) is int and n >= 0 for n in shape):
            raise ValueError(f"{name} of type {kind!r} and shape {shape}")
        size = np.dtype(kind).itemsize * math.prod(shape)
        if at + size > len(planes):
            raise ValueError(f"{name} of shape {shape}, more than {len(planes)} bytes hold")
        record[name] = _array(planes[at : at + size], kind, shape)
        at += size
    return record


def _planes(array: NDArray) -> bytes:
    integers = _TYPES[array.dtype.str[1:]]
    if integers is None or array.size == 0:
        return array.tobytes()
    bits = np.atleast_1d(np.ascontiguousarray(array)).view(integers)
    for _ in range(2):  # what is beyond the integers wraps around, here as in _array
        bits = np.diff(bits, axis=0, prepend=integers(0))
    small = (bits << 1) ^ (bits >> (8 * bits.itemsize - 1))  # 0, -1, 1, -2... as 0, 1, 2, 3...
    return small.ravel().view(np.uint8).reshape(-1, bits.itemsize).T.tobytes()


def _array(planes: bytes, kind: str, shape: list[int]) -> NDArray:
    integers, size = _TYPES[kind], np.dtype(kind).itemsize
    if integers is None or len(planes) == 0:
        return np.frombuffer(planes, kind).reshape(shape)
    small = np.ascontiguousarray(np.frombuffer(planes, np.uint8).reshape(size, -1).T).view(f"u{size}")
    bits = (small >> 1).view(integers) ^ -(small & 1).view(integers)
    bits = bits.reshape(shape or 1)
    for _ in range(2):
        bits = np.cumsum(bits, axis=0, dtype=integers)
    return bits.view(kind).reshape(shape)
