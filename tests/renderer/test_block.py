"""The block of a picture: closed over its area whatever the surface, and solid where the surface is."""

import numpy as np
import pytest

from microgeometry.specimen import parse_specimen
from microgeometry.surfaces import SURFACES
from microgeometry.tile import HeightField, TriangleMesh
from renderer.block import cut_block

# One of each kind; mesh and heightmap from files
SPECIMENS = {
    "flat": {},
    "gaussian": {"alpha": 0.5, "samples": 128},
    "exponential": {"alpha": 0.5, "samples": 128},
    "self_affine": {"hurst": 0.8, "alpha": 0.5, "samples": 64},
    "ndf": {"distribution": "ggx", "alpha": 0.3},
    "v_groove": {"slope_deg": 30, "slope_std_deg": 10},
    "pits": {"cover": 0.4, "arrangement": "random", "segments": 24},
    "bosses": {"cover": 0.6, "depth": 0.5, "segments": 24},
    "pyramids": {"slope_deg": 54.7, "arrangement": "random"},
    "fibres": {"segments": 16},
    "spheres": {"cover": 0.4, "arrangement": "random", "subdivisions": 2},
    "heightmap": {"file": "map.npy", "units": "um", "size": [4, 6]},
    "mesh": {"file": "bar.obj"},
}

# A bar along y, 0.5 wide and 0.5 high, over a plane from which it stands off by 0.25; period 1 x 1
BAR = np.array(
    [[x, y, z] for y in (0, 1) for x, z in ((0.25, 0.25), (0.75, 0.25), (0.75, 0.75), (0.25, 0.75))]
)
PLANE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
# the plane's two, then two to each side of the bar, corners i and i + 1 (mod 4) at y = 0 and 4 more at y = 1
FACES = np.array(
    [
        [8, 9, 10], [8, 10, 11],
        [0, 5, 1], [0, 4, 5], [1, 6, 2], [1, 5, 6], [2, 7, 3], [2, 6, 7], [3, 4, 0], [3, 7, 4],
    ]
)  # fmt: skip


def bar():
    return TriangleMesh(np.concatenate([BAR, PLANE]), FACES, (0.0, 0.0), (1.0, 1.0))


def areas(triangles):
    """Area vectors of triangles, shape (F, 3)."""
    vertices, faces = triangles
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return 0.5 * np.cross(b - a, c - a)


@pytest.mark.parametrize("kind", SURFACES)
def test_every_kind_of_surface_is_closed_over_its_block(kind, tmp_path):
    np.save(tmp_path / "map.npy", np.random.default_rng(1).normal(size=(20, 30)))
    text = [f"v {x} {y} {z}" for x, y, z in np.concatenate([BAR, PLANE])]
    text += [f"f {a} {b} {c}" for a, b, c in FACES + 1]
    (tmp_path / "bar.obj").write_text("\n".join(text))
    specimen = parse_specimen(
        {"surface": {"kind": kind, **SPECIMENS[kind]}, "material": {"kind": "mirror"}}, tmp_path
    )
    tile = specimen.surface.realise(0)
    block = cut_block(tile)
    assert max(block.size) == 1
    # what faces up less what faces down covers the block exactly once
    covered = sum(areas(top)[:, 2].sum() for top in block.tops.values())
    assert covered == pytest.approx(block.size[0] * block.size[1], rel=1e-6)
    vertices = np.concatenate([vertices for vertices, _ in (*block.tops.values(), block.sides)])
    assert vertices[:, :2].min() > -1e-9
    assert np.all(vertices[:, :2].max(axis=0) < np.array(block.size) + 1e-9)
    assert vertices[:, 2].min() == pytest.approx(block.base)
    assert vertices[:, 2].max() == pytest.approx(block.top)
    # true vertical scale
    if all(np.array(tile.size) <= 1.01 * np.array(block.size) * block.unit):
        height = tile.statistics().peak_to_valley
        low = min(v[f.ravel(), 2].min() for v, f in block.tops.values())
        assert (block.top - low) * block.unit == pytest.approx(height, rel=1e-6, abs=1e-15)


