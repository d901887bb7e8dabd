"""The HDF5 table: everything comes back, every kind of damage is one clear line, nothing half-written."""

from __future__ import annotations

import errno
import os

import h5py
import numpy as np
import pytest

from gonio import files, formats
from gonio.table.parts import walk
from gonio.table.table import Table
from gonio.validation import seed_from
from microgeometry.errors import InputError
from tests.formats.damage import refused
from tests.table.tables import asymmetric, grid, make, with_parts


def full_table():
    """Every field set, none of them trivial, and parts of parts."""
    rng = np.random.default_rng(seed_from("full table"))
    table = make(asymmetric, grid(6, 7, 8))
    table = table.replace(
        std_error=rng.random(table.values.shape),
        hits=rng.integers(0, 2**40, table.values.shape[:3]),
        gaps=rng.random(table.values.shape[:3]) < 0.1,
        albedo_std_error=rng.random((6, 3)),
        specular=0.1 * rng.random((6, 3)),
        specular_std_error=rng.random((6, 3)),
        channels=("630 nm", "π", "B"),
        wavelengths_nm=(630.0, 532.0, 467.0),
        ledger={"paths": 1000.0, "reflected": 700.5},
        provenance={"specimen": "kind = 'gaussian'\n" * 10_000, "seed": 3, "nested": {"alpha": [0.5, None]}},
    )
    return with_parts(table)


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "table.h5"
    assert full_table().save(path) == []
    return path


def assert_same(before, after):
    for name in Table.__dataclass_fields__:
        want, found = getattr(before, name), getattr(after, name)
        if isinstance(want, np.ndarray):
            assert found.dtype == want.dtype, name
            np.testing.assert_array_equal(found, want, err_msg=name)
        elif name == "parts":
            assert list(found) == list(want)  # in their order
            for part in want:
                assert_same(want[part], found[part])
        else:
            assert found == want, name


def test_everything_comes_back(saved):
    before, after = full_table(), Table.load(saved)
    assert_same(before, after)
    assert list(after.parts["transmission"].parts) == ["L1", "L2", "L3+"]


@pytest.mark.parametrize("kind", ["hard", "soft", "around"])
def test_parts_that_are_one_are_not_read_again_and_again(kind, saved):
    """A hundred links to one part would make a hundred tables of it."""
    with h5py.File(saved, "r+") as file:
        for n in range(100):
            target = {"hard": file["parts/L1"], "soft": h5py.SoftLink("/parts/L1"), "around": file}[kind]
            file[f"parts/M{n}"] = target
    refused(saved, r"\d+ links to \d+ groups and datasets; one to each is expected")


def test_parts_keep_their_order_beyond_nine(tmp_path):
    table = make(asymmetric, grid(2, 2, 2))
    names = [*(f"L{n}" for n in range(1, 11)), "L11+"]
    table.replace(parts={name: table for name in names}).save(tmp_path / "many.h5")
    assert list(Table.load(tmp_path / "many.h5").parts) == names


def test_a_file_of_version_1_0_has_no_parts(saved):
    def older(file):
        del file["parts"]
        file.attrs["version"] = "1.0"

    edit(saved, older)
    assert_same(full_table().replace(parts={}), Table.load(saved))


def test_optional_fields_stay_absent(tmp_path):
    make(asymmetric, theta_i=np.array([0.2, 0.9])).save(tmp_path / "bare.h5")
    table = Table.load(tmp_path / "bare.h5")
    for name in ("theta_i_edges", "std_error", "hits", "gaps", "wavelengths_nm"):
        assert getattr(table, name) is None


def test_units_axes_and_scales(saved):
    with h5py.File(saved) as file:
        assert file.attrs["format"] == "gonio-table"
        assert file.attrs["version"] == "1.7"
        values = file["values"]
        assert values.attrs["units"] == "1/sr"
        assert values.compression == "gzip"
        assert [d.label for d in values.dims] == ["theta_i", "theta_r", "delta_phi", "channel"]
        np.testing.assert_array_equal(values.dims[1][0][()], full_table().theta_r)
        assert file["theta_i"].attrs["units"] == "rad"
        inner = file["parts/transmission/parts/L3+/values"]
        assert inner.attrs["units"] == "1/sr"
        assert inner.compression == "gzip"


