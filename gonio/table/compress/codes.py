"""Positive numbers of rows and rings as few bytes: in logarithmic steps, differences of neighbours packed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.table.compress.packing import pack, unpack

Array = NDArray[np.float64]

_ALONG: tuple[tuple[int, ...], ...] = ((), (1,), (0,), (0, 1), (1, 1))
"""Axes along which differences of rows' and rings' codes are taken."""
_SCALE_STEP = 0.001  # relative; rows that differ at random by that much are as smooth to a transform


@dataclass(frozen=True)
class Scale:
    """What rows are divided by, shape (I, C): the error allowed in each, in logarithmic steps."""

    codes: NDArray[np.int64]
    floor: float

    @classmethod
    def of(cls, values: Array) -> Scale:
        """Nearest to the values, which are not negative; 0 stays 0."""
        floor = float(np.min(values, initial=np.inf, where=values > 0))
        return cls(codes_of(values, floor, _SCALE_STEP), floor if np.isfinite(floor) else 0.0)

    @classmethod
    def read(cls, content: Mapping[str, Any], shape: tuple[int, int]) -> Scale:
        """From a file's content; raises as `Frame.read`."""
        codes = unpack_smooth(content, "scale", (shape[0], 1, shape[1]))[:, 0]
        scale = cls(codes, float(content["scale_floor"]))
        check_codes(scale.codes, scale.floor, _SCALE_STEP)
        return scale

    def content(self) -> dict[str, Any]:
        """What `read` needs from the file."""
        return {**pack_smooth("scale", self.codes[:, None]), "scale_floor": self.floor}

    @property
    def values(self) -> Array:
        """Shape (I, C)."""
        return from_codes(self.codes, self.floor, _SCALE_STEP)


def codes_of(values: Array, floor: float, step: float) -> NDArray[np.int64]:
    """Values in logarithmic steps above the smallest, from 1; 0 where the value is 0."""
    lit = values > 0
    steps = np.log(np.divide(values, floor, out=np.ones_like(values), where=lit)) / np.log1p(step)
    return np.where(lit, 1 + np.rint(steps), 0).astype(np.int64)


def check_codes(codes: NDArray[np.int64], floor: float, step: float) -> None:
    """ValueError where `from_codes` would not return numbers that are finite and not negative."""
    highest = np.log(max(floor, 1e-300)) + codes.max() * np.log1p(step) if 0 < step < 1 else np.inf
    if not (floor >= 0 and np.all(codes >= 0) and highest < 700):
        raise ValueError("codes of no positive numbers")


def from_codes(codes: NDArray[np.int64], floor: float, step: float) -> Array:
    """Values from their codes."""
    return np.where(codes > 0, floor * np.exp((np.maximum(codes, 1) - 1) * np.log1p(step)), 0.0)


def pack_smooth(name: str, codes: NDArray[np.int64]) -> dict[str, Any]:
    """Codes, shape (I, R, C), as differences from channel to channel and along those axes that leave the least."""
    channels = np.diff(codes, axis=-1, prepend=0)
    packed = []
    for axes in _ALONG:
        differences = channels
        for axis in axes:
            differences = np.diff(differences, axis=axis, prepend=0)
        packed.append(pack(differences))
    least = min(range(len(_ALONG)), key=lambda n: len(packed[n]))
    return {name: packed[least], f"{name}_along": least}


def unpack_smooth(content: Mapping[str, Any], name: str, shape: tuple[int, int, int]) -> NDArray[np.int64]:
    """The inverse of `pack_smooth`."""
    along = int(content[f"{name}_along"])
    if not 0 <= along < len(_ALONG):
        raise ValueError(f"{name} along {along}")
    codes = unpack(content[name], shape)
    for axis in (*_ALONG[along], -1):
        codes = np.cumsum(codes, axis=axis)
    return codes
