"""The tile: one period of a surface as triangles, and what can be measured on it."""

from __future__ import annotations

from dataclasses import dataclass
from math import e, sqrt
from typing import TypeAlias

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from microgeometry.errors import InputError

# A facet within 1e-6 rad of vertical is a wall: its projected area is rounding noise and its slope is
# infinite, so it says nothing about alpha. It still counts in area_ratio.
_VERTICAL_COS = 1e-6


@dataclass(frozen=True)
class SurfaceStatistics:
    """What the facets of a tile are, measured on the triangles that rays will meet.

    Attributes
    ----------
    alpha : float
        Beckmann roughness, sqrt(2) times the rms slope per axis: ``sqrt(<hx^2 + hy^2>)``, the mean taken
        over the projected area of the facets that face up (also called Sdq).
    alpha_x, alpha_y : float
        The same of one axis: ``sqrt(2 <hx^2>)``, ``sqrt(2 <hy^2>)``; alpha^2 is the mean of their squares.
    rms_height : float
        Rms height in metres about the mean, over the projected area of the same facets (not of the
        samples: the flanks between them count).
    peak_to_valley : float
        Highest minus lowest vertex, metres.
    area_ratio : float
        True area of all facets / area of the tile's rectangle.
    n_facets : int
        Number of triangles.
    """

    alpha: float
    alpha_x: float
    alpha_y: float
    rms_height: float
    peak_to_valley: float
    area_ratio: float
    n_facets: int


@dataclass(frozen=True)
class HeightFieldStatistics(SurfaceStatistics):
    """Statistics of a height field, which has an autocorrelation besides.

    Attributes
    ----------
    correlation_length_x, correlation_length_y : float
        Distance along the axis, metres, at which the autocorrelation of the heights about their mean has
        fallen to 1/e, linear between samples. Half the period, the longest that a period can tell, where it
        stays above: along grooves, or on a plane.
    """

    correlation_length_x: float
    correlation_length_y: float


