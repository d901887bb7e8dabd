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

import numpy as np
from numpy.typing import NDArray

from microgeometry.errors import InputError

Array = NDArray[np.float64]


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

    def rings_within(self, slope: float) -> int:
        """How many rings can be interpolated to the centre of the next one without reaching this slope."""
        middle = np.sqrt(0.5 * (self.slope_edges[1:] ** 2 + self.slope_edges[:-1] ** 2))
        reach = np.append(middle[1:], self.extent)
        return int(np.searchsorted(reach, slope))

    def projected_solid_angles(self, theta_i: float) -> Array:
        """Projected solid angle that each cell reflects light from `theta_i` into, sr, shape (S, Q)."""
        middle = np.sqrt(0.5 * (self.slope_edges[1:] ** 2 + self.slope_edges[:-1] ** 2))
        psi = 0.5 * (self.psi_edges[1:] + self.psi_edges[:-1])
        cos_h = 1.0 / np.sqrt(1.0 + middle**2)[:, None]
        cos_d = cos_h * (np.cos(theta_i) + np.sin(theta_i) * middle[:, None] * np.cos(psi))
        cos_o = 2.0 * cos_d * cos_h - np.cos(theta_i)
        return self.areas * 4.0 * np.maximum(cos_o, 0.0) * np.maximum(cos_d, 0.0) * cos_h**3


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
