"""Small integers as few bytes: an adaptive binary arithmetic coder, the numbers' neighbours its context.

Each number is a chain of decisions: 0 or not, its sign, then whether it is larger than 1, 2, ... A decision costs
-log2 of the probability it was given, which is learnt from those before it in like places: with like neighbours
at lower frequencies, and at a like frequency (as the coders of video do: Marpe et al. 2003, "Context-based adaptive
binary arithmetic coding in H.264/AVC"). Of the two probabilities the mean is taken. Of a block only the box that
its numbers other than 0 fill is coded. The range coder is that of LZMA (Pavlov; after Martin 1979); all
arithmetic is of integers, so every machine decodes alike.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.table.compress.arithmetic_kernels import (
    AT,
    DECISIONS,
    DECODES,
    ONE,
    PENDING,
    RANGE,
    begin,
    code_blocks,
    code_flags,
    finish,
)


class _Coder:
    def __init__(self, data: NDArray[np.uint8], decodes: bool) -> None:
        self._data = data
        self._state = np.zeros(7, np.int64)
        self._state[RANGE] = (1 << 32) - 1
        self._state[DECODES] = decodes
        self._chances = np.full(DECISIONS, ONE // 2, np.int64)
        self._seen = np.zeros(DECISIONS, np.int64)

    def _run(self, numbers: NDArray[np.int32]) -> None:
        if code_blocks(numbers, self._data, self._state, self._chances, self._seen) != 0:
            raise ValueError("numbers that no encoder writes")


class Encoder(_Coder):
    """Packs blocks of numbers and flags, in the order in which `Decoder` is to ask for them."""

    def __init__(self) -> None:
        super().__init__(np.zeros(64, np.uint8), False)
        self._state[PENDING] = 1

    def blocks(self, numbers: NDArray) -> None:
        """Blocks of equal shape, (n, a, b, c, d), of integers below 2^31."""
        numbers = np.ascontiguousarray(numbers, np.int32)
        self._grow(2 * numbers.size + 30 * int(np.count_nonzero(numbers)) + 64 * len(numbers))
        self._run(numbers)

    def flags(self, flags: NDArray[np.bool_]) -> None:
        """Flags in two axes; those next to a flag tell of it."""
        self._grow(3 * flags.size)
        code_flags(flags.astype(np.uint8), self._data, self._state, self._chances, self._seen)

    def bytes(self) -> NDArray[np.uint8]:
        """All that was packed; ends the encoder."""
        self._grow(0)
        finish(self._data, self._state)
        packed = self._data[1 : self._state[AT]]  # the first byte is always 0
        filled = np.flatnonzero(packed)
        return packed[: filled[-1] + 1 if len(filled) else 0].copy()

    def _grow(self, room: int) -> None:
        wanted = int(self._state[AT] + self._state[PENDING]) + room + 16
        if wanted > len(self._data):
            self._data = np.concatenate([self._data, np.zeros(wanted - len(self._data), np.uint8)])


class Decoder(_Coder):
    """The inverse of `Encoder`.

    Raises
    ------
    TypeError
        No bytes.
    """

    def __init__(self, packed: NDArray) -> None:
        if not isinstance(packed, np.ndarray) or packed.dtype != np.uint8 or packed.ndim != 1:
            raise TypeError("packed numbers that are no bytes")
        super().__init__(packed.copy(), True)
        begin(self._data, self._state)

    def blocks(self, shape: tuple[int, ...]) -> NDArray[np.int32]:
        """Blocks of the shape (n, a, b, c, d).

        Raises
        ------
        ValueError
            Damaged.
        """
        numbers = np.zeros(shape, np.int32)
        self._run(numbers)
        return numbers

    def flags(self, shape: tuple[int, int]) -> NDArray[np.bool_]:
        """Flags of the shape."""
        flags = np.zeros(shape, np.uint8)
        code_flags(flags, self._data, self._state, self._chances, self._seen)
        return flags.astype(bool)

    def end(self) -> None:
        """Check that nothing is left.

        Raises
        ------
        ValueError
            Damaged: bytes that were not asked for.
        """
        if self._state[AT] < len(self._data):
            raise ValueError(f"{len(self._data) - self._state[AT]} bytes too many")