def test_xarray_opens_it(saved):
    xarray = pytest.importorskip("xarray", reason="xarray is not installed")
    pytest.importorskip("h5netcdf", reason="h5netcdf, through which xarray reads HDF5, is not installed")
    with xarray.open_dataset(saved, engine="h5netcdf") as data:
        table = full_table()
        assert data["values"].dims == ("theta_i", "theta_r", "delta_phi", "channel")
        np.testing.assert_array_equal(data["values"], table.values)
        np.testing.assert_array_equal(data["theta_i"], table.theta_i)
        assert list(data["channel"].values) == list(table.channels)
        assert data["values"].sel(theta_r=0.5, method="nearest").shape == (6, 8, 3)
    for group in ("transmission", "transmission/parts/L2"):
        with xarray.open_dataset(saved, engine="h5netcdf", group=f"parts/{group}") as data:
            part = dict(walk(table))[group.replace("/parts", "")]
            assert data["values"].dims == ("theta_i", "theta_r", "delta_phi", "channel")
            np.testing.assert_array_equal(data["values"], part.values)
            np.testing.assert_array_equal(data["theta_r"], table.theta_r)
            assert list(data["channel"].values) == list(table.channels)


def edit(path, action):
    with h5py.File(path, "r+") as file:
        action(file)


def drop(name):
    return lambda path: edit(path, lambda f: f.__delitem__(name))


def put(name, data):
    def action(file):
        if name in file:
            del file[name]
        file[name] = data

    return lambda path: edit(path, action)


def attribute(name, value):
    return lambda path: edit(path, lambda f: f.attrs.__setitem__(name, value))


def cut(fraction):
    return lambda path: os.truncate(path, int(path.stat().st_size * fraction))


def overwrite(path):
    """Garble the deflated rows, not the structure."""
    garble(path, "std_error")


def garble(path, dataset):
    with h5py.File(path) as file:
        chunk = file[dataset].id.get_chunk_info(2)
    with open(path, "r+b") as raw:
        raw.seek(chunk.byte_offset)
        raw.write(b"\xff" * chunk.size)


DAMAGE = {
    "text": (lambda p: p.write_text("theta,phi\n1,2\n"), "not an HDF5 file"),
    "empty": (lambda p: p.write_bytes(b""), "not an HDF5 file"),
    "truncated": (cut(0.6), "damaged or truncated"),
    "truncated early": (cut(0.01), "damaged or truncated"),
    "garbled chunk": (overwrite, "dataset std_error is damaged or truncated"),
    "foreign": (lambda p: (p.unlink(), edit_new(p)), "something else .it holds temperature"),
    "newer": (attribute("version", "2.0"), "version 2.0 is newer than 1.7, update gonio"),
    "no version": (attribute("version", "x"), "attribute version"),
    "no values": (drop("values"), "dataset values is missing"),
    "no channel": (drop("channel"), "dataset channel is missing"),
    "no albedo": (drop("row_albedo"), "dataset row_albedo is missing"),
    "shape": (put("row_albedo", np.zeros((5, 3))), r"row_albedo: shape \(5, 3\); \(6, 3\) is expected"),
    "text values": (put("values", "hello"), "dataset values holds .*numbers are expected"),
    "float hits": (put("hits", np.zeros((6, 7, 8))), "dataset hits holds float64; integers"),
    "nan": (put("values", np.full((6, 7, 8, 3), np.nan)), "values: contains NaN"),
    "nan error": (put("std_error", np.full((6, 7, 8, 3), np.nan)), "std_error: contains NaN"),
    "axis": (put("theta_r_edges", np.linspace(0, 2, 8)), "theta_r_edges: must increase"),
    "ledger": (attribute("ledger", "{nonsense"), "attribute ledger is no JSON"),
    "group": (
        lambda p: edit(p, lambda f: (f.__delitem__("row_albedo"), f.create_group("row_albedo"))),
        "albedo holds a group",
    ),
    "compressed": (put("compressed", np.zeros(3)), "compressed holds float64; integers are expected"),
    "parts": (put("parts", np.zeros(3)), "parts is a dataset; a group is expected"),
    "part": (put("parts/L1", np.zeros(3)), "parts/L1 is a dataset; a group is expected"),
    "part without values": (
        drop("parts/transmission/values"),
        "dataset parts/transmission/values is missing",
    ),
    "part without channel": (drop("parts/L1/channel"), "dataset parts/L1/channel is missing"),
    "part's nan": (
        put("parts/transmission/parts/L2/values", np.full((6, 7, 8, 3), np.nan)),
        "parts/transmission/parts/L2/values: contains NaN",
    ),
    "part's shape": (put("parts/L2/row_albedo", np.zeros((5, 3))), r"parts/L2/row_albedo: shape \(5, 3\)"),
    "part's text": (put("parts/L2/values", "hello"), "dataset parts/L2/values holds .*numbers are expected"),
    "part's chunk": (
        lambda p: garble(p, "parts/transmission/values"),
        "dataset parts/transmission/values is damaged or truncated",
    ),
    "part's ledger": (
        lambda p: edit(p, lambda f: f["parts/L1"].attrs.__setitem__("ledger", "[]")),
        "attribute parts/L1/ledger is no JSON",
    ),
    "part's grid": (
        put("parts/transmission/parts/L1/theta_i", np.linspace(0.1, 1.5, 6)),
        "parts/transmission/parts/L1: theta_i is not the table's",
    ),
    "part in itself": (
        lambda p: edit(p, lambda f: f["parts/L1"].__setitem__("parts", f["parts"])),
        r"\d+ links to \d+ groups",
    ),
}


