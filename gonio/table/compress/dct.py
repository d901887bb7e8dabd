"""Compression by an orthonormal cosine transform of the whole table.

Of the array of equal importance (`gonio.table.compress.frame`), over theta_i, theta_r, delta phi and channel,
the discrete cosine transform (DCT-II) is orthonormal: the error made in the coefficients is the error of
the values, whatever their number. So one step of quantisation serves all; the largest that holds the bound
of every row is found by decoding. Smooth, and for channels similar, tables leave few coefficients that are
not 0. Against noise this is a threshold: what a row's bound of its own noise removes is its smallest
coefficients.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from gonio.table.compress.frame import Frame, shape_of
from gonio.table.compress.metric import excess
from gonio.table.compress.packing import pack, step_of, unpack
from gonio.table.compress.search import hold
from gonio.table.table import Table

Array = NDArray[np.float64]


def encode(table: Table, bounds: Array, quick: bool = False) -> dict[str, Any]:
    """Compress the values so that each row and channel's error is at most `bounds`, shape (I, C).

    `quick` is that of `gonio.table.compress.search.hold`.

    Raises
    ------
    InputError
        The bounds cannot be held.
    """

    def prepare(frame: Frame) -> Callable[[float], Array]:
        coefficients = _forward(frame.normalise(table.values))
        return lambda step: frame.values(_backward(np.rint(coefficients / step) * step))

    frame = Frame.of_table(table, bounds)
    step = hold(frame, partial(excess, table, bounds=bounds), prepare, quick)
    quantised = np.rint(_forward(frame.normalise(table.values)) / step).astype(np.int32)
    return {**frame.content(step, prepare(frame)(step)), "coefficients": pack(quantised)}


def decode(content: Mapping[str, Any], fields: Mapping[str, Any]) -> Array:
    """Values, shape (I, R, P, C), from what `encode` returned and the table's axes, albedo, delta and gaps.

    Raises
    ------
    KeyError, TypeError, ValueError, OSError, EOFError
        Content that is missing, damaged, or does not fit the axes.
    """
    shape = shape_of(fields)
    frame, step = Frame.read_table(content, fields), step_of(content)
    array = _backward(unpack(content["coefficients"], shape).astype(float) * step)
    return frame.correct(frame.values(array))


def _forward(values: Array) -> Array:
    return fft.dctn(values, norm="ortho", workers=-1, overwrite_x=True)


def _backward(coefficients: Array) -> Array:
    return fft.idctn(coefficients, norm="ortho", workers=-1, overwrite_x=True)
