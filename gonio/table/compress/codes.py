"""Positive numbers of rows and rings as few bytes: in logarithmic steps, differences of neighbours packed."""

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
_MOST = 2**27  # of codes: their third differences are to be integers of 32 bits


@dataclass(frozen=True)
class Steps:
    """Numbers that are not negative, shape (I, C), in logarithmic steps above the smallest; 0 stays 0.

    Parameters
    ----------
    codes : ndarray of int, shape (I, C)
        Steps from the floor, from 1; 0 of 0.
    floor, step : float
        The smallest number that is not 0, and the relative step.
    """

    codes: NDArray[np.int64]
    floor: float
    step: float

    @classmethod
    def of(cls, values: Array, step: float) -> Steps:
        """Nearest to the values.

        Raises
        ------
        ValueError
            Some are negative, or they differ by more steps than can be packed.
        """
        lit = values > 0
        floor = float(np.min(values, initial=np.inf, where=lit))
        steps = np.log(np.divide(values, floor, out=np.ones_like(values), where=lit)) / np.log1p(step)
        if np.any(values < 0) or steps.max(initial=0) > _MOST:
            raise ValueError("numbers that are negative or differ by too much")
        codes = np.where(lit, 1 + np.rint(steps), 0).astype(np.int64)
        return cls(codes, floor if np.isfinite(floor) else 0.0, step)

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
        highest = np.log(max(floor, 1e-300)) + codes.max() * np.log1p(step)
        if not (floor >= 0 and np.all(codes >= 0) and highest < 700):
            raise ValueError(f"{name}: codes of no positive numbers")
        return cls(codes, floor, step)

    def content(self, name: str) -> dict[str, Any]:
        """What `read` needs from the file."""
        return {**pack_smooth(name, self.codes[:, None]), f"{name}_floor": self.floor}

    @property
    def values(self) -> Array:
        """The numbers, shape (I, C)."""
        steps = np.maximum(self.codes, 1) - 1
        return np.where(self.codes > 0, self.floor * np.exp(steps * np.log1p(self.step)), 0.0)


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
