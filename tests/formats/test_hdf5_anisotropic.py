"""Anisotropic tables in HDF5."""

import h5py
import numpy as np
import pytest

from gonio import Table, formats
from gonio.core.jit import disabled
from gonio.table.table import Table as Isotropic
from microgeometry.errors import InputError
from tests.table.test_anisotropic import table_of

pytestmark = pytest.mark.skipif(disabled, reason="needs compiled kernels")


@pytest.fixture
def table():
    plain = table_of(
        0.3, 0.1, n_phi=4, cells=8, theta_i=np.radians([0, 40, 70]), channels=("630 nm", "532 nm")
    )
    plain = plain.replace(
        std_error=0.1 * plain.energy, wavelengths_nm=(630.0, 532.0), albedo_std_error=0.01,
        ledger={"paths": 10.0}, provenance={"name": "satin", "seed": 3},
    )  # fmt: skip
    return plain.replace(parts={"transmission": plain.replace(energy=0.5 * plain.energy)})


def same(a, b):
    assert a.channels == b.channels
    assert a.wavelengths_nm == b.wavelengths_nm
    assert a.ledger == b.ledger
    assert a.provenance == b.provenance
    for name in ("energy", "std_error", "theta_i", "phi_i", "tilt_x_edges", "row_albedo", "albedo_std_error"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name
    assert list(a.parts) == list(b.parts)
    for name, part in a.parts.items():
        same(part, b.parts[name])


def test_round_trip(table, tmp_path):
    assert table.save(tmp_path / "t.h5") == []
    same(Table.load(tmp_path / "t.h5"), table)


def test_xarray_opens_it(table, tmp_path):
    xarray = pytest.importorskip("xarray")
    table.save(tmp_path / "t.h5")
    with xarray.open_dataset(tmp_path / "t.h5") as data:
        assert data.energy.dims == ("theta_i", "phi_i", "tilt_x", "tilt_y", "channel")
        assert float(data.energy.sel(theta_i=0.6, method="nearest").sum()) == pytest.approx(
            float(table.energy[1].sum()), rel=1e-5
        )


def test_who_wants_an_isotropic_one_is_told(table, tmp_path):
    table.save(tmp_path / "t.h5")
    with pytest.raises(InputError, match=r"anisotropic table.*trace the specimen without"):
        formats.read(tmp_path / "t.h5")
    with pytest.raises(InputError, match=r"only be written as \.h5"):
        table.save(tmp_path / "t.binary")
    assert not isinstance(Table.load(tmp_path / "t.h5"), Isotropic)


@pytest.mark.parametrize("name", ["energy", "phi_i", "tilt_x_edges", "row_albedo"])
def test_a_missing_dataset_is_named(table, tmp_path, name):
    table.save(tmp_path / "t.h5")
    with h5py.File(tmp_path / "t.h5", "r+") as file:
        del file[name]
    with pytest.raises(InputError, match=rf"t\.h5.*{name} is missing"):
        Table.load(tmp_path / "t.h5")


def test_cells_of_an_older_version_are_refused(table, tmp_path):
    table.save(tmp_path / "t.h5")
    with h5py.File(tmp_path / "t.h5", "r+") as file:
        file.attrs["version"] = "1.0"
    with pytest.raises(InputError, match=r"version 1\.0 has its cells laid out otherwise.*trace it again"):
        Table.load(tmp_path / "t.h5")
    with h5py.File(tmp_path / "t.h5", "r+") as file:
        file.attrs["version"] = "3.0"
    with pytest.raises(InputError, match=r"newer than 2\.0"):
        Table.load(tmp_path / "t.h5")


def test_a_truncated_file_is_refused(table, tmp_path):
    table.save(tmp_path / "t.h5")
    content = (tmp_path / "t.h5").read_bytes()
    (tmp_path / "t.h5").write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match="damaged or truncated"):
        Table.load(tmp_path / "t.h5")
