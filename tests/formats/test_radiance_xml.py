"""WINDOW/Radiance XML: patches, trees, conventions, colours, round trips, unsafe XML, damage."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gonio import formats
from gonio.core.directions import direction
from gonio.formats.klems import BASES, Klems
from gonio.formats.radiance_values import matrix_texts
from gonio.formats.tensor_tree import (
    TensorTree,
    coordinates,
    directions,
    disk_to_square,
    square_to_disk,
    tree_text,
)
from gonio.table.checks import check
from gonio.table.table import Table
from gonio.validation import seed_from
from microgeometry.errors import InputError
from tests.formats.damage import refused
from tests.table.tables import asymmetric, ggx, grid, lambert, make, with_parts

HEAD = '<?xml version="1.0"?><WindowElement xmlns="http://windows.lbl.gov"><Optical><Layer><DataDefinition>'


def document(structure, blocks):
    """A file of (kind, direction, basis, text)."""
    text = f"{HEAD}<IncidentDataStructure>{structure}</IncidentDataStructure></DataDefinition>"
    for kind, where, basis, data in blocks:
        text += (
            f'<WavelengthData><Wavelength unit="Integral">{kind}</Wavelength><WavelengthDataBlock>'
            f"<WavelengthDataDirection>{where}</WavelengthDataDirection><ColumnAngleBasis>{basis}</ColumnAngleBasis>"
            f"<RowAngleBasis>{basis}</RowAngleBasis><ScatteringData>{data}</ScatteringData>"
            "</WavelengthDataBlock></WavelengthData>"
        )
    return text + "</Layer></Optical></WindowElement>"


def patch_centres(name):
    """Direction of every patch's centre, counted as Klems counts."""
    bounds, counts = BASES[name]
    centres = []
    for ring, count in enumerate(counts):
        theta = 0 if ring == 0 else math.radians(0.5 * (bounds[ring] + bounds[ring + 1]))
        centres += [direction(theta, 2 * math.pi * k / count) for k in range(count)]
    return np.array(centres)


def matrix_text(name, brdf, transposed=False):
    """Rows outgoing, columns incident; light of an incident patch travels along the patch's (x, y)."""
    centres = patch_centres(name)
    wi = centres * [-1, -1, 1]
    values = brdf(wi[None, :], centres[:, None])
    values = values.T if transposed else values
    return "\n".join(",".join(f"{v:.6e}" for v in row) for row in values)


@pytest.mark.parametrize("name", BASES)
def test_patches(name):
    basis = Klems(name)
    assert basis.size == {"Full": 145, "Half": 73, "Quarter": 41}[name.split()[-1]]
    for patch in range(basis.size):
        theta, phi = basis.points(patch, 3, 4)
        np.testing.assert_array_equal(basis.index(theta, phi), patch)
    centres = patch_centres(name)
    found = basis.index(np.arccos(centres[:, 2]), np.arctan2(centres[:, 1], centres[:, 0]))
    np.testing.assert_array_equal(found, np.arange(basis.size))


@pytest.mark.parametrize("structure", ["Columns", "Rows"])
@pytest.mark.parametrize("name", BASES)
def test_asymmetric_matrix(name, structure, tmp_path):
    """Fails with rows and columns exchanged, with delta phi mirrored, with a cosine."""
    text = matrix_text(name, asymmetric, structure == "Rows")
    half = matrix_text(name, lambda wi, wo: 0.5 * asymmetric(wi, wo), structure == "Rows")
    path = tmp_path / "a.xml"
    blocks = [("Visible", "Reflection Front", name, text), ("Visible", "Transmission Front", name, half)]
    path.write_text(document(structure, blocks))
    table = Table.load(path)
    assert table.channels == ("Y",)
    inner = slice(1, len(table.theta_i) - 1)
    wo = direction(table.theta_r[inner, None], table.delta_phi)
    for row in range(1, len(table.theta_i) - 1):
        expected = asymmetric(direction(table.theta_i[row]), wo)
        # nearest patch in azimuth: up to 22 degrees off
        np.testing.assert_allclose(table.values[row, inner, :, 0], expected, rtol=0.15)
        mean = table.values[row, inner, :, 0].mean(axis=1)
        np.testing.assert_allclose(mean, expected.mean(axis=1), rtol=0.02)
    np.testing.assert_allclose(table.parts["transmission"].values, 0.5 * table.values, rtol=1e-5)
    assert check(table).passed


