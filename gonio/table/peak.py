"""A highlight on a fine grid of its own, around the mirror direction.

The grid is one of half-vector slopes, s = -(h_x, h_y)/h_z of h = wi + wo, in polar coordinates: the length of
s, and psi, the azimuth from the light's to the half vector's, folded to [0, pi] (0: h leans to the light). The
mirror direction is s = 0 for every theta_i, and what facets of slope s reflect comes through s, so that a
narrow highlight neither moves over this grid nor changes its shape with theta_i, as it does over theta_r.

What is tabulated is the reflected energy per unit of slope area, g. As d omega_o = 4 (wi.h) h_z^3 d^2 s
(Walter et al. 2007, eq. 14, and d omega_h = h_z^3 d^2 s), g = 4 f cos(theta_o) (wi.h) h_z^3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.core.masking import masked_cosines_many
from microgeometry.errors import InputError

Array = NDArray[np.float64]

_ROW_POINTS = 3

_CORE, _STEP = 5.0, 0.25  # rings of equal area up to there, in slope^2 / alpha^2: 99 % of a Gaussian's light
_GROWTH = 1.25  # of the rings' areas, beyond
_EXTENT = 6.0  # in units of alpha, at least
_CELLS = 4.0  # and in slopes, this many of the table's cells of theta_r: beyond, these follow any tail
_SECTORS = 8


@dataclass(frozen=True, eq=False)
class Peak:
    """All light that leaves with half vectors in a disc of slopes, in smaller cells than the table's. Immutable.

    The table's own cells hold this light as well; its rows and channels are the table's.

    Parameters
    ----------
    values : ndarray, shape (I, S, Q, C)
        Mean of g over each cell, in units of the incident energy per unit of slope area; delta term apart.
    slope_edges : ndarray, shape (S + 1,)
        Increasing from 0.
    psi_edges : ndarray, shape (Q + 1,)
        Radians, increasing from 0 to pi.
    std_error : ndarray, shape (I, S, Q, C), optional
        Standard error of each value's mean. None: unknown.

    Raises
    ------
    InputError
        A shape, a range or a NaN.
    """

    values: Array
    slope_edges: Array
    psi_edges: Array
    std_error: Array | None = None

    def __post_init__(self) -> None:
        for name in ("values", "slope_edges", "psi_edges", "std_error"):
            if getattr(self, name) is None:
                continue
            array = np.array(getattr(self, name), np.float64)
            if not np.all(np.isfinite(array)):
                raise InputError(f"peak/{name}: contains NaN or infinity; finite numbers are expected")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        for name, last in (("slope_edges", None), ("psi_edges", np.pi)):
            edges = getattr(self, name)
            if edges.ndim != 1 or len(edges) < 2 or edges[0] != 0 or not np.all(np.diff(edges) > 0):
                raise InputError(f"peak/{name}: must be two numbers or more that increase from 0")
            if last is not None and abs(edges[-1] - last) > 1e-9:
                raise InputError(f"peak/{name}: must end at pi, found {edges[-1]}")
        cells = len(self.slope_edges) - 1, len(self.psi_edges) - 1
        for name in ("values", "std_error"):
            array = getattr(self, name)
            if array is not None and (array.ndim != 4 or array.shape[1:3] != cells):
                raise InputError(
                    f"peak/{name}: shape {array.shape}; (theta_i, {cells[0]}, {cells[1]}, channel) is expected"
                )
        if self.std_error is not None and (
            self.std_error.shape != self.values.shape or not np.all(self.std_error >= 0)
        ):
            raise InputError("peak/std_error: must be of the values' shape, and >= 0")

    @property
    def extent(self) -> float:
        """The largest slope."""
        return float(self.slope_edges[-1])

    @property
    def areas(self) -> Array:
        """Area of each cell, of both signs of psi, in slopes; shape (S, Q)."""
        return slope_areas(self.slope_edges, self.psi_edges)

    @property
    def alpha(self) -> float:
        """Roughness that the grid was made for: its first ring ends at half of it (`grid_of`)."""
        return 2.0 * float(self.slope_edges[1])

    def visible(self, theta_i: tuple[float, float]) -> Visible:
        """What the plane lets out of each cell, for light from between two angles, in proportion to sin^2."""
        sums = np.zeros((3, *self.areas.shape))
        for angle, share in row_angles(theta_i):
            points = visible_points(angle, self.slope_edges, self.psi_edges)
            each = points.weight * points.measure
            masked = each / points.masked_cosines(self.alpha)
            for total, integrand in zip(sums, (points.weight, 4.0 * each, masked), strict=True):
                total += share * integrand.sum(axis=(1, 3))
        return Visible(*sums)


class Visible(NamedTuple):
    """Integrals over the part of each of a peak's cells that reflects above the plane; shape (S, Q)."""

    area: Array
    """Of it, in slopes."""
    projected_solid_angles: Array
    """That it reflects into, sr."""
    light: Array
    """Energy that it reflects where f is 1 / (4 w), w = `gonio.core.masking.masked_cosines`."""