@dataclass(frozen=True, eq=False)
class HeightField:
    """One period of a height field on a rectangular grid.

    Each quad v0 = (i, j), v1 = (i+1, j), v2 = (i+1, j+1), v3 = (i, j+1) is two triangles,
    (v0, v1, v3) and (v2, v3, v1): the split of Embree's grid geometry. The last quad of a row joins
    sample nx-1 to sample 0 of the next period, so there are 2 nx ny triangles and no seam.

    Attributes
    ----------
    heights : ndarray, shape (nx, ny), float64
        Heights in metres; sample (i, j) stands at x = i Lx / nx, y = j Ly / ny.
    size : tuple of float
        Periods (Lx, Ly), metres.

    Raises
    ------
    InputError
        Heights are not a two-dimensional array of finite numbers, or a period is not positive.
    """

    heights: NDArray[np.float64]
    size: tuple[float, float]

    def __post_init__(self) -> None:
        heights = np.ascontiguousarray(self.heights, dtype=np.float64)
        if heights.ndim != 2 or heights.size == 0:
            raise InputError(f"heights of shape {heights.shape}: must be (nx, ny), at least 1 x 1")
        n_bad = heights.size - np.count_nonzero(np.isfinite(heights))
        if n_bad:
            raise InputError(f"heights: {n_bad} of {heights.size} are NaN or infinite; all must be finite")
        object.__setattr__(self, "heights", heights)
        object.__setattr__(self, "size", _checked_size(self.size))

    def slopes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Slopes dh/dx and dh/dy of the facets.

        Returns
        -------
        hx, hy : ndarray, shape (2, nx, ny)
            Dimensionless. First index: 0 for the triangles (v0, v1, v3), 1 for (v2, v3, v1).
        """
        nx, ny = self.heights.shape
        east = (np.roll(self.heights, -1, axis=0) - self.heights) * (nx / self.size[0])
        north = (np.roll(self.heights, -1, axis=1) - self.heights) * (ny / self.size[1])
        # The second triangle has its x edge one row up and its y edge one column on.
        return np.stack((east, np.roll(east, -1, axis=1))), np.stack((north, np.roll(north, -1, axis=0)))

    def facets(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Normals and areas of all facets.

        Returns
        -------
        normals : ndarray, shape (2 nx ny, 3)
            Unit, upward; first all triangles (v0, v1, v3), then all (v2, v3, v1), j running fastest.
        areas : ndarray, shape (2 nx ny,)
            Square metres.
        """
        hx, hy = self.slopes()
        stretch = np.sqrt(1.0 + hx * hx + hy * hy).ravel()
        normals = np.column_stack((-hx.ravel(), -hy.ravel(), np.ones(hx.size))) / stretch[:, None]
        projected = self.size[0] * self.size[1] / hx.size
        return normals, projected * stretch

    def statistics(self) -> HeightFieldStatistics:
        """Measure the tile (see `SurfaceStatistics` and `HeightFieldStatistics`)."""
        x_squared, y_squared = (slope**2 for slope in self.slopes())
        z = self.heights - self.heights.mean()
        east, north = np.roll(z, -1, axis=0), np.roll(z, -1, axis=1)
        # The integral of z^2 over a triangle with corners a, b, c is A (a^2+b^2+c^2+ab+bc+ca) / 6.
        # Both triangles of a quad have one edge along x, one along y and the diagonal v1 v3.
        mean_z_squared = np.mean(3.0 * z * z + z * east + z * north + east * north) / 6.0
        return HeightFieldStatistics(
            alpha=sqrt(x_squared.mean() + y_squared.mean()),
            alpha_x=sqrt(2.0 * x_squared.mean()),
            alpha_y=sqrt(2.0 * y_squared.mean()),
            rms_height=sqrt(mean_z_squared),
            peak_to_valley=float(np.ptp(z)),
            area_ratio=float(np.sqrt(1.0 + x_squared + y_squared).mean()),
            n_facets=2 * z.size,
            correlation_length_x=_correlation_length(z, self.size[0], 0),
            correlation_length_y=_correlation_length(z, self.size[1], 1),
        )


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """One period of a surface of triangles, overhangs allowed.

    Attributes
    ----------
    vertices : ndarray, shape (V, 3), float64
        Positions, metres; z is up.
    faces : ndarray, shape (F, 3), int32
        Vertex indices, counter-clockwise seen from the side the surface faces.
    origin : tuple of float
        Corner (x0, y0) of the period's rectangle, metres.
    size : tuple of float
        Periods (Lx, Ly), metres.
    labels : ndarray, shape (F,), uint8, or None
        What each face is made of: 0 the layer's material, 1 that of its `plane`. None: all of them 0.

    Raises
    ------
    InputError
        Arrays of another shape, no face, an index beyond the vertices, a vertex that is not finite, or a
        period that is not positive.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    origin: tuple[float, float]
    size: tuple[float, float]
    labels: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices, dtype=np.float64)
        faces = np.ascontiguousarray(self.faces, dtype=np.int32)
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise InputError(f"vertices of shape {vertices.shape}: must be (V, 3)")
        if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) == 0:
            raise InputError(f"faces of shape {faces.shape}: must be (F, 3) with at least one face")
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise InputError(
                f"faces: indices run from {faces.min()} to {faces.max()}; "
                f"with {len(vertices)} vertices they must lie in 0..{len(vertices) - 1}"
            )
        n_bad = np.count_nonzero(~np.isfinite(vertices).all(axis=1))
        if n_bad:
            raise InputError(f"vertices: {n_bad} of {len(vertices)} are NaN or infinite; all must be finite")
        if self.labels is not None:
            labels = np.ascontiguousarray(self.labels, dtype=np.uint8)
            if labels.shape != (len(faces),):
                raise InputError(
                    f"labels of shape {labels.shape}: must be ({len(faces)},), one for each face"
                )
            object.__setattr__(self, "labels", labels)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)
        object.__setattr__(self, "origin", (float(self.origin[0]), float(self.origin[1])))
        object.__setattr__(self, "size", _checked_size(self.size))

    def facets(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Normals and areas of all facets, in the order of `faces`.

        Returns
        -------
        normals : ndarray, shape (F, 3)
            Unit, to the side from which the face is counter-clockwise: z < 0 on the underside of an
            overhang. Zero for a face without area.
        areas : ndarray, shape (F,)
            Square metres.
        """
        a, b, c = (self.vertices[self.faces[:, corner]] for corner in range(3))
        cross = np.cross(b - a, c - a)
        twice_area = np.linalg.norm(cross, axis=1)
        return cross / np.where(twice_area > 0, twice_area, 1.0)[:, None], 0.5 * twice_area

    def statistics(self) -> SurfaceStatistics:
        """Measure the tile (see `SurfaceStatistics`).

        Undersides of overhangs and walls within 1e-6 rad of vertical are left out of alpha and
        rms_height: they have no projected area seen from above.

        Raises
        ------
        InputError
            No facet faces up.
        """
        normals, areas = self.facets()
        up = normals[:, 2] > _VERTICAL_COS
        if not up.any():
            raise InputError("mesh: no facet faces up (+z); reverse its faces or turn it")
        nz = normals[up, 2]
        projected = areas[up] * nz
        weights = projected / projected.sum()
        a, b, c = (self.vertices[self.faces[up, corner], 2] for corner in range(3))
        mean = np.sum(weights * (a + b + c)) / 3.0
        a, b, c = a - mean, b - mean, c - mean
        z_squared = (a * a + b * b + c * c + a * b + b * c + c * a) / 6.0
        x_squared, y_squared = (np.sum(weights * (normals[up, axis] / nz) ** 2) for axis in (0, 1))
        return SurfaceStatistics(
            alpha=sqrt(x_squared + y_squared),
            alpha_x=sqrt(2.0 * x_squared),
            alpha_y=sqrt(2.0 * y_squared),
            rms_height=float(np.sqrt(np.sum(weights * z_squared))),
            peak_to_valley=float(np.ptp(self.vertices[self.faces, 2])),
            area_ratio=float(areas.sum() / (self.size[0] * self.size[1])),
            n_facets=len(self.faces),
        )


Tile: TypeAlias = HeightField | TriangleMesh


def _correlation_length(heights: NDArray[np.float64], period: float, axis: int) -> float:
    """Distance along an axis at which the autocorrelation of heights of mean 0 falls to 1/e (or period / 2)."""
    n = heights.shape[axis]
    power = np.abs(scipy.fft.rfft(heights, axis=axis, workers=2)) ** 2
    correlation = scipy.fft.irfft(power.sum(axis=1 - axis), n)[: n // 2 + 1]
    below = np.flatnonzero(correlation < correlation[0] / e)
    if len(below) == 0:
        return 0.5 * period
    lag = below[0]
    before, after = correlation[lag - 1 : lag + 1]
    return float(lag - 1 + (before - correlation[0] / e) / (before - after)) * period / n


def _checked_size(size: tuple[float, float]) -> tuple[float, float]:
    lx, ly = float(size[0]), float(size[1])
    if not (0.0 < lx < np.inf and 0.0 < ly < np.inf):
        raise InputError(f"size = ({lx:g}, {ly:g}) m: both periods must be positive and finite")
    return lx, ly
