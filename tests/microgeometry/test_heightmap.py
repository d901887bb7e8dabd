import functools
import zipfile

import numpy as np
import pytest

from microgeometry.errors import InputError
from microgeometry.surfaces import heightmap

# 5 x 4 samples, asymmetric in everything. A .npy is read with x as its first index.
MAP = np.random.default_rng(5).normal(size=(5, 4))


def write_map(folder, heights, name="map.npy"):
    np.save(folder / name, np.asarray(heights, dtype=np.float64))
    return {"file": name, "units": "um"}


def test_mirror_is_even_and_repeats_no_sample(tile_of, tmp_path):
    keys = write_map(tmp_path, MAP)
    tile = tile_of("heightmap", **keys, size=[5.0, 2.0], level="none")
    assert tile.heights.shape == (2 * 5 - 2, 2 * 4 - 2)
    np.testing.assert_allclose(tile.heights[:5, :4], (MAP - MAP.mean()) * 1e-6, atol=1e-21)
    # h(-x) = h(x) about sample 0, and about sample n-1, on the periodic grid.
    i, j = np.arange(8), np.arange(6)
    np.testing.assert_array_equal(tile.heights, tile.heights[-i % 8])
    np.testing.assert_array_equal(tile.heights, tile.heights[:, -j % 6])
    # Steps stay: 1 um along x and 0.5 um along y (pixels need not be square).
    assert tile.size == pytest.approx((8e-6, 3e-6))


def test_repeat_is_the_map_itself(tile_of, tmp_path):
    keys = write_map(tmp_path, MAP)
    tile = tile_of("heightmap", **keys, size=[5.0, 2.0], level="none", tiling="repeat")
    np.testing.assert_allclose(tile.heights, (MAP - MAP.mean()) * 1e-6, atol=1e-21)
    assert tile.size == pytest.approx((5e-6, 2e-6))


def test_window_brings_the_edges_down_to_the_mean(tile_of, tmp_path):
    # 40 x 20 samples: the outer 4 and 2 on each side by sin^2(pi/2 i/4) and sin^2(pi/2 i/2), the rest untouched.
    heights = np.random.default_rng(6).normal(size=(40, 20)) + 3
    keys = {**write_map(tmp_path, heights), "size": [4, 2], "level": "none"}
    tile = tile_of("heightmap", **keys, tiling="window")
    assert tile.size == pytest.approx((4e-6, 2e-6))
    ratio = tile.heights / ((heights - heights.mean()) * 1e-6)
    rise = np.sin(np.pi / 2 * np.arange(5) / 4) ** 2
    np.testing.assert_allclose(ratio[:5, 10], rise, atol=1e-12)
    np.testing.assert_allclose(ratio[:35:-1, 10], rise[1:], atol=1e-12)
    np.testing.assert_allclose(ratio[20, [0, 1, 2, -2, -1]], [0, 0.5, 1, 1, 0.5], atol=1e-12)
    np.testing.assert_allclose(ratio[4:37, 2:19], 1, rtol=1e-9)


@pytest.mark.parametrize(("level", "degree"), [("none", 0), ("plane", 1), ("curvature", 2)])
def test_levelling_takes_out_what_it_says(tile_of, tmp_path, level, degree):
    x, y = np.meshgrid(np.arange(5), np.arange(4), indexing="ij")
    forms = [(0, 7.0 + 0 * x), (1, 3 * x - 2 * y), (2, x * y), (2, x**2 + 2 * y**2), (3, x * y**2)]
    keys = write_map(tmp_path, MAP)
    plain = tile_of("heightmap", **keys, size=[5, 4], level=level)
    for order, form in forms:
        keys = write_map(tmp_path, MAP + form, "form.npy")
        formed = tile_of("heightmap", **keys, size=[5, 4], level=level)
        same = np.allclose(formed.heights, plain.heights, atol=1e-18)
        assert same is (order <= degree)


def test_holes_are_refused_and_counted(tile_of, tmp_path):
    heights = MAP.copy()
    heights[1, 2] = heights[4, 0] = np.nan
    keys = write_map(tmp_path, heights)
    with pytest.raises(InputError, match=r"2 of 20 samples \(10 %\) were not measured; set holes = "):
        tile_of("heightmap", **keys, size=[1, 1])


def test_holes_are_filled_by_the_harmonic_surface(specimen_of, tmp_path):
    # h = 5 x^2 - 5 y^2 + x y + 2 x solves Laplace's equation, and its five-point form exactly, for any
    # pixel (differences of a quadratic are exact): a hole of any shape inside must come back as it was.
    x, y = np.meshgrid(np.arange(12) * 0.5, np.arange(9) * 2.0, indexing="ij")
    true = 5 * x**2 - 5 * y**2 + x * y + 2 * x
    heights = true.copy()
    heights[2:7, 3:5] = heights[7, 4] = heights[9, 7] = np.nan
    keys = {**write_map(tmp_path, heights), "size": [6, 18], "tiling": "repeat", "level": "none"}
    surface = specimen_of("heightmap", **keys, holes="fill").surface
    tile = surface.realise(0)
    np.testing.assert_allclose(np.diff(tile.heights, axis=0), np.diff(true, axis=0) * 1e-6, atol=1e-16)
    assert surface.n_holes == 12
    assert np.ptp(tile.heights - true * 1e-6) < 1e-15


