"""Geometric optics knows no scale and no place: neither does a tile, but for its size and origin."""

import numpy as np
import pytest
import trimesh

from microgeometry.surfaces import SURFACES
from microgeometry.tile import HeightField

# Keys of each kind, and which of them are lengths.
KINDS = {
    "flat": [({}, {"size": 2})],
    "gaussian": [
        ({"alpha": 0.5, "samples": 128}, {"correlation_length": 1.5}),
        ({"samples": 64}, {"rms_height": 0.2, "correlation_length": [1.5, 4], "size": 16}),
    ],
    "exponential": [
        ({"alpha": 0.5, "samples": 128}, {"correlation_length": 1.5}),
        ({"samples": 64}, {"rms_height": 0.2, "correlation_length": [1.5, 4], "size": 16}),
    ],
    "self_affine": [
        (
            {"hurst": 0.7, "samples": 64},
            {"rms_height": 0.2, "rolloff_length": [1, 3], "cutoff_length": 0.5, "size": 6},
        )
    ],
    "ndf": [({"distribution": "ggx", "alpha": 0.3}, {"size": 0.7})],
    "v_groove": [
        ({"slope_deg": 85}, {"size": 0.7}),
        ({"distribution": "oren_nayar", "slope_std_deg": 20}, {"size": 0.7}),
    ],
    "pits": [({"cover": 0.4, "arrangement": "random", "segments": 16}, {"radius": 3})],
    "bosses": [({"cover": 0.4, "depth": 0.5, "segments": 16}, {"radius": 3})],
    "pyramids": [({"slope_deg": 50}, {"size": 3}), ({"slope_deg": 50, "arrangement": "random"}, {"size": 3})],
    "fibres": [
        ({}, {"radius": 3}),
        ({"pitch": 2}, {"radius": 3}),
        ({"weave": "plain", "segments": 16}, {"radius": 3}),
    ],
    "spheres": [
        ({"cover": 0.4, "subdivisions": 1}, {"radius": 3}),
        ({"arrangement": "packed", "subdivisions": 1}, {"radius": 3}),
    ],
    "heightmap": [
        ({"file": "map.npy", "holes": "fill", "tiling": tiling}, {"size": [3, 2]})
        for tiling in ("mirror", "window", "repeat")
    ],
    "mesh": [({"file": "mesh.obj", "tiling": tiling}, {}) for tiling in ("repeat", "mirror")],
}

CASES = [(kind, *case) for kind, cases in KINDS.items() for case in cases]


def write_files(folder, scale=1.0, shift=0.0):
    """Write a height map with holes, and a mesh with an overhang over 3 x 2, times a scale and shifted."""
    heights = np.random.default_rng(1).normal(size=(12, 8))
    heights[3:5, 4] = np.nan
    np.save(folder / "map.npy", scale * (heights + shift))
    plane = trimesh.Trimesh([(0, 0, 0), (3, 0, 0), (3, 2, 0), (0, 2, 0)], [(0, 1, 2), (0, 2, 3)])
    ball = trimesh.creation.icosphere(2, radius=0.5).apply_translation((1.2, 0.8, 0.7))
    both = trimesh.util.concatenate([plane, ball])
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in (scale * (both.vertices + shift)).tolist()]
    lines += ["f {} {} {}".format(*face) for face in (both.faces + 1).tolist()]
    (folder / "mesh.obj").write_text("\n".join(lines))


def assert_same_shape(tile, reference, tolerance):
    """Equal in units of the size, about its origin."""
    np.testing.assert_allclose(
        np.divide(tile.size, tile.size[0]), np.divide(reference.size, reference.size[0]), rtol=tolerance
    )
    if isinstance(reference, HeightField):
        heights, others = (field.heights / field.size[0] for field in (tile, reference))
    else:
        np.testing.assert_array_equal(tile.faces, reference.faces)
        assert (tile.labels is None) == (reference.labels is None)
        if tile.labels is not None:
            np.testing.assert_array_equal(tile.labels, reference.labels)
        heights, others = (
            (mesh.vertices - (*mesh.origin, mesh.vertices[0, 2])) / mesh.size[0] for mesh in (tile, reference)
        )
    assert np.ptp(others) > 0 or not others.any()
    np.testing.assert_allclose(heights, others, atol=tolerance * max(1.0, np.abs(others).max()))


def test_all_kinds_are_here():
    assert KINDS.keys() == SURFACES.keys()


@pytest.mark.parametrize(
    ("small", "large", "factor"), [("nm", "m", 1e9), ("um", "m", 1e6), ("um", "mm", 1e3)]
)
@pytest.mark.parametrize(("kind", "keys", "lengths"), CASES)
def test_units(tile_of, tmp_path, kind, keys, lengths, small, large, factor):
    write_files(tmp_path)
    one, other = (tile_of(kind, 5, **keys, **lengths, units=units) for units in (small, large))
    assert other.size[0] / one.size[0] == pytest.approx(factor, rel=1e-12)
    assert_same_shape(other, one, 1e-12)
    for name, value in vars(one.statistics()).items():
        length = factor if name in LENGTHS else 1.0
        assert getattr(other.statistics(), name) == pytest.approx(length * value, rel=1e-9, abs=1e-300), name


LENGTHS = {"rms_height", "peak_to_valley", "correlation_length_x", "correlation_length_y"}


@pytest.mark.parametrize("factor", [1e-9, 1e6])
@pytest.mark.parametrize(("kind", "keys", "lengths"), CASES)
def test_numbers(tile_of, tmp_path, kind, keys, lengths, factor):
    write_files(tmp_path)
    one = tile_of(kind, 5, **keys, **lengths, units="mm")
    write_files(tmp_path, factor)
    scaled = {
        name: [factor * x for x in value] if isinstance(value, list) else factor * value
        for name, value in lengths.items()
    }
    other = tile_of(kind, 5, **keys, **scaled, units="mm")
    # What the numbers are rounded to, not what the surface does with them, is up to 1e-15.
    if lengths or kind == "mesh":
        assert other.size[0] / one.size[0] == pytest.approx(factor, rel=1e-12)
    assert_same_shape(other, one, 1e-12)


@pytest.mark.parametrize(
    ("kind", "keys", "lengths"), [case for case in CASES if case[0] in ("mesh", "heightmap")]
)
def test_shift(tile_of, tmp_path, kind, keys, lengths):
    # In the file, at 1e6 periods from the origin, only 1e-10 of a period is left to tell.
    write_files(tmp_path)
    one = tile_of(kind, 5, **keys, **lengths, units="mm")
    write_files(tmp_path, shift=1e6)
    assert_same_shape(tile_of(kind, 5, **keys, **lengths, units="mm"), one, 1e-9)
