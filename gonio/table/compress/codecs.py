"""Compression by error-bounded array codecs that HDF5 knows as filters (`hdf5plugin`).

The array of equal importance (`gonio.table.compress.frame`), channels first and as float32, is a dataset of its own:

- ``zfp``: blocks of 4^n, each with a transform, to an absolute tolerance (Lindstrom 2014).
- ``sz3``: prediction by interpolation, residuals quantised to an absolute bound (Liang et al. 2023).
- ``blosc2``: not lossy itself; packs the array rounded to multiples of a step (Zstandard on bit planes).

The absolute bound of a cell is the step that `hold` looks for: the codecs bound each cell, we the norm of a
row. A checksum after the codec (Fletcher's) keeps damage from decoders that trust their input.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import hdf5plugin
import numpy as np
from numpy.typing import NDArray

from gonio.formats.hdf5_content import Filtered
from gonio.table.compress.frame import Frame, shape_of
from gonio.table.compress.metric import excess
from gonio.table.compress.packing import step_of
from gonio.table.compress.search import hold
from gonio.table.table import Table

Array = NDArray[np.float64]

_LARGEST = 2**30  # of rounded numbers


@dataclass(frozen=True)
class Codec:
    """One filter as a method of compression.

    Parameters
    ----------
    options : callable
        From an absolute bound to the keywords of the dataset.
    rounded : bool
        Whether the array is rounded to multiples of the step first, because the filter keeps every bit.
    """

    options: Callable[[float], Mapping[str, Any]]
    rounded: bool = False

    def encode(self, table: Table, bounds: Array, quick: bool = False) -> dict[str, Any]:
        """As `gonio.table.compress.dct.encode`."""

        def prepare(frame: Frame) -> Callable[[float], Array]:
            array = np.moveaxis(frame.normalise(table.values), -1, 0)
            return lambda step: frame.values(self._values(self._returned(array, step), step))

        frame = Frame.of_table(table, bounds)
        step = hold(frame, partial(excess, table, bounds=bounds), prepare, quick)
        array = np.moveaxis(frame.normalise(table.values), -1, 0)
        return {**frame.content(step, prepare(frame)(step)), "array": self._filtered(array, step)}

    def decode(self, content: Mapping[str, Any], fields: Mapping[str, Any]) -> Array:
        """As `gonio.table.compress.dct.decode`."""
        shape = shape_of(fields)
        array = np.asarray(content["array"], float)
        if array.shape != (shape[3], *shape[:3]) or not np.all(np.isfinite(array)):
            raise ValueError(f"an array of shape {array.shape}, or not finite, for values of {shape}")
        frame = Frame.read_table(content, fields)
        return frame.correct(frame.values(self._values(array, step_of(content))))

    def _filtered(self, array: Array, step: float) -> Filtered:
        given = _rounded(array, step) if self.rounded else array.astype(np.float32)
        return Filtered(given, self.options(step))

    def _returned(self, array: Array, step: float) -> NDArray:
        """What the filter will give back; one that keeps every bit need not be asked."""
        return _rounded(array, step) if self.rounded else self._filtered(array, step).through()

    def _values(self, array: NDArray, step: float) -> Array:
        return np.moveaxis(array * step if self.rounded else array.astype(float), 0, -1)


def _rounded(array: Array, step: float) -> NDArray[np.int32]:
    return np.clip(np.rint(array / step), -_LARGEST, _LARGEST).astype(np.int32)


ZFP = Codec(lambda step: hdf5plugin.Zfp(accuracy=step))
SZ3 = Codec(lambda step: hdf5plugin.SZ3(absolute=step))
BLOSC2 = Codec(
    lambda step: hdf5plugin.Blosc2(cname="zstd", clevel=9, filters=hdf5plugin.Blosc2.BITSHUFFLE), True
)
