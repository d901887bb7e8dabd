"""Damaged content of compressed files is one clear line."""

from __future__ import annotations

import zlib

import h5py
import numpy as np
import pytest

from gonio.formats import hdf5_data
from gonio.formats.packed import pack_record
from gonio.table.compress import compress
from gonio.table.table import Table
from microgeometry.errors import InputError
from tests.table.tables import edit_record, ggx, grid, lambert, make

pytestmark = pytest.mark.compiled

EDGES = grid(30, 30, 45)
CODECS = "zfp", "sz3", "blosc2"


def put(name, item):
    return lambda record: record.__setitem__(name, item)


def change(name, how):
    return lambda record: record.__setitem__(name, how(record[name]))


def drop(name):
    return lambda record: record.__delitem__(name)


HUGE = {
    "theta_i": np.linspace(0, 1, 65535),
    **{name: np.linspace(0, 1, 65536) for name in ("theta_r_edges", "delta_phi_edges")},
    "gaps": np.zeros(9, np.uint8),
}


DAMAGE = {
    "method": ("dct", put("content/method", "wavelet"), "method 'wavelet' is unknown"),
    "no method": ("dct", drop("content/method"), "method None is unknown"),
    "no step": ("dct", drop("content/step"), "damaged content"),
    "rings along": ("dct", put("content/rings_along", 10**12), "damaged content"),
    "rings along inf": ("dct", put("content/rings_along", float("inf")), "damaged content"),
    "scale": ("dct", put("content/scale", np.ones((2, 2), "f4")), "damaged content"),
    "nan": ("dct", put("content/scale_floor", float("nan")), "damaged content"),
    "short rings": ("dct", put("content/rings", np.zeros(50, np.uint8)), "damaged content"),
    "coefficients": ("dct", put("content/coefficients", np.zeros(50, np.uint8)), "damaged content"),
    "missing": ("dct", drop("content/coefficients"), "damaged content"),
    "text": ("dct", put("content/coefficients", "hello"), "damaged content"),
    "another method's": ("dct", put("content/method", "tree"), "damaged content"),
    "rings": ("tree", put("content/ring_step", 2.0), "damaged content"),
    "bright rings": ("tree", put("content/ring_floor", 1e308), "damaged content"),
    "tree": ("tree", put("content/tree", np.zeros(9, np.uint8)), "bytes too many"),
    "wide box": ("tree", put("content/tree", np.full(9, 255, np.uint8)), "numbers that no encoder writes"),
    "negative step": ("tree", put("content/step", -1.0), "damaged content"),
    "basis": ("low_rank", change("content/basis", lambda basis: basis[:-1]), "weights and basis of shape"),
    "flat basis": (
        "low_rank",
        change("content/basis", lambda basis: basis[:, 0]),
        "weights and basis of shape",
    ),
    "weights": ("low_rank", put("content/weights", np.zeros(31, "f4")), "damaged content"),
    "huge basis": ("low_rank", change("content/basis", lambda basis: 9 * basis), "not orthonormal"),
    "axis of nan": (
        "low_rank",
        put("theta_r_edges", np.full(31, np.nan)),
        "damaged content .axes that are not angles",
    ),
    "no axis": ("tree", drop("theta_i"), "damaged content .'theta_i' is missing"),
    "text axis": ("tree", put("theta_i", "hello"), "compressed/theta_i is no array"),
    "single edge": ("tree", put("theta_r_edges", np.array(3.0)), "theta_r_edges is a single number"),
    "axis": ("tree", put("theta_r_edges", np.linspace(0, 1, 31)), "theta_r_edges: must increase"),
    "shape": ("tree", put("albedo_of_cells", np.ones((5, 3))), "damaged content"),
    "ledger": ("tree", put("ledger", [1.0]), "ledger is no object"),
    "channels": ("tree", put("channels", 3), "damaged content"),
    "gaps": ("tree", put("gaps", np.zeros(20000, np.uint8)), "bytes too many"),
    "huge gaps": ("tree", lambda record: record.update(HUGE), "gaps of .65535, 65535, 65535. cells"),
    "parts": ("tree", put("parts", ["L1"]), "compressed/L1: damaged content"),
    "a part of itself": ("tree", put("parts", [""]), "compressed: damaged content"),
    "half a peak": ("tree", put("peak/slope_edges", np.zeros(9)), "psi_edges is no array"),
    "huge peak": (
        "tree",
        lambda record: record.update({f"peak/{n}_edges": np.zeros(2**14) for n in ("slope", "psi")}),
        "peak: 16384 x 16384 cells",
    ),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_damaged_content(tmp_path, name):
    path = tmp_path / "c.h5"
    method, damage, message = DAMAGE[name]
    compress(make(ggx(0.5, 0.9), EDGES), path, 0.1, method)
    edit_record(path, damage)
    with pytest.raises(InputError, match=message) as caught:
        Table.load(path)
    assert str(path) in str(caught.value)


FILTERED = {
    "array": ("zfp", np.zeros((3, 3), "f4"), "an array of shape"),
    "array of nan": ("sz3", np.full((3, 30, 30, 45), np.nan, "f4"), "damaged content"),
    "no array": ("blosc2", None, "damaged content"),
}


@pytest.mark.parametrize("name", FILTERED)
def test_damaged_arrays(tmp_path, name):
    path = tmp_path / "c.h5"
    method, array, message = FILTERED[name]
    compress(make(ggx(0.5, 0.9), EDGES), path, 0.1, method)
    with h5py.File(path, "r+") as file:
        del file["compressed_content.array"]
        if array is not None:
            file["compressed_content.array"] = array
    with pytest.raises(InputError, match=message):
        Table.load(path)


def test_a_file_of_an_older_version(tmp_path):
    path = tmp_path / "c.h5"
    compress(make(ggx(0.5, 0.9), EDGES), path, 0.1, "dct")
    with h5py.File(path, "r+") as file:
        file.attrs["version"] = np.bytes_("1.5")
    with pytest.raises(InputError, match="compressed by an older version of gonio; compress the table again"):
        Table.load(path)


RECORDS = {
    "nothing": b"",
    "not deflated": b"hello",
    "not JSON": zlib.compress(b"[\n"),
    "a list": zlib.compress(b"[]\n"),
    "deep": zlib.compress(b"[" * 100_000),
    "type": zlib.compress(b'[{},{"a":["O",1]}]\n' + bytes(8)),
    "shape": zlib.compress(b'[{},{"a":["f8",-1]}]\n' + bytes(8)),
    "fraction": zlib.compress(b'[{},{"a":["f8",0.5]}]\n' + bytes(8)),
    "larger than the file": zlib.compress(b'[{},{"a":["f8",1000000000000]}]\n' + bytes(8)),
    "truncated": pack_record({"a": np.arange(9.0)}).tobytes()[:-3],
}


@pytest.mark.parametrize("name", RECORDS)
def test_damaged_records(tmp_path, name):
    path = tmp_path / "c.h5"
    compress(make(ggx(0.5, 0.9), EDGES), path, 0.1, "dct")
    with h5py.File(path, "r+") as file:
        del file["compressed"]
        file["compressed"] = np.frombuffer(RECORDS[name], np.uint8)
    with pytest.raises(InputError, match="compressed: damaged content"):
        Table.load(path)


@pytest.mark.parametrize("method", CODECS)
def test_bytes_the_codec_would_trust_are_checked_before(tmp_path, method):
    """One bit flipped in what the filter wrote: the checksum finds it, no decoder sees it."""
    path = tmp_path / "c.h5"
    compress(make(ggx(0.5, 0.9), EDGES), path, 0.02, method)
    with h5py.File(path) as file:
        chunk = file["compressed_content.array"].id.get_chunk_info(0)
    data = bytearray(path.read_bytes())
    # two bytes of 0 that become 255 pass Fletcher's checksum
    zeros = data.find(b"\0\0\0\0", chunk.byte_offset, chunk.byte_offset + chunk.size)
    if zeros >= 0:
        damaged = data.copy()
        damaged[zeros : zeros + 4] = b"\xff" * 4
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=r"compressed_content\.array is damaged or truncated"):
            Table.load(path)
    for at in np.linspace(0, chunk.size - 5, 20).astype(int):
        damaged = data.copy()
        damaged[chunk.byte_offset + at] ^= 4
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=r"compressed_content\.array is damaged or truncated"):
            Table.load(path)


@pytest.mark.parametrize("method", CODECS)
def test_content_that_shrinks_to_nothing(tmp_path, method, monkeypatch):
    """A codec may need less than a thousandth of what it decodes to; reading must not take that for damage."""
    monkeypatch.setattr(hdf5_data, "_MAX_RATIO", 5)  # for tables hundreds of times as large
    table = make(lambert, grid(45, 60, 90))
    report = compress(table, tmp_path / "c.h5", method=method)
    assert report.error_worst <= 0.01
    assert report.bytes < 40_000
