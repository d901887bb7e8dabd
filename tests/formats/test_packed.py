"""Records come back to the bit, and smooth numbers take little."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.formats.packed import pack_record, unpack_record
from gonio.validation import seed_from

rng = np.random.default_rng(seed_from("packed"))
ARRAYS = {
    "axis": np.linspace(0, np.pi / 2, 91),
    "noise": rng.random((7, 3)),
    "any bits": rng.integers(0, 2**32, 50, np.uint32).view(np.float32),
    "not numbers": np.array([np.nan, -np.inf, -0.0, 1e-310, 1e308]),
    "bytes": rng.integers(0, 256, 9).astype(np.uint8),
    "four axes": rng.random((2, 3, 1, 2)).astype("f4"),
    "none": np.zeros((0, 3)),
    "single": np.array(3.5),
}


@pytest.mark.parametrize("name", ARRAYS)
def test_every_bit_comes_back(name):
    rest = {"text": "π\n", "number": 0.1, "list": [1, None, {"a": True}]}
    record = unpack_record(pack_record({**rest, name: ARRAYS[name], "last": np.arange(3.0)}))
    found = record.pop(name)
    assert found.dtype == ARRAYS[name].dtype
    assert found.shape == ARRAYS[name].shape
    assert found.tobytes() == ARRAYS[name].tobytes()
    np.testing.assert_array_equal(record.pop("last"), np.arange(3.0))
    assert record == rest


def test_axes_take_little():
    for axis in (np.linspace(0, np.pi / 2, 91), np.radians(np.arange(0, 180.1, 2.5))):
        assert pack_record({"a": axis}).size < axis.nbytes / 2.7


def test_what_cannot_be_packed():
    with pytest.raises(KeyError):
        pack_record({"a": np.zeros(3, np.int16)})
    with pytest.raises(TypeError):
        pack_record({"a": {1, 2}})