def radiance_look_up(grid, w_in, w_out):
    """f in a cube, step by step as Radiance does (SDqueryTre, SDdisk2square)."""

    def disk_to_square(x, y):
        r, phi = math.hypot(x, y), math.atan2(y, x)
        if phi < -math.pi / 4:
            phi += 2 * math.pi
        if phi < math.pi / 4:
            a, b = r, phi * r / (math.pi / 4)
        elif phi < 3 * math.pi / 4:
            b, a = r, -(phi - math.pi / 2) * r / (math.pi / 4)
        elif phi < 5 * math.pi / 4:
            a, b = -r, -(phi - math.pi) * r / (math.pi / 4)
        else:
            b, a = -r, (phi - 3 * math.pi / 2) * r / (math.pi / 4)
        return (a + 1) / 2, (b + 1) / 2

    turn = -math.atan2(-w_in[1], -w_in[0])
    c, s = math.cos(turn), math.sin(turn)
    x, y = c * w_out[0] - s * w_out[1], s * w_out[0] + c * w_out[1]
    position = (0.5 - 1e-9 - 0.5 * math.hypot(w_in[0], w_in[1]), *disk_to_square(x, y))
    return grid[tuple(min(len(grid) - 1, int(p * len(grid))) for p in position)]


def test_tree_is_looked_up_as_radiance_does():
    rng = np.random.default_rng(seed_from("tensor tree"))
    grid = rng.random((16, 16, 16))
    nested = TensorTree(tree_text(grid, 0.0), None)
    whole = TensorTree("{" + " ".join(f"{v:.6g}" for v in grid.ravel()) + "}", None)
    u = rng.random((3, 500))
    theta = np.arcsin(np.sqrt(0.98 * u[:2]))
    phi = u[2] * 2 * np.pi
    azimuth = rng.uniform(0, 2 * np.pi, 500)
    wi, wo = direction(theta[0], azimuth), direction(theta[1], azimuth + phi)
    expected = [radiance_look_up(grid, a, b) for a, b in zip(wi, wo, strict=True)]
    points = coordinates(theta[0], theta[1], phi)
    for tree in (nested, whole):
        np.testing.assert_allclose(tree.look_up(points), expected, rtol=1e-5)
    back = directions(points)
    np.testing.assert_allclose(back[0], theta[0], atol=1e-9)
    np.testing.assert_allclose(back[1], theta[1], atol=1e-9)
    np.testing.assert_allclose(np.cos(back[2]), np.cos(phi), atol=1e-9)


def test_disk_and_square():
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0.01, 0.99, 41), np.linspace(0.01, 0.99, 43)))
    np.testing.assert_allclose(disk_to_square(*square_to_disk(u, v)), (u, v), atol=1e-9)


def test_octants_that_are_alike_are_joined():
    cube = np.ones((8, 8, 8))
    assert tree_text(cube, 0.01) == "{ 1 }"
    cube[0, 0, 7] = 2  # in the octant of bit 2
    tree = TensorTree(tree_text(cube, 0.01), None)
    assert len(tree.values) == 7 + 7 + 8
    assert tree.look_up(np.array([[0.01, 0.01, 0.99], [0.99, 0.01, 0.01]])).tolist() == [2.0, 1.0]


@pytest.mark.compiled
@pytest.mark.parametrize("alpha", [0.3, 0.03])
def test_matrix_keeps_the_light_of_narrow_lobes(alpha):
    """A patch of 10 degrees sends out what the table does, averaged over it, however narrow the lobe."""
    table = make(ggx(alpha, 0.8), grid(90, 90, 180), tint=(1.0,), cell_points=4)
    basis = Klems("LBNL/Klems Full")
    matrix = np.array([line.split(",")[:-1] for line in matrix_texts(table)["Visible"].splitlines()], float)
    rings = np.repeat(np.arange(9), basis.counts)
    u = np.sin(basis.edges) ** 2
    areas = (np.pi * np.diff(u) / basis.counts)[rings]
    inside = np.arcsin(np.sqrt(u[:-1, None] + np.linspace(0.05, 0.95, 10) * np.diff(u)[:, None]))
    np.testing.assert_allclose(areas @ matrix, table.albedo(inside).mean(axis=(1, 2))[rings], rtol=0.01)


@pytest.mark.compiled
@pytest.mark.parametrize(("name", "error", "worst"), [("t.xml", 0.03, 0.08), ("t.tree.xml", 0.02, 0.05)])
def test_round_trip(name, error, worst, tmp_path):
    table = with_parts(make(asymmetric, grid(30, 30, 36)))
    table.save(tmp_path / "t.h5")
    done = formats.convert(tmp_path / "t.h5", tmp_path / name)
    again = Table.load(tmp_path / name)
    assert again.channels == ("R", "G", "B")
    assert done.error < error
    assert done.worst < worst
    assert done.albedo_error < 0.01
    assert any("L1, L2" in what for what in done.lost)
    assert not any("transmission" in what for what in done.lost)
    below = again.parts["transmission"]
    np.testing.assert_allclose(below.row_albedo, 0.25 * again.row_albedo, rtol=0.02)
    median, _, _ = formats._compare(table.parts["transmission"], below)
    assert median < error


