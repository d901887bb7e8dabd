"""What all formats share: choice by suffix and content, and what a conversion reports."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from gonio import formats
from gonio.formats.highlights import resolved
from gonio.table.peak import Peak
from gonio.table.table import Table
from microgeometry.errors import InputError
from tests.formats.test_highlights import metal, sampled
from tests.formats.test_lists import write_astm, write_lighttools, write_openmaterial
from tests.formats.test_plane_csv import write as write_plane
from tests.formats.test_speos import write_brdf
from tests.formats.test_zemax import write_file
from tests.table.tables import asymmetric, grid, lambert, make, with_parts


@pytest.fixture
def saved(tmp_path):
    table = make(asymmetric, grid(12, 12, 18), specular=0.02)
    table = table.replace(std_error=0.01 * table.values)
    table.save(tmp_path / "t.h5")
    return tmp_path / "t.h5"


@pytest.mark.compiled
def test_bsdf_files_are_told_apart_by_content(tmp_path):
    make(lambert, grid(6, 6, 8)).save(tmp_path / "rgl.bsdf")
    write_file(tmp_path / "zemax.bsdf", lambert)
    write_lighttools(tmp_path / "lighttools.bsdf")
    for name, called in (("rgl", "RGL"), ("zemax", "Zemax"), ("lighttools", "LightTools")):
        shutil.copy(tmp_path / f"{name}.bsdf", tmp_path / "x.BSDF")
        assert Table.load(tmp_path / "x.BSDF").provenance["format"] == called
    make(lambert, grid(6, 6, 8)).save(tmp_path / "t.zemax.bsdf")
    assert (tmp_path / "t.zemax.bsdf").read_text().startswith("#")


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["t.bsdf", "t.zemax.bsdf", "t.xml", "t.csv", "t.npz"])
def test_conversion_says_what_it_lost_and_how_far_off_it_is(name, saved):
    done = formats.convert(saved, saved.parent / name)
    exact = name in ("t.csv", "t.npz")
    assert ("error bars" in done.lost) != exact
    assert any("delta" in what for what in done.lost) != exact
    if exact:
        assert done.worst < 1e-7
    else:
        assert 1e-4 < done.error <= done.worst < 0.2
        assert done.albedo_error < 0.02


@pytest.mark.compiled
def test_error_is_that_of_a_wrong_file(saved):
    """Twice the values: an error of 1; light and detector exchanged: more than a conversion's."""
    table = Table.load(saved)
    doubled = table.replace(values=2 * table.values, row_albedo=2 * (table.row_albedo - 0.02) + 0.02)
    np.testing.assert_allclose(formats._compare(table, doubled), 1.0, rtol=1e-4)
    swapped = make(lambda wi, wo: asymmetric(wo, wi), grid(12, 12, 18), specular=0.02)
    assert formats._compare(table, swapped)[0] > 0.1


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["t.binary", "t.zemax.bsdf", "t.xml", "t.tree.xml"])
def test_the_longest_of_three_wavelengths_is_red(name, tmp_path):
    """Blue, green and red of albedos 1/2, 4/10 and 1/4 in a table, and in the file red, green and blue."""
    table = make(lambert, grid(9, 9, 12)).replace(wavelengths_nm=(467.0, 532.0, 630.0))
    table = table.replace(parts={"transmission": table})
    table.save(tmp_path / "t.h5")
    done = formats.convert(tmp_path / "t.h5", tmp_path / name)
    assert any("630, 532 and 467 nm are written as R, G and B" in what for what in done.lost)
    again = Table.load(tmp_path / name)
    np.testing.assert_allclose(again.albedo(0.5), [0.25, 0.4, 0.5], rtol=0.02)
    if name.endswith(".xml"):
        np.testing.assert_allclose(again.parts["transmission"].albedo(0.5), [0.25, 0.4, 0.5], rtol=0.02)
    assert done.albedo_error < 0.02


@pytest.mark.compiled
@pytest.mark.parametrize("part", ["transmission", "transmission/L1"])
@pytest.mark.parametrize("name", ["t.zemax.bsdf", "t.xml", "t.tree.xml", "t.bsdf", "t.csv"])
def test_transmission_alone_is_written_as_such(name, part, tmp_path):
    """Or, where the format knows no such thing, said to be lost; the error is that of what was written."""
    with_parts(make(lambert, grid(9, 9, 12))).save(tmp_path / "t.h5")
    done = formats.convert(tmp_path / "t.h5", tmp_path / name, part)
    assert done.worst < 0.1
    again = Table.load(tmp_path / name)
    alike = not name.endswith((".zemax.bsdf", ".xml"))
    assert any(what.startswith("that the light is transmitted") for what in done.lost) == alike
    written = again if alike else again.parts["transmission"]
    scale = 0.25 * (0.5 if part.endswith("L1") else 1.0)
    np.testing.assert_allclose(written.albedo(0.5), scale * 0.5 * np.array([1.0, 0.8, 0.5]), rtol=0.02)
    if not alike:
        assert np.all(again.gaps)
        assert np.all(again.values == 0)


