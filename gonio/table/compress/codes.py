"""Numbers of rows and rings as few bytes: in logarithmic steps, differences of neighbours packed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.table.compress.packing import pack, unpack

Array = NDArray[np.float64]

_ALONG: tuple[tuple[int, ...], ...] = ((), (2,), (1, 2), (0, 2), (0, 1, 2), (1, 1, 2))
"""Axes along which differences of codes are taken."""


@dataclass(frozen=True)
class Steps:
    """Numbers, shape (I, C), in logarithmic steps of their size above the smallest; 0 stays 0.

    Parameters
    ----------
    codes : ndarray of int, shape (I, C)
        Steps from the floor, from 1, with the number's sign; 0 of 0.
    floor, step : float
        The smallest size that is not 0, and the relative step.
    """

    codes: NDArray[np.int64]
    floor: float
    step: float

    @classmethod
    def of(cls, values: Array, step: float) -> Steps:
        """Nearest to the values; what is less than 1e-50 of the largest, counts as that."""
        sizes = np.abs(values)
        lit = sizes > 0
        floor = float(np.min(sizes, initial=np.inf, where=lit))
        floor = max(floor, 1e-50 * float(sizes.max())) if lit.any() else 0.0
        ratio = np.maximum(np.divide(sizes, floor, out=np.ones_like(sizes), where=lit), 1.0)
        codes = np.sign(values) * (1 + np.rint(np.log(ratio) / np.log1p(step)))
        return cls(codes.astype(np.int64), floor, step)

    @classmethod
    def read(cls, content: Mapping[str, Any], name: str, shape: tuple[int, int], step: float) -> Steps:
        """What `content` gave under the name.

        Raises
        ------
        KeyError, TypeError, ValueError
            Missing, or damaged.
        """
        codes = unpack_smooth(content, name, (shape[0], 1, shape[1]))[:, 0]
        floor = float(content[f"{name}_floor"])
        highest = np.log(max(floor, 1e-300)) + np.abs(codes).max() * np.log1p(step)
        if not (floor >= 0 and highest < 700):
            raise ValueError(f"{name}: codes of no numbers")
        return cls(codes, floor, step)

    def content(self, name: str) -> dict[str, Any]:
        """What `read` needs from the file."""
        return {**pack_smooth(name, self.codes[:, None]), f"{name}_floor": self.floor}

    @property
    def values(self) -> Array:
        """The numbers, shape (I, C)."""
        sizes = self.floor * np.exp((np.abs(self.codes) - 1) * np.log1p(self.step))
        return np.sign(self.codes) * sizes


def pack_smooth(name: str, codes: NDArray[np.int64]) -> dict[str, Any]:
    """Codes, shape (I, R, C), as differences along those axes that leave the least."""
    packed = []
    for axes in _ALONG:
        differences = codes
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
    for axis in _ALONG[along]:
        codes = np.cumsum(codes, axis=axis)
    return codes
