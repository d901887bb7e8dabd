"""Arrays of integers as bytes, and the step of quantisation that comes with them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.table.compress.arithmetic import Decoder, Encoder


def pack(numbers: NDArray) -> NDArray[np.uint8]:
    """An array of up to four axes of integers below 2^31, most of them small and near the start of the axes."""
    encoder = Encoder()
    encoder.blocks(_one_block(numbers))
    return encoder.bytes()


def unpack(packed: NDArray, shape: tuple[int, ...]) -> NDArray[np.int64]:
    """What `pack` packed.

    Raises
    ------
    ValueError, TypeError
        Damaged.
    """
    decoder = Decoder(packed)
    numbers = decoder.blocks(_one_block(np.empty(shape, bool)).shape)
    decoder.end()
    return numbers.reshape(shape).astype(np.int64)


def pack_flags(flags: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """An array of flags of three axes, neighbours along the last two mostly alike."""
    encoder = Encoder()
    encoder.flags(flags.reshape(-1, flags.shape[2]))
    return encoder.bytes()


def unpack_flags(packed: NDArray, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """What `pack_flags` packed.

    Raises
    ------
    ValueError, TypeError
        Damaged.
    """
    decoder = Decoder(packed)
    flags = decoder.flags((shape[0] * shape[1], shape[2]))
    decoder.end()
    return flags.reshape(shape)


def _one_block(numbers: NDArray) -> NDArray:
    return numbers.reshape((1, *numbers.shape[:-1], *[1] * (4 - numbers.ndim), numbers.shape[-1]))


def step_of(content: Mapping[str, Any]) -> float:
    """The step of quantisation.

    Raises
    ------
    KeyError, TypeError, ValueError
        Missing, or no positive number.
    """
    step = float(content["step"])
    if not (np.isfinite(step) and step > 0):
        raise ValueError("a step that is not a positive number")
    return step