@pytest.mark.compiled
def test_error_of_a_highlight_on_its_own_grid(tmp_path):
    """Cells alone hold the same light less finely; a tenth more light is a tenth; and more of it is found."""
    table = resolved(sampled(metal(0.01)), metal(0.01))
    assert table.peak is not None
    coarse = formats._compare(table, table.replace(peak=None))
    assert coarse[0] > 0.3
    assert coarse[2] < 0.02
    more = table.replace(row_albedo=1.1 * table.row_albedo, values=1.1 * table.values,
                         peak=Peak(1.1 * table.peak.values, table.peak.slope_edges, table.peak.psi_edges))  # fmt: skip
    np.testing.assert_allclose(formats._compare(table, more), 0.1, rtol=1e-3)


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["t.bsdf", "t.zemax.bsdf", "t.xml", "t.tree.xml", "t.csv"])
def test_losses_of_highlight_and_rows(name, tmp_path):
    """Said where they are lost, and nowhere else."""
    peak = Peak(np.ones((2, 2, 2, 3)), np.array([0, 0.05, 0.1]), np.array([0, 1.0, np.pi]))
    table = make(lambert, grid(9, 9, 12), theta_i=np.radians([15.0, 75.0])).replace(peak=peak)
    lost = " ".join(table.save(tmp_path / name))
    assert ("fine grid of the highlight" in lost) == (name in ("t.xml", "t.tree.xml", "t.csv"))
    assert ("from 15 to 75 degrees only" in lost) == (name in ("t.bsdf", "t.xml", "t.tree.xml"))
    table = make(lambert, grid(9, 9, 12))
    assert "degrees only" not in " ".join(table.save(tmp_path / name))


def test_what_reading_lost_is_reported(tmp_path):
    write_file(tmp_path / "z.bsdf", lambert, "Asymmetrical4D", rotations=(0, 90))
    done = formats.convert(tmp_path / "z.bsdf", tmp_path / "z.h5")
    assert done.lost[0] == "2 rotations of the sample: they are averaged"
    assert done.lost[1].startswith("the reflectance TIS, 0.66")  # 0.5 of three quarters
    # once and twice the same are off their mean by 0.5 of sqrt(2.5)
    assert done.lost[2].startswith("the file's own samples: where they stand f differs by 32 % (RMS")
    assert done.error == 0


def test_targets_that_cannot_be(tmp_path):
    for name in ("t.astm", "t.brdf", "t.anisotropicbsdf", "t.xompt"):
        with pytest.raises(
            InputError, match=r"only read; written are \.h5, \.binary, \.bsdf, \.xml, \.csv, \.npz"
        ):
            formats.check_target(tmp_path / name)
    with pytest.raises(InputError, match="does not exist; create it first"):
        formats.check_target(tmp_path / "absent" / "t.csv")


@pytest.mark.parametrize("name", ["t.csv", "plane.csv", "z.bsdf", "l.bsdf", "a.astm", "s.brdf", "o.xompt"])
def test_mark_of_utf8_in_front(name, tmp_path):
    """As spreadsheets put it before a CSV, and editors on Windows before any text."""
    path = tmp_path / name
    {
        "t.csv": lambda p: make(asymmetric, grid(3, 3, 4)).save(p),
        "plane.csv": write_plane,
        "z.bsdf": lambda p: write_file(p, lambert),
        "l.bsdf": write_lighttools,
        "a.astm": write_astm,
        "s.brdf": lambda p: write_brdf(p, lambert),
        "o.xompt": write_openmaterial,
    }[name](path)
    table = Table.load(path)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    np.testing.assert_array_equal(Table.load(path).values, table.values)


def test_source_is_not_overwritten(tmp_path):
    """A measurement would be lost to its own resampling, or a table to a part of it."""
    path = write_file(tmp_path / "z.bsdf", lambert)
    (tmp_path / "link.bsdf").symlink_to(path)
    before = path.read_bytes()
    for target in (path, tmp_path / "." / "z.bsdf", tmp_path / "link.bsdf"):
        with pytest.raises(InputError, match="is the file to be converted; choose another name"):
            formats.convert(path, target)
    assert path.read_bytes() == before


def test_errors_of_the_table_name_the_file(tmp_path):
    """Values that no table may hold, found only when it is built."""
    path = write_file(tmp_path / "z.bsdf", lambert)
    path.write_text(path.read_text().replace("1.591549e-01", "1e308"))
    with pytest.raises(InputError, match=f"{path}: (values|row_albedo): contains NaN or infinity"):
        Table.load(path)


def test_text_by_content(tmp_path):
    write_lighttools(tmp_path / "l.txt", tuple(range(0, 361, 30)))
    write_file(tmp_path / "z.txt", lambert)
    assert Table.load(tmp_path / "l.txt").provenance["format"] == "LightTools"
    assert Table.load(tmp_path / "z.txt").provenance["format"] == "Zemax"


def test_readings_of_a_goniometer_are_no_bsdf(real_data):
    with pytest.raises(InputError, match=r"Reflet goniometer: its .Data file type. names"):
        Table.load(real_data / "ualoft" / "test_lighttools.txt")
