"""Integers come back from the arithmetic coder, and take what their entropy says."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.table.compress.arithmetic import Decoder, Encoder
from gonio.table.compress.packing import pack, unpack
from gonio.validation import seed_from

pytestmark = pytest.mark.compiled


def test_numbers_and_flags_come_back():
    """Of all sizes, in blocks of all shapes, empty ones too."""
    rng = np.random.default_rng(seed_from("arithmetic coder"))
    for _ in range(60):
        encoder, given = Encoder(), []
        for _ in range(rng.integers(1, 4)):
            shape = tuple(rng.integers(1, 7, 5))
            wide = rng.standard_cauchy(shape) * 10.0 ** rng.uniform(-3, 4)
            numbers = np.rint(np.clip(wide, 1 - 2**31, 2**31 - 1)).astype(np.int32)
            flags = rng.random(shape[:2]) < rng.random()
            encoder.blocks(numbers)
            encoder.flags(flags)
            given.append((numbers, flags))
        decoder = Decoder(encoder.bytes())
        for numbers, flags in given:
            np.testing.assert_array_equal(decoder.blocks(numbers.shape), numbers)
            np.testing.assert_array_equal(decoder.flags(flags.shape), flags)
        decoder.end()


def test_numbers_take_little_more_than_their_entropy():
    """Rounded Laplace noise, the same everywhere: 20 000 numbers teach the coder nearly all there is to know."""
    rng = np.random.default_rng(seed_from("entropy"))
    for width in (0.3, 3.0):
        numbers = np.rint(rng.laplace(scale=width, size=(1, 20, 20, 50))).astype(np.int64)
        _, counts = np.unique(numbers, return_counts=True)
        share = counts / numbers.size
        entropy = -numbers.size * np.sum(share * np.log2(share)) / 8
        assert entropy < 1.05 * pack(numbers).size < 1.1 * entropy


def test_what_is_0_takes_nothing():
    assert pack(np.zeros((50, 50, 90, 3))).size == 0
    corner = np.zeros((50, 50, 90, 3))
    corner[:2, :2, :2] = 5
    assert pack(corner).size < 30
    np.testing.assert_array_equal(unpack(pack(corner), corner.shape), corner)


def test_damaged_bytes():
    packed = pack(np.arange(-20, 20).reshape(5, 8))
    with pytest.raises(ValueError, match="bytes too many"):
        unpack(np.append(packed, np.zeros(9, np.uint8)), (5, 8))
    with pytest.raises(TypeError, match="no bytes"):
        unpack(packed.astype(float), (5, 8))
    with pytest.raises(ValueError, match="no encoder writes"):
        unpack(packed, (2, 2))