def test_hole_at_the_edge_is_filled_within_its_rim(tile_of, tmp_path):
    # No slope is known beyond the edge: the fill stays between the lowest and highest height around it.
    heights = MAP.copy()
    heights[0, 0:2] = np.nan
    keys = {**write_map(tmp_path, heights), "size": [1, 1], "level": "none", "tiling": "repeat"}
    tile = tile_of("heightmap", **keys, holes="fill")
    rim = tile.heights[[1, 1, 0], [0, 1, 2]]
    assert (tile.heights[0, 0:2] >= rim.min()).all()
    assert (tile.heights[0, 0:2] <= rim.max()).all()
    # The corner has two neighbours: the one measured at (1, 0) and the filled one at (0, 1).
    assert tile.heights[0, 0] != tile.heights[0, 1]


def test_more_hole_than_map(tile_of, tmp_path):
    keys = write_map(tmp_path, np.where(np.arange(20).reshape(5, 4) < 11, np.nan, 1.0))
    with pytest.raises(InputError, match="more than half"):
        tile_of("heightmap", **keys, size=[1, 1], holes="fill")


@pytest.fixture
def x3p(tmp_path):
    """Write MAP (in metres, steps 1 and 2 um) as a real x3p."""
    from SurfaceTopography import Topography

    path = tmp_path / "map.x3p"
    Topography(MAP * 1e-6, physical_sizes=(5e-6, 8e-6), unit="m").to_x3p(str(path))
    return path


def test_units_and_size_come_from_the_file(tile_of, x3p):
    tile = tile_of("heightmap", file="map.x3p", level="none", tiling="repeat")
    np.testing.assert_allclose(tile.heights, (MAP - MAP.mean()) * 1e-6, atol=1e-18)
    assert tile.size == pytest.approx((5e-6, 8e-6))


def test_keys_override_the_file(tile_of, x3p):
    # The file's numbers, 5e-6 and 8e-6, are read as millimetres.
    tile = tile_of("heightmap", file="map.x3p", tiling="repeat", units="mm")
    assert tile.size == pytest.approx((5e-9, 8e-9))
    assert tile_of("heightmap", file="map.x3p", tiling="repeat", units="mm", size=[1, 2]).size == (1e-3, 2e-3)


def test_x3p_packed_in_a_folder_with_an_empty_offset(tile_of, x3p, tmp_path):
    with zipfile.ZipFile(x3p) as good, zipfile.ZipFile(tmp_path / "odd.x3p", "w") as odd:
        for name in good.namelist():
            data = good.read(name)
            if name == "main.xml":
                assert b"</CZ>" in data
                data = data.replace(b"</CZ>", b"<Offset/></CZ>")
            odd.writestr(f"scan/{name}", data)
            odd.writestr(f"__MACOSX/scan/._{name}", b"junk")
    good_tile, odd_tile = tile_of("heightmap", file="map.x3p"), tile_of("heightmap", file="odd.x3p")
    np.testing.assert_array_equal(odd_tile.heights, good_tile.heights)


def test_the_file_is_read_once(specimen_of, x3p):
    surface = specimen_of("heightmap", file="map.x3p").surface
    first = surface.realise(0)
    x3p.unlink()
    assert surface.realise(1) is first
    assert not surface.is_random


@pytest.mark.parametrize(
    ("content", "keys", "message"),
    [
        (MAP, {"units": "um"}, "states no lateral size; add size"),
        (MAP, {}, "states no unit; add units"),
        (MAP, {"size": [1, 1]}, "needs units"),
        (MAP, {"size": [1, 1, 1], "units": "um"}, r"must be \[Lx, Ly\]"),
        (MAP, {"size": [1, 0], "units": "um"}, "above 0"),
        (MAP[:1], {"units": "um", "size": [1, 1]}, "2 x 2"),
        (b"", {}, "junk.npy: "),
        (b"neither heights nor a map" * 9, {}, "not a height map in a format"),
        (MAP, {"level": "plain"}, "did you mean 'plane'"),
        (MAP, {"holes": True}, "must be one of 'refuse', 'fill'"),
        (MAP, {"tiling": "tile"}, "must be one of 'mirror', 'window', 'repeat'"),
        (MAP, {"alpha": 0.5}, "alpha = 0.5: unknown key"),
    ],
)
def test_bad_maps_and_keys(tile_of, tmp_path, content, keys, message):
    path = tmp_path / "junk.npy"
    path.write_bytes(content) if isinstance(content, bytes) else np.save(path, content)
    with pytest.raises(InputError, match=message) as caught:
        tile_of("heightmap", file="junk.npy", **keys)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400 + len(str(path))


def test_truncated_file(tile_of, x3p):
    x3p.write_bytes(x3p.read_bytes()[:700])
    with pytest.raises(InputError, match=r"map\.x3p: ") as caught:
        tile_of("heightmap", file="map.x3p")
    assert "\n" not in str(caught.value)


