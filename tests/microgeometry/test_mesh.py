import numpy as np
import pytest
import trimesh

from microgeometry.errors import InputError

# A tent of four faces over 3 x 2, its top off centre, plus a flat border to one side: no axis, sign or
# order can be swapped unseen. z up, faces counter-clockwise from above, far from the origin.
SHIFT = np.array([100.0, -50.0, 7.0])
TENT = [(0, 0, 0), (3, 0, 0), (3, 2, 0), (0, 2, 0), (1, 0.5, 0.75), (4, 0, 0), (4, 2, 0)]
VERTICES = np.array(TENT) + SHIFT
FACES = np.array([(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4), (1, 5, 6), (1, 6, 2)])


def write(folder, name, vertices=VERTICES, faces=FACES):
    trimesh.Trimesh(vertices, faces, process=False).export(folder / name)
    return {"file": name}


def assert_is_the_tent(tile, scale=1e-6):
    assert tile.origin == (0.0, 0.0)
    assert tile.size == pytest.approx((4 * scale, 2 * scale), rel=1e-6)
    top = tile.vertices[tile.vertices[:, 2].argmax()]
    np.testing.assert_allclose(top / scale, (1, 0.5, 7.75), rtol=1e-5)
    np.testing.assert_allclose(tile.vertices[:, 2].min() / scale, 7, rtol=1e-6)
    # Each face, found by its normal: slopes 0.75 over distances 0.5, 2, 1.5 and 1 from the top to the edges.
    normals, areas = tile.facets()
    expected = np.array([(0, -1.5, 1), (0.375, 0, 1), (0, 0.5, 1), (-0.75, 0, 1), (0, 0, 1), (0, 0, 1)])
    expected /= np.linalg.norm(expected, axis=1)[:, None]
    # STL and PLY readers may reorder the faces.
    np.testing.assert_allclose(np.sort(normals @ (1, 10, 100)), np.sort(expected @ (1, 10, 100)), rtol=1e-5)
    np.testing.assert_allclose(areas @ normals, (0, 0, 8 * scale**2), atol=1e-4 * scale**2)


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "glb", "gltf"])
def test_round_trip(tile_of, tmp_path, suffix):
    if suffix == "gltf":
        for name, data in trimesh.exchange.gltf.export_gltf(trimesh.Trimesh(VERTICES, FACES).scene()).items():
            (tmp_path / (name if name != "model.gltf" else "tent.gltf")).write_bytes(data)
    else:
        write(tmp_path, f"tent.{suffix}")
    assert_is_the_tent(tile_of("mesh", file=f"tent.{suffix}", up="z"))


@pytest.mark.parametrize("suffix", ["glb", "obj"])
def test_y_up(tile_of, tmp_path, suffix):
    # What is (x, y, z) with z up is (x, z, -y) with y up: turned by -90 degrees about x.
    keys = write(tmp_path, f"tent.{suffix}", VERTICES[:, [0, 2, 1]] * (1, 1, -1))
    up = {} if suffix == "glb" else {"up": "y"}  # glTF defines y as up
    assert_is_the_tent(tile_of("mesh", **keys, **up))


def test_a_scene_is_merged_with_its_transforms(tile_of, tmp_path):
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.Trimesh(VERTICES[:5], FACES[:4]))
    border = trimesh.Trimesh(VERTICES - (0, 0, 2), FACES[4:])
    scene.add_geometry(border, transform=trimesh.transformations.translation_matrix((0, 0, 2)))
    scene.export(tmp_path / "tent.glb")
    assert_is_the_tent(tile_of("mesh", file="tent.glb", up="z"))


def test_polygons_are_split(tile_of, tmp_path):
    (tmp_path / "quad.obj").write_text("v 0 0 0\nv 2 0 0\nv 2 1 1\nv 0 1 1\nf 1 2 3 4\n")
    stats = tile_of("mesh", file="quad.obj").statistics()
    assert stats.n_facets == 2
    assert stats.alpha == pytest.approx(1.0)


@pytest.mark.parametrize(("units", "metre"), [("m", 1.0), ("mm", 1e-3), ("um", 1e-6), ("nm", 1e-9)])
def test_units(tile_of, tmp_path, units, metre):
    assert_is_the_tent(tile_of("mesh", **write(tmp_path, "tent.ply"), units=units), metre)


def test_mirror_tiling_meets_itself(tile_of, tmp_path):
    # A sloping plane does not repeat; with its mirror images it is a roof, and closed.
    keys = write(tmp_path, "slope.ply", [(0.1, 0, 0), (1.1, 0, 0.3), (1.1, 0.7, 0.5), (0.1, 0.7, 0.2)],
                 [(0, 1, 2), (0, 2, 3)])  # fmt: skip
    tile = tile_of("mesh", **keys, tiling="mirror")
    single = tile_of("mesh", **keys)
    assert tile.size == pytest.approx((2e-6, 1.4e-6))
    assert len(tile.faces) == 4 * len(single.faces)
    assert (tile.facets()[0][:, 2] > 0).all()
    np.testing.assert_allclose(tile.facets()[1] @ tile.facets()[0], (0, 0, 2.8e-12), atol=1e-24)
    assert tile.statistics().alpha == pytest.approx(single.statistics().alpha)
    # Opposite sides of the period carry the same points, bit for bit ...
    for axis in (0, 1):
        others = [1 - axis, 2]
        ends = (0.0, tile.size[axis])
        low, high = (tile.vertices[tile.vertices[:, axis] == end][:, others] for end in ends)
        assert set(map(tuple, low)) == set(map(tuple, high)) != set()
    # ... and with them identified every edge, known by its midpoint, has two faces.
    corners = tile.vertices[tile.faces]
    midpoints = 0.5 * np.concatenate([corners[:, a] + corners[:, b] for a, b in ((0, 1), (1, 2), (2, 0))])
    midpoints[:, :2] /= tile.size
    keys = np.round(np.column_stack((midpoints[:, :2] % 1.0, midpoints[:, 2] * 1e6)), 9)
    assert (np.unique(keys, axis=0, return_counts=True)[1] == 2).all()


