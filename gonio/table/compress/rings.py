"""Means over delta phi of rings of cells (theta_i, theta_r), restored in what is decoded.

Setting negative values to 0 brightens what is dark and noisy, and cosine weighting lets that pass near the
horizon: a bright rim around a rendered sphere. So the mean of every ring, known better than its cells, is
restored. What is stored is the factor between the table's mean and that of what is decoded, in logarithmic steps:
mostly 1, as most means come back by themselves. The factor multiplies what the decoder finds as it is, without
rounding: a machine that decodes to other last digits finds the same means but for these.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.table.compress.codes import pack_smooth, unpack_smooth
from gonio.table.compress.packing import pack_flags, unpack_flags

Array = NDArray[np.float64]

_STEP = 0.01  # relative, at most
_ROUND = 0.3  # a factor that is less than 0.7 of a step from 1 stays 1


@dataclass(frozen=True)
class Rings:
    """How the means of rings, shape (I, R, C), follow from those of what is decoded.

    Parameters
    ----------
    step : float
        Relative, of the factors.
    floor : float
        Means of what is decoded count as no less; the least of the table's that is not 0.
    dark : ndarray of bool, shape (I, R, C)
        Rings of mean 0.
    wanted : ndarray, shape (I, R, C), or None
        The table's means; None where they were read from a file.
    codes : ndarray of int, shape (I, R, C), or None
        Factors in steps; None where they are to be found.
    """

    step: float
    floor: float
    dark: NDArray[np.bool_]
    wanted: Array | None = None
    codes: NDArray[np.int64] | None = None

    @classmethod
    def of(cls, means: Array, bound: float) -> Rings:
        """Of a table with these means, whose rows may err by `bound`; 1e-50 of the largest is the least."""
        dark = means == 0
        floor = float(np.min(means, initial=np.inf, where=~dark))
        floor = 0.0 if dark.all() else max(floor, 1e-50 * float(means.max()))
        return cls(min(_STEP, bound), floor, dark, np.where(dark, 0.0, np.maximum(means, floor)))

    @classmethod
    def read(cls, content: Mapping[str, Any], shape: tuple[int, int, int]) -> Rings:
        """From a file's content.

        Raises
        ------
        KeyError, TypeError, ValueError
            Missing, or damaged.
        """
        codes = unpack_smooth(content, "rings", shape)
        dark = (
            unpack_flags(content["rings_dark"], shape) if "rings_dark" in content else np.zeros(shape, bool)
        )
        step, floor = float(content["ring_step"]), float(content["ring_floor"])
        largest = np.abs(codes).max() * np.log1p(step) if 0 < step < 1 else np.inf
        if not (0 <= floor < 1e100 and largest < 300):
            raise ValueError("factors of rings that are no numbers")
        return cls(step, floor, dark, codes=codes)

    def content(self, decoded: Array) -> dict[str, Any]:
        """What `read` needs from the file to restore the means from these."""
        content = {
            **pack_smooth("rings", self._factors(decoded)),
            "ring_step": self.step,
            "ring_floor": self.floor,
        }
        return content | ({"rings_dark": pack_flags(self.dark)} if self.dark.any() else {})

    def restore(self, decoded: Array) -> Array:
        """The means, from those of what is decoded."""
        factors = np.exp(self._factors(decoded) * np.log1p(self.step))
        return np.where(self.dark, 0.0, np.maximum(decoded, self.floor) * factors)

    def _factors(self, decoded: Array) -> NDArray[np.int64]:
        if self.wanted is None:
            assert self.codes is not None
            return self.codes
        found = np.maximum(decoded, self.floor)
        ratio = np.divide(self.wanted, found, out=np.ones_like(found), where=~self.dark)
        steps = np.log(ratio) / np.log1p(self.step)
        return (np.sign(steps) * np.floor(np.abs(steps) + _ROUND)).astype(np.int64)