def test_missing_file(specimen_of):
    with pytest.raises(InputError, match=r"\[surface\] file = 'none.x3p': there is no file"):
        specimen_of("heightmap", file="none.x3p")


@pytest.mark.parametrize(
    ("name", "shape", "sq", "sdq", "n_holes"),
    [
        # Sq and Sdq as published with the collection, to their digits; n of the file.
        ("matrix-2.txt", (650, 650), (0.276e-6, 0.0005e-6), (0.35, 0.005), 0),
        ("x3p-2.x3p", (650, 650), (0.077e-6, 0.0005e-6), (0.062, 0.0005), 0),
        ("opd-1.opd", (640, 480), (6.7e-9, 0.15e-9), None, 116),
        ("metropro-1.dat", (640, 480), (13e-9, 0.5e-9), None, 0),
        # Scanned bullet land, in a folder inside its archive: 2.58 um pixels, 25 292 of them NaN.
        ("sample-land.x3p", (918, 256), None, None, 25292),
    ],
)
def test_real_maps(specimen_of, topography_dir, name, shape, sq, sdq, n_holes):
    surface = specimen_of("heightmap", folder=topography_dir, file=name, holes="fill").surface
    tile = surface.realise(0)
    assert surface.n_holes == n_holes
    assert tile.heights.shape == (2 * shape[0] - 2, 2 * shape[1] - 2)
    original = tile.heights[: shape[0], : shape[1]]
    if sq is not None:
        assert original.std() == pytest.approx(sq[0], abs=sq[1])
    if sdq is not None:
        assert tile.statistics().alpha == pytest.approx(sdq[0], abs=sdq[1])
    if name == "sample-land.x3p":
        assert tile.size == pytest.approx((2.58e-6 * 1834, 2.58e-6 * 510))


REAL = ["matrix-2.txt", "x3p-2.x3p", "opd-1.opd", "metropro-1.dat", "sample-land.x3p"]


@pytest.mark.parametrize("name", REAL)
def test_keys_on_real_maps(specimen_of, topography_dir, monkeypatch, name):
    monkeypatch.setattr(heightmap, "_read", functools.cache(heightmap._read))  # seconds for a text matrix

    def tile(**keys):
        return specimen_of(
            "heightmap", folder=topography_dir, file=name, holes="fill", **keys
        ).surface.realise(0)

    repeat, mirror, window = (tile(tiling=tiling) for tiling in ("repeat", "mirror", "window"))
    shape = np.array(repeat.heights.shape)
    # Level: nothing of the form that was to be taken out is left in the map (holes filled later apart).
    form = {"none": 0, "plane": 1, "curvature": 2}
    levelled = {level: tile(level=level, tiling="repeat") for level in form}
    rms = [field.statistics().rms_height for field in levelled.values()]
    assert rms[2] < rms[1] < rms[0]
    x, y = np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")
    if name != "sample-land.x3p":  # 11 % filled
        for level, degree in form.items():
            heights = levelled[level].heights
            for term in [x**a * y**b for a in range(degree + 1) for b in range(degree + 1 - a)]:
                assert abs(np.mean(heights * term)) < 1e-3 * heights.std()
    # Tiling: nowhere is the step across the seam larger than the largest inside the map; as it stands, it is.
    assert (mirror.heights.shape == 2 * shape - 2).all()
    np.testing.assert_array_equal(mirror.heights[: shape[0], : shape[1]], repeat.heights)
    assert window.size == repeat.size
    middle = tuple(slice(n // 8, -n // 8) for n in shape)
    np.testing.assert_allclose(window.heights[middle], repeat.heights[middle], rtol=1e-12)
    for axis in (0, 1):
        largest = np.abs(np.diff(repeat.heights, axis=axis)).max()
        for closed in (mirror, window):
            ends = np.take(closed.heights, [-1, 0], axis=axis)
            assert np.abs(np.diff(ends, axis=axis)).max() <= largest
        assert not np.take(window.heights, 0, axis=axis).any()
    assert window.statistics().alpha < 1.02 * mirror.statistics().alpha < 1.04 * repeat.statistics().alpha
    # Units and size: the file's numbers, read as metres, are the same shape; as micrometres, of the size given.
    assert tile(units="m").statistics().alpha == pytest.approx(mirror.statistics().alpha, rel=1e-9)
    wide = tile(units="um", size=[3e6 * length for length in repeat.size], tiling="repeat")
    assert wide.size == pytest.approx(3 * np.array(repeat.size))
    np.testing.assert_allclose(
        wide.heights / wide.heights.std(), repeat.heights / repeat.heights.std(), atol=1e-9
    )


@pytest.mark.parametrize("name", ["opd-1.opd", "sample-land.x3p"])
def test_real_map_with_holes_is_refused_by_default(tile_of, topography_dir, name):
    expected = {"opd-1.opd": "116 of 307200", "sample-land.x3p": "25292 of 235008"}[name]
    with pytest.raises(InputError, match=f'{expected} samples .* were not measured; set holes = "fill"'):
        tile_of("heightmap", file=str(topography_dir / name))
