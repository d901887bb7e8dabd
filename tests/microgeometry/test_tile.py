from dataclasses import fields

import numpy as np
import pytest

from microgeometry.errors import InputError
from microgeometry.tile import HeightField, SurfaceStatistics, TriangleMesh


def as_mesh(field: HeightField) -> TriangleMesh:
    """Write out a height field's triangles, by the documented split, independently of its methods."""
    nx, ny = field.heights.shape
    dx, dy = field.size[0] / nx, field.size[1] / ny
    vertices = [(i * dx, j * dy, field.heights[i % nx, j % ny]) for i in range(nx + 1) for j in range(ny + 1)]
    faces = []
    for i in range(nx):
        for j in range(ny):
            v0, v1, v2, v3 = (a * (ny + 1) + b for a, b in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)))
            faces += [(v0, v1, v3), (v2, v3, v1)]
    return TriangleMesh(np.array(vertices), np.array(faces), (0.0, 0.0), field.size)


@pytest.mark.parametrize("shape", [(4, 7), (2, 1), (1, 3), (1, 1)])
def test_height_field_and_its_own_triangles_agree(shape):
    # Different steps in x and y, steep: a swapped axis or a wrong diagonal shows.
    heights = np.random.default_rng(1).normal(size=shape)
    field = HeightField(heights, (2.0 * shape[0], 0.5 * shape[1]))
    mesh = as_mesh(field)
    assert vars(mesh.statistics()).keys() == {f.name for f in fields(SurfaceStatistics)}
    for name, value in vars(mesh.statistics()).items():
        assert getattr(field.statistics(), name) == pytest.approx(value, rel=1e-12, abs=1e-15), name
    # Facets: the same set; the mesh has them interleaved quad by quad.
    normals, areas = field.facets()
    mesh_normals, mesh_areas = mesh.facets()
    half = len(areas) // 2
    np.testing.assert_allclose(normals[:half], mesh_normals[0::2], atol=1e-14)
    np.testing.assert_allclose(normals[half:], mesh_normals[1::2], atol=1e-14)
    np.testing.assert_allclose(areas[:half], mesh_areas[0::2], rtol=1e-13)
    np.testing.assert_allclose(areas[half:], mesh_areas[1::2], rtol=1e-13)


def test_facets_of_a_height_field_close_the_surface():
    # Over one period the vector areas of a periodic surface sum to that of the plane, (0, 0, Lx Ly).
    field = HeightField(np.random.default_rng(2).normal(size=(8, 5)), (3.0, 2.0))
    normals, areas = field.facets()
    np.testing.assert_allclose(areas @ normals, (0.0, 0.0, 6.0), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=1e-14)


def test_alpha_of_each_axis():
    # A ramp up and down, 3 along x and 1 along y in steps of 1: <hx^2> = 9, <hy^2> = 1.
    x, y = np.meshgrid([0.0, 3.0], [0.0, 1.0], indexing="ij")
    stats = HeightField(x + y, (2.0, 2.0)).statistics()
    assert (stats.alpha_x, stats.alpha_y) == (pytest.approx(18**0.5), pytest.approx(2**0.5))
    assert stats.alpha**2 == pytest.approx((stats.alpha_x**2 + stats.alpha_y**2) / 2)


@pytest.mark.parametrize(("nx", "ny"), [(400, 300), (401, 299)])
def test_correlation_length_of_waves(nx, ny):
    # A wave has the autocorrelation cos(2 pi r / wavelength): 1/e at acos(1/e) / 2 pi = 0.19006 wavelengths,
    # linear over a step of 1/100 of a wavelength to 1e-5 or so. The mean height does not count.
    x, y = np.meshgrid(np.arange(nx) / nx, np.arange(ny) / ny, indexing="ij")
    wave = 5 + np.sin(2 * np.pi * (4 * x + 3 * y) + 0.7)
    stats = HeightField(wave, (8.0, 9.0)).statistics()
    part = np.arccos(1 / np.e) / (2 * np.pi)
    assert stats.correlation_length_x == pytest.approx(2 * part, rel=3e-4)
    assert stats.correlation_length_y == pytest.approx(3 * part, rel=3e-4)