def test_a_groove_is_cut_into_six_whole_periods_and_hills_into_a_part():
    groove = parse_specimen(
        {"surface": {"kind": "v_groove", "slope_deg": 45, "size": 2.0}, "material": {"kind": "mirror"}}
    )
    block = cut_block(groove.surface.realise(0))
    assert np.array(block.size) * block.unit == pytest.approx([12e-6, 12e-6])
    hills = parse_specimen({"surface": {"kind": "gaussian", "alpha": 0.5}, "material": {"kind": "mirror"}})
    block = cut_block(hills.surface.realise(0))
    # 3.91 correlation lengths from hill to hill by height over slope, give or take the realisation
    assert block.unit == pytest.approx(6 * 3.91e-6, rel=0.1)


def test_the_cut_of_a_groove_is_a_saw():
    """Area of the cut across a groove: half the profile's height, on the slab below it."""
    groove = parse_specimen(
        {"surface": {"kind": "v_groove", "slope_deg": 45}, "material": {"kind": "mirror"}}
    )
    block = cut_block(groove.surface.realise(0))
    low = block.top - 0.5 / 6  # six grooves to the unit, as deep as half as wide
    faces = areas(block.sides)
    across = np.abs(faces[:, 1]).sum() / 2  # at both ends
    assert across == pytest.approx(0.5 * (block.top - low) + low - block.base, rel=1e-4)


def test_the_cut_leaves_the_air_below_an_overhang():
    block = cut_block(bar(), (1.0, 1.0))
    across = np.abs(areas(block.sides)[:, 1]).sum() / 2
    slab = -0.5 * 0.75 - block.base  # the block is centred in height
    assert across == pytest.approx(slab + 0.25, rel=1e-6)
    # along the bar at x = 0 there is the slab alone
    assert np.abs(areas(block.sides)[:, 0]).sum() / 2 == pytest.approx(slab, rel=1e-6)
    inside_air = block.sides[0][:, 2] < -0.375 + 0.24
    assert np.all(block.sides[0][inside_air, 2] <= -0.375 + 1e-6)


def test_part_of_a_mesh_is_cut_and_copied():
    block = cut_block(bar(), (2.5, 1.5))
    assert block.unit == 2.5
    assert block.size == pytest.approx((1.0, 0.6))
    up = areas(block.tops[0])[:, 2]
    # planes and bars' tops: 2.5 x 1.5, and 1.25 x 1.5 (in 2.5 units of width there are 2 bars and a half)
    assert up[up > 0].sum() * 2.5**2 == pytest.approx(2.5 * 1.5 + 1.25 * 1.5)


def test_labels_part_the_surface():
    pits = parse_specimen({"surface": {"kind": "pits", "cover": 0.6}, "material": {"kind": "mirror"}})
    block = cut_block(pits.surface.realise(0))
    assert set(block.tops) == {0, 1}
    flat = areas(block.tops[1])
    assert np.all(flat[:, :2] == 0)
    assert flat[:, 2].sum() == pytest.approx(0.4 * block.size[0] * block.size[1], rel=5e-3)


def test_a_large_height_field_is_thinned_out():
    heights = np.tile(np.sin(np.arange(3000) * 2 * np.pi / 500), (7, 1)).T * 1e-4
    block = cut_block(HeightField(heights, (1.0, 7 / 3000)), (1.0, 7 / 3000))
    vertices, _ = block.tops[0]
    assert len(np.unique(vertices[:, 0])) == 1001
    assert vertices[:, 0].max() == pytest.approx(1.0)
    expected = np.sin(vertices[:, 0] * 6 * 2 * np.pi) * 1e-4
    assert vertices[:, 2] == pytest.approx(expected, abs=1e-12)
