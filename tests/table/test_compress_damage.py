"""Damaged content of compressed files is one clear line."""

from __future__ import annotations

import bz2

import h5py
import numpy as np
import pytest

from gonio.formats import hdf5_data
from gonio.table.compress import METHODS, compress
from gonio.table.table import Table
from microgeometry.errors import InputError
from tests.table.tables import ggx, grid, lambert, make

pytestmark = pytest.mark.compiled

EDGES = grid(30, 30, 45)


def replace(name, data):
    def action(group):
        del group[name]
        group[name] = data

    return action


DAMAGE = {
    "method": ("dct", lambda g: g.attrs.__setitem__("method", "wavelet"), "method 'wavelet' is unknown"),
    "no method": ("dct", lambda g: g.attrs.__delitem__("method"), "method None is unknown"),
    "no step": ("dct", lambda g: g.attrs.__delitem__("step"), "damaged content"),
    "count": ("dct", lambda g: g.attrs.__setitem__("count", 10**12), "damaged content"),
    "scale": ("dct", replace("scale", np.ones((2, 2), "f4")), "damaged content"),
    "nan": ("dct", replace("scale", np.full((30, 3), np.nan, "f4")), "damaged content"),
    "zeros": ("dct", replace("zeros", np.zeros(50, np.uint8)), "damaged content"),
    "coefficients": ("dct", replace("coefficients", np.zeros(50, np.uint8)), "damaged content"),
    "missing": ("dct", lambda g: g.__delitem__("zeros"), "damaged content"),
    "text": ("dct", replace("zeros", "hello"), "zeros holds"),
    "another method's": ("dct", lambda g: g.attrs.__setitem__("method", "tree"), "damaged content"),
    "rings": ("tree", lambda g: g.attrs.__setitem__("ring_step", 2.0), "damaged content"),
    "bright rings": ("tree", lambda g: g.attrs.__setitem__("ring_floor", 1e308), "damaged content"),
    "tree": ("tree", replace("tree", np.frombuffer(bz2.compress(b""), np.uint8)), "nodes, more are expected"),
    "no tree": ("tree", replace("tree", np.zeros(9, np.uint8)), "damaged content"),
    "negative step": ("tree", lambda g: g.attrs.__setitem__("step", -1.0), "damaged content"),
    "basis": ("low_rank", replace("basis", np.ones((31, 2), "f4")), "damaged content"),
    "weights": ("low_rank", replace("weights", np.zeros(31, "f4")), "damaged content"),
    "huge basis": ("low_rank", replace("basis", np.full((31, 2), 9, "f4")), "damaged content"),
    "array": ("zfp", replace("array", np.zeros((3, 3), "f4")), "damaged content"),
    "array of nan": ("sz3", replace("array", np.full((3, 30, 30, 45), np.nan, "f4")), "damaged content"),
    "no array": ("blosc2", lambda g: g.__delitem__("array"), "damaged content"),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_damaged_content(tmp_path, name):
    path = tmp_path / "c.h5"
    method, damage, message = DAMAGE[name]
    compress(make(ggx(0.5, 0.9), EDGES), path, 0.1, method)
    with h5py.File(path, "r+") as file:
        damage(file["compressed"])
    with pytest.raises(InputError, match=message) as caught:
        Table.load(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("method", ["zfp", "sz3", "blosc2"])
def test_bytes_the_codec_would_trust_are_checked_before(tmp_path, method):
    """One bit flipped in what the filter wrote: the checksum finds it, no decoder sees it."""
    path = tmp_path / "c.h5"
    compress(make(ggx(0.5, 0.9), EDGES), path, 0.02, method)
    with h5py.File(path) as file:
        chunk = file["compressed/array"].id.get_chunk_info(0)
    data = bytearray(path.read_bytes())
    # two bytes of 0 that become 255 pass Fletcher's checksum
    zeros = data.find(b"\0\0\0\0", chunk.byte_offset, chunk.byte_offset + chunk.size)
    if zeros >= 0:
        damaged = data.copy()
        damaged[zeros : zeros + 4] = b"\xff" * 4
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="compressed/array is damaged or truncated"):
            Table.load(path)
    for at in np.linspace(0, chunk.size - 5, 20).astype(int):
        damaged = data.copy()
        damaged[chunk.byte_offset + at] ^= 4
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="compressed/array is damaged or truncated"):
            Table.load(path)


@pytest.mark.parametrize("method", METHODS)
def test_content_that_shrinks_to_nothing(tmp_path, method, monkeypatch):
    """A codec may need less than a thousandth of what it decodes to; reading must not take that for damage."""
    monkeypatch.setattr(hdf5_data, "_MAX_RATIO", 5)  # for tables hundreds of times as large
    table = make(lambert, grid(45, 60, 90))
    report = compress(table, tmp_path / "c.h5", method=method)
    assert report.error_worst <= 0.01
    assert report.bytes < 40_000
