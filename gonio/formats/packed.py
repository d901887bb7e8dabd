"""Records of numbers, texts and arrays as few bytes: one deflated line of JSON and what it names.

Floats are stored by how far their bits are from what the two before them along the first axis lead to expect, in
byte planes: axes and albedos, which are smooth, leave mostly zeros, and every bit comes back. Axes of equal
steps are their ends and their number.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

_LINE = "line"  # in place of a type
_MOST_STEPS = 2**16  # a line takes no bytes that would bound it
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
    shapes: dict[str, list[Any]] = {}
    planes = []
    for name, item in arrays.items():
        if _is_line(item):
            shapes[name] = [_LINE, len(item), float(item[0]), float(item[-1])]
        else:
            shapes[name] = [item.dtype.str[1:], *item.shape]
            planes.append(_planes(item))
    line = json.dumps([rest, shapes], separators=(",", ":"), ensure_ascii=False).encode()
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
        if kind == _LINE:
            record[name] = _line(name, *shape)
            continue
        if kind not in _TYPES or not all(type(n) is int and n >= 0 for n in shape):
            raise ValueError(f"{name} of type {kind!r} and shape {shape}")
        size = np.dtype(kind).itemsize * math.prod(shape)
        if at + size > len(planes):
            raise ValueError(f"{name} of shape {shape}, more than {len(planes)} bytes hold")
        record[name] = _array(planes[at : at + size], kind, shape)
        at += size
    return record


def _is_line(array: NDArray) -> bool:
    if array.dtype != np.float64 or array.ndim != 1 or not 2 < len(array) <= _MOST_STEPS:
        return False
    first, last = float(array[0]), float(array[-1])
    return (
        bool(np.isfinite(last - first)) and np.linspace(first, last, len(array)).tobytes() == array.tobytes()
    )


def _line(name: str, n: int, first: float, last: float) -> NDArray[np.float64]:
    if type(n) is not int or not 2 < n <= _MOST_STEPS:
        raise ValueError(f"{name} of {n} equal steps")
    return np.linspace(float(first), float(last), n)


def _planes(array: NDArray) -> bytes:
    integers = _TYPES[array.dtype.str[1:]]
    if integers is None or array.size == 0:
        return array.tobytes()
    array = np.atleast_1d(np.ascontiguousarray(array))
    expected = np.zeros_like(array)
    for at in range(len(array)):
        expected[at : at + 1] = _expected(array, at)
    bits = array.view(integers) - expected.view(integers)  # what is beyond the integers wraps around
    small = (bits << 1) ^ (bits >> (8 * bits.itemsize - 1))  # 0, -1, 1, -2... as 0, 1, 2, 3...
    return small.ravel().view(np.uint8).reshape(-1, bits.itemsize).T.tobytes()


def _array(planes: bytes, kind: str, shape: list[int]) -> NDArray:
    integers, size = _TYPES[kind], np.dtype(kind).itemsize
    if integers is None or len(planes) == 0:
        return np.frombuffer(planes, kind).reshape(shape)
    small = np.ascontiguousarray(np.frombuffer(planes, np.uint8).reshape(size, -1).T).view(f"u{size}")
    bits = (small >> 1).view(integers) ^ -(small & 1).view(integers)
    array = np.zeros(shape or 1, kind)
    for at, difference in enumerate(bits.reshape(array.shape)):
        array[at : at + 1].view(integers)[:] = _expected(array, at).view(integers) + difference
    return array.reshape(shape)


def _expected(array: NDArray, at: int) -> NDArray:
    """A straight line through the two before, which every machine rounds alike; 0 where there is none."""
    if at < 2:
        return array[at - 1 : at].copy() if at else np.zeros_like(array[:1])
    with np.errstate(all="ignore"):
        found = 2 * array[at - 1 : at] - array[at - 2 : at - 1]
    return np.where(np.isfinite(found), found, 0)