def test_degenerate_faces_and_loose_vertices_are_dropped(specimen_of, tmp_path):
    vertices = np.vstack((VERTICES, SHIFT + 900))
    faces = np.vstack((FACES, [(0, 0, 1), (0, 1, 5)]))  # a point twice; three in a line
    surface = specimen_of("mesh", **write(tmp_path, "tent.ply", vertices, faces)).surface
    assert_is_the_tent(surface.realise(0))
    assert surface.n_degenerate == 2
    # A skinny triangle is not degenerate.
    skinny = [(0, 0, 0), (1, 0, 0), (0.5, 1e-6, 0), (0, 1, 0)]
    surface = specimen_of("mesh", **write(tmp_path, "s.ply", skinny, [(0, 1, 2), (0, 1, 3)])).surface
    assert surface.n_degenerate == 0


@pytest.mark.parametrize("tiling", ["repeat", "mirror"])
@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "glb"])
def test_overhangs_and_walls(tile_of, tmp_path, suffix, tiling):
    # A table: its top, a box of 2 x 1 x 0.25 whose underside is 1 above the floor of 4 x 3, floats free.
    floor = trimesh.Trimesh([(0, 0, 0), (4, 0, 0), (4, 3, 0), (0, 3, 0)], [(0, 1, 2), (0, 2, 3)])
    top = trimesh.creation.box((2, 1, 0.25)).apply_translation((2.5, 1.25, 1.125))
    trimesh.util.concatenate([floor, top]).export(tmp_path / f"table.{suffix}")
    tile = tile_of("mesh", file=f"table.{suffix}", up="z", tiling=tiling)
    copies = 4 if tiling == "mirror" else 1
    assert tile.size == pytest.approx(np.array((4e-6, 3e-6)) * copies**0.5, rel=1e-6)
    normals, areas = tile.facets()
    down, up = normals[:, 2] < -0.5, normals[:, 2] > 0.5
    walls = ~(down | up)
    for side, area, height in ((down, 2, 1e-6), (up, 12 + 2, None), (walls, 6 * 0.25, None)):
        assert areas[side].sum() == pytest.approx(copies * area * 1e-12, rel=1e-5)
        if height is not None:
            np.testing.assert_allclose(tile.vertices[tile.faces[side], 2], height, rtol=1e-5)
    stats = tile.statistics()
    # Undersides and walls have no slope that is seen from above.
    assert stats.alpha == pytest.approx(0, abs=1e-5)
    assert stats.area_ratio == pytest.approx((12 + 2 + 2 + 1.5) / 12, rel=1e-5)
    assert stats.peak_to_valley == pytest.approx(1.25e-6, rel=1e-5)


@pytest.mark.parametrize("height", [1e-3, 1e-6, 1e-9])
def test_skinny_triangles_keep_their_normal(tile_of, tmp_path, height):
    # Two slopes of 45 degrees, a sliver between them: of length 1 and of `height` along y, tilted as they are.
    (tmp_path / "s.obj").write_text(
        f"v 0 0 0\nv 1 0 0\nv 1 1 1\nv 0 1 1\nv 0.5 {1 - height!r} {1 - height!r}\n"
        "f 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n"
    )
    tile = tile_of("mesh", file="s.obj", units="m")
    normals, areas = tile.facets()
    assert len(areas) == 4
    np.testing.assert_allclose(normals, np.tile((0, -(0.5**0.5), 0.5**0.5), (4, 1)), atol=1e-6)
    assert areas.min() == pytest.approx(height / 2**0.5, rel=1e-6)


def test_the_file_is_read_once(specimen_of, tmp_path):
    surface = specimen_of("mesh", **write(tmp_path, "tent.ply")).surface
    first = surface.realise(0)
    (tmp_path / "tent.ply").unlink()
    assert surface.realise(1) is first


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.obj", b"", "empty: 0 vertices"),
        ("a.stl", b"junk" * 30, "empty|cannot be read"),
        ("a.glb", b"junk", "cannot be read .incorrect header"),
        ("a.obj", b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "1 of 3 vertices are NaN"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "cannot be read"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "all 1 triangles are degenerate"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n", "1 x 0 in the plane"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 3 2 1\n", "no triangle faces up"),
        ("a.step", b"", "format .step is not read; allowed are .obj, .ply, .stl, .glb"),
    ],
)
def test_bad_files(tile_of, tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        tile_of("mesh", file=name)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"file": "none.obj"}, "there is no file"),
        ({}, "file: missing"),
        ({"file": ""}, "not empty"),
        ({"file": "tent.ply", "up": "x"}, "must be one of 'z', 'y'"),
        ({"file": "tent.ply", "tiling": "mirrored"}, "did you mean 'mirror'"),
        ({"file": "tent.ply", "unit": "um"}, "did you mean 'units'"),
    ],
)
def test_bad_keys(specimen_of, tmp_path, keys, message):
    write(tmp_path, "tent.ply")
    with pytest.raises(InputError, match=message):
        specimen_of("mesh", **keys)