class Points(NamedTuple):
    """A quadrature over the visible part of each cell, n points along the slope and m along psi."""

    slope: Array
    """(S, n, Q, m)"""
    psi: Array
    """(Q, m)"""
    weight: Array
    """(S, n, Q, m): slope area, of both signs of psi."""
    cos_d: Array
    """wi.h, of the slope's shape like the next two."""
    cos_o: Array
    cos_h: Array
    cos_i: float

    @property
    def measure(self) -> Array:
        """The energy g where f is 1/4."""
        return self.cos_o * self.cos_d * self.cos_h**3

    def masked_cosines(self, alpha: float) -> Array:
        """`gonio.core.masking.masked_cosines`, above 0."""
        out = np.empty(self.cos_o.size)
        masked_cosines_many(alpha, self.cos_i, self.cos_o.ravel(), out)
        return np.maximum(out, np.finfo(float).tiny).reshape(self.cos_o.shape)


class PeakGrid(NamedTuple):
    """The cells of a `Peak`."""

    slope_edges: Array
    psi_edges: Array

    @property
    def areas(self) -> Array:
        """As `Peak.areas`."""
        return slope_areas(self.slope_edges, self.psi_edges)


def grid_of(alphas: list[float], theta_step_deg: float) -> PeakGrid:
    """The grid for highlights of these alphas in a table of such cells."""
    least = min(alphas)
    extent = max(_EXTENT * max(alphas), _CELLS * np.radians(theta_step_deg)) / least
    core = np.arange(round(_CORE / _STEP) + 1) * _STEP
    rings = int(np.ceil(np.log(extent**2 / _CORE) / np.log(_GROWTH)))
    tail = np.geomspace(_CORE, extent**2, rings + 1)[1:]
    return PeakGrid(least * np.sqrt(np.concatenate([core, tail])), np.linspace(0.0, np.pi, _SECTORS + 1))


def row_angles(theta_i: tuple[float, float]) -> list[tuple[float, float]]:
    """Angles of incidence between two, and what share of the row each is; one where both are the same."""
    low, high = np.sin(theta_i) ** 2
    if low == high:
        return [(theta_i[0], 1.0)]
    x, weights = np.polynomial.legendre.leggauss(_ROW_POINTS)
    angles = np.arcsin(np.sqrt(low + (high - low) * (0.5 + 0.5 * x)))
    return list(zip(angles.tolist(), (0.5 * weights).tolist(), strict=True))


def visible_points(
    theta_i: float, slope_edges: Array, psi_edges: Array, along: int = 4, around: int = 8
) -> Points:
    """Points in cells that are cut off where light from `theta_i` would be reflected below the plane.

    cos(theta_o) is 0 on s^2 - 2 s tan(theta_i) cos(psi) = 1.
    """
    psi, around_weight = gauss(psi_edges, around)
    lean = np.tan(theta_i) * np.cos(psi)
    root = np.sqrt(lean**2 + 1.0)
    horizon = np.where(lean > 0, lean + root, 1.0 / (root + np.abs(lean)))
    square = np.minimum(slope_edges[:, None, None], horizon) ** 2
    x, weight = np.polynomial.legendre.leggauss(along)
    low, width = square[:-1, None], np.diff(square, axis=0)[:, None]
    slope = np.sqrt(low + width * (0.5 + 0.5 * x)[:, None, None])
    weights = width * (0.5 * weight)[:, None, None] * around_weight
    cos_h = 1.0 / np.sqrt(1.0 + slope**2)
    cos_d = cos_h * (np.cos(theta_i) + np.sin(theta_i) * slope * np.cos(psi))
    cos_o = np.maximum(2.0 * cos_d * cos_h - np.cos(theta_i), 0.0)
    return Points(slope, psi, weights, cos_d, cos_o, cos_h, float(np.cos(theta_i)))


def gauss(edges: Array, points: int) -> tuple[Array, Array]:
    """Gauss-Legendre points on each interval, shape (n, points), and their weights, of the intervals' lengths."""
    x, w = np.polynomial.legendre.leggauss(points)
    width = np.diff(edges)[:, None]
    return edges[:-1, None] + width * (0.5 + 0.5 * x), 0.5 * width * w


def slope_areas(slope_edges: Array, psi_edges: Array) -> Array:
    """`Peak.areas` of such edges."""
    return np.diff(slope_edges**2)[:, None] * np.diff(psi_edges)


def reached(
    theta_i: tuple[float, float], theta_r_edges: Array, delta_phi_edges: Array, extent: float
) -> NDArray[np.bool_]:
    """Which cells of a table's row hold directions whose half vector has a slope up to `extent`, shape (R, P).

    Parameters
    ----------
    theta_i : tuple of float
        Least and largest of the row, radians.
    theta_r_edges, delta_phi_edges : ndarray
        Of the table.
    extent : float
        Cells that hold but a sliver of the disc may be left out.
    """
    low, high = theta_r_edges[:-1], theta_r_edges[1:]
    inside = np.zeros((len(low), len(delta_phi_edges) - 1), bool)
    # the slope is least where delta phi is largest, and theta_r about theta_i
    cos_phi, sin_phi = np.cos(delta_phi_edges[1:]), np.sin(delta_phi_edges[1:])
    for incident in np.linspace(*theta_i, 3):
        for theta_r in (low, np.clip(incident, low, high), high):
            x = np.sin(incident) + np.sin(theta_r)[:, None] * cos_phi
            y = np.sin(theta_r)[:, None] * sin_phi
            z = (np.cos(incident) + np.cos(theta_r))[:, None]
            inside |= x**2 + y**2 <= (extent * z) ** 2
    return inside