def test_correlation_longer_than_a_period_can_tell():
    groove = HeightField(np.array([[0.0], [-1.0], [2.0], [-1.0]]), (8.0, 3.0)).statistics()
    assert groove.correlation_length_x < 2
    assert groove.correlation_length_y == 1.5
    flat = HeightField(np.full((3, 2), 7.0), (8.0, 3.0)).statistics()
    assert (flat.correlation_length_x, flat.correlation_length_y) == (4.0, 1.5)


def test_statistics_of_a_pyramid_mesh():
    # Square pyramid, base 2 x 2, height 1: every face is inclined by 45 degrees, slope 1 along one axis.
    # <hx^2 + hy^2> = 1; area ratio sqrt(2). Height over the base: h = 1 - max(|x|, |y|), so
    # <h> = 1/3, <h^2> = 1/6, rms = sqrt(1/6 - 1/9) = sqrt(1/18).
    corners = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), (0, 0, 1)]
    faces = [(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]
    stats = TriangleMesh(np.array(corners, float), np.array(faces), (-1.0, -1.0), (2.0, 2.0)).statistics()
    assert stats.alpha == pytest.approx(1.0)
    assert stats.area_ratio == pytest.approx(np.sqrt(2.0))
    assert stats.rms_height == pytest.approx(np.sqrt(1.0 / 18.0))
    assert (stats.peak_to_valley, stats.n_facets) == (1.0, 4)


def test_walls_and_undersides_do_not_count_in_alpha():
    # A flat step of height 1 over a unit square, with its vertical wall: alpha 0, area 1 + 1.
    upper = [(0, 0, 1), (0.5, 0, 1), (0.5, 1, 1), (0, 1, 1)]
    vertices = [*upper, (0.5, 0, 0), (1, 0, 0), (1, 1, 0), (0.5, 1, 0)]
    faces = [(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7), (1, 4, 7), (1, 7, 2)]
    stats = TriangleMesh(np.array(vertices, float), np.array(faces), (0.0, 0.0), (1.0, 1.0)).statistics()
    assert stats.alpha == pytest.approx(0.0, abs=1e-12)
    assert stats.area_ratio == pytest.approx(2.0)
    assert stats.rms_height == pytest.approx(0.5)


@pytest.mark.parametrize("scale", [1e-9, 1e6])
def test_statistics_scale_with_the_tile(scale):
    heights = np.random.default_rng(3).normal(size=(6, 6))
    one, scaled = HeightField(heights, (4.0, 4.0)), HeightField(scale * heights, (4.0 * scale, 4.0 * scale))
    assert scaled.statistics().alpha == pytest.approx(one.statistics().alpha, rel=1e-12)
    assert scaled.statistics().rms_height == pytest.approx(scale * one.statistics().rms_height, rel=1e-12)


@pytest.mark.parametrize(
    ("heights", "size", "message"),
    [
        (np.zeros(4), (1.0, 1.0), "shape"),
        (np.zeros((0, 3)), (1.0, 1.0), "shape"),
        (np.array([[0.0, np.nan]]), (1.0, 1.0), "1 of 2"),
        (np.zeros((2, 2)), (1.0, 0.0), "positive"),
        (np.zeros((2, 2)), (np.inf, 1.0), "finite"),
    ],
)
def test_bad_height_field(heights, size, message):
    with pytest.raises(InputError, match=message):
        HeightField(heights, size)


def test_bad_mesh():
    triangle = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
    one = np.array([(0, 1, 2)])
    with pytest.raises(InputError, match=r"0\.\.2"):
        TriangleMesh(triangle, one + 1, (0.0, 0.0), (1.0, 1.0))
    with pytest.raises(InputError, match="at least one face"):
        TriangleMesh(triangle, one[:0], (0.0, 0.0), (1.0, 1.0))
    with pytest.raises(InputError, match="1 of 3"):
        TriangleMesh(np.diag([1.0, np.inf, 0.0])[[2, 0, 1]], one, (0.0, 0.0), (1.0, 1.0))
    with pytest.raises(InputError, match=r"labels of shape \(2,\): must be \(1,\)"):
        TriangleMesh(triangle, one, (0.0, 0.0), (1.0, 1.0), np.zeros(2, np.uint8))
    with pytest.raises(InputError, match="no facet faces up"):
        TriangleMesh(triangle, one[:, ::-1], (0.0, 0.0), (1.0, 1.0)).statistics()