@pytest.mark.compiled
def test_grey_stays_grey(tmp_path):
    for name in ("g.xml", "g.tree.xml"):
        make(lambert, grid(6, 6, 8), tint=(1.0, 1.0, 1.0)).save(tmp_path / name)
        again = Table.load(tmp_path / name)
        np.testing.assert_allclose(again.values, 0.5 / np.pi, rtol=1e-4)
        make(lambert, grid(6, 6, 8), tint=(1.0,)).save(tmp_path / name)
        assert Table.load(tmp_path / name).channels == ("Y",)
    with pytest.raises(InputError, match="2 channels"):
        make(lambert, grid(6, 6, 8), tint=(1.0, 0.5)).save(tmp_path / "g.xml")


def test_back_side_and_transmission_alone(tmp_path):
    name = "LBNL/Klems Quarter"
    ones, twos = " ".join(["1"] * 41**2), " ".join(["2"] * 41**2)
    path = tmp_path / "a.xml"
    path.write_text(document("Columns", [("Visible", "Reflection Back", name, ones)]))
    assert np.all(Table.load(path).values == 1)
    blocks = [("Visible", "Reflection Back", name, ones), ("Visible", "Reflection Front", name, twos)]
    path.write_text(document("Columns", blocks))
    table = Table.load(path)
    assert np.all(table.values == 2)
    assert "reflection back" in table.provenance["lost"][0]
    path.write_text(document("Columns", [("Visible", "Transmission Front", name, ones)]))
    table = Table.load(path)
    assert np.all(table.gaps)
    assert np.all(table.parts["transmission"].values == 1)


QUARTER = ("Visible", "Reflection Front", "LBNL/Klems Quarter", " ".join(["1"] * 41**2))
TREE = ("Visible", "Reflection Front", "LBNL/Shirley-Chiu", "{ 1 }")
BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]><x>&b;</x>'
DAMAGE = {
    "empty": ("", "no XML"),
    "truncated": (document("Columns", [QUARTER])[:-30], "no XML"),
    "entities": (BOMB, "no XML that can be read safely"),
    "external": ('<!DOCTYPE x SYSTEM "file:///etc/passwd"><x/>', "no XML that can be read safely"),
    "other": ("<svg/>", "IncidentDataStructure ''"),
    "anisotropic": (document("TensorTree4", [TREE]), "'TensorTree4'; Columns, Rows and TensorTree3"),
    "no data": (document("Columns", []), "no reflection or transmission"),
    "solar": (document("Columns", [("Solar", *QUARTER[1:])]), "no reflection or transmission"),
    "basis": (document("Columns", [(*QUARTER[:2], "Eighth", "1")]), "angle basis Eighth"),
    "short": (document("Columns", [(*QUARTER[:3], "1 2 3")]), "3 numbers of ScatteringData; 1681"),
    "word": (document("Columns", [(*QUARTER[:3], QUARTER[3][:-1] + "x")]), "numbers are expected"),
    "two bases": (
        document(
            "Columns",
            [QUARTER, ("Visible", "Transmission Front", "LBNL/Klems Full", " ".join(["1"] * 145**2))],
        ),
        "different bases",
    ),
    "brace": (document("TensorTree3", [(*TREE[:3], "{ 1")]), "without its last }"),
    "begin": (document("TensorTree3", [(*TREE[:3], "1 }")]), "{ is expected"),
    "after": (document("TensorTree3", [(*TREE[:3], "{1} 2")]), "text after the end"),
    "five": (document("TensorTree3", [(*TREE[:3], "{1 2 3 4 5}")]), "a node of 5 numbers"),
    "branches": (document("TensorTree3", [(*TREE[:3], "{{1}{1}}")]), "a node of 2 branches"),
    "mixed": (document("TensorTree3", [(*TREE[:3], "{1 {1}}")]), "numbers and branches"),
    "deep": (document("TensorTree3", [(*TREE[:3], "{" * 100)]), "more than 20 deep"),
    "nothing": (document("TensorTree3", [(*TREE[:3], "")]), "without its last }"),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_damaged_files(name, tmp_path):
    text, message = DAMAGE[name]
    path = tmp_path / "bad.xml"
    path.write_text(text)
    refused(path, message)