def edit_new(path):
    with h5py.File(path, "w") as file:
        file["temperature"] = np.arange(3)


@pytest.mark.parametrize("name", DAMAGE)
def test_damaged_files(saved, name):
    damage, message = DAMAGE[name]
    damage(saved)
    refused(saved, message)


def test_a_claim_no_file_can_hold(saved):
    """A hundred bytes that say 8 TB: refused before anything is allocated."""

    def huge(file):
        del file["values"]
        file.create_dataset("values", (100, 10_000, 1_000_000, 1), float, chunks=(1, 100, 100, 1))

    edit(saved, huge)
    with pytest.raises(InputError, match="claims shape"):
        Table.load(saved)


def test_a_heap_that_hangs_the_library(saved):
    """A free object of size 0 among the texts: HDF5 2.0 would search it for ever."""
    data = bytearray(saved.read_bytes())
    start = data.index(b"GCOL")
    data[start + 16 : start + 32] = bytes(16)
    saved.write_bytes(data)
    with pytest.raises(InputError, match=r"damaged HDF5 file \(a heap object of 0 bytes"):
        Table.load(saved)


def test_text_that_is_not_utf8(saved):
    saved.write_bytes(saved.read_bytes().replace("π".encode(), b"\xb0\xb0"))
    with pytest.raises(InputError, match=r"damaged or truncated HDF5 file \('utf-8' codec"):
        Table.load(saved)


def test_newer_minor_version_is_read(saved):
    attribute("version", "1.7")(saved)
    assert Table.load(saved).values.shape == (6, 7, 8, 3)


def test_missing_file_and_unknown_suffix(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        Table.load(tmp_path / "absent.h5")
    (tmp_path / "folder.h5").mkdir()
    with pytest.raises(InputError, match="is not a file"):
        Table.load(tmp_path / "folder.h5")
    for action in (Table.load, full_table().save, lambda p: formats.convert(tmp_path / "absent.h5", p)):
        with pytest.raises(InputError, match=r"unknown suffix '\.png'; allowed are \.h5, \.binary"):
            action(tmp_path / "table.png")


def test_failure_while_writing_leaves_the_old_file(saved, monkeypatch):
    before = saved.read_bytes()

    def full(*_args, **_options):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left") as caught:
        full_table().save(saved)
    assert str(saved) in str(caught.value)
    assert saved.read_bytes() == before
    assert os.listdir(saved.parent) == [saved.name]


def test_disk_full(tmp_path):
    """A real limit on the size of files, in a process of its own."""
    resource = pytest.importorskip("resource")
    pid = os.fork()
    if pid == 0:
        import signal

        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))
        status = 1
        try:
            full_table().save(tmp_path / "full.h5")
        except OSError as error:
            status = 0 if str(tmp_path / "full.h5") in str(error) else 2
        finally:
            os._exit(status)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
    assert os.listdir(tmp_path) == []


def test_missing_folder(tmp_path):
    with pytest.raises(OSError, match=r"absent/t\.h5 could not be written"):
        full_table().save(tmp_path / "absent" / "t.h5")


def test_atomic_keeps_the_usual_mode_and_removes_on_any_error(tmp_path):
    with files.atomic(tmp_path / "a.json") as temporary:
        assert temporary.suffix == ".json"
        assert not (tmp_path / "a.json").exists()
        temporary.write_text("{}")
    mask = os.umask(0)
    os.umask(mask)
    assert (tmp_path / "a.json").stat().st_mode & 0o777 == 0o666 & ~mask

    def interrupted():
        with files.atomic(tmp_path / "a.json") as temporary:
            temporary.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert (tmp_path / "a.json").read_text() == "{}"
    assert os.listdir(tmp_path) == ["a.json"]
