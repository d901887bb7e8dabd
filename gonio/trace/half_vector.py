"""The half-vector estimator: light that leaves a rough mirror after one bounce, without binning it.

A facet of normal m sends light from i to o only if m is their half vector h. Averaged over the azimuth of i,
as the rows of a table are, the BRDF of single scattering off a height field is therefore exactly

    f1(i, o) = F(theta_d) D(theta_h) V(i, o) / (4 cos theta_i cos theta_r),

where D is the area of facets by tilt (per solid angle and per area of the plane) and V the fraction of the
facets of tilt theta_h that, with i and o turned to where their half vector is the facet's normal, see both.
No isotropy is asked of the surface. D is one-dimensional: every facet of every realisation feeds it. V is
smooth; it is measured by pairs of occlusion rays from few facets at the nodes of a grid in (theta_h, theta_d,
phi_d) (Rusinkiewicz 1998), which has its only kink, retro-reflection, on its border theta_d = 0.

Light of two and more bounces is not in it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gonio.core.lookup import axis
from gonio.core.optics import fresnel_conductor
from gonio.core.parallel import for_each
from gonio.table.peak import row_angles, visible_points
from gonio.trace.facets import BINS, PACKED, STEP, FacetSums, nodes
from gonio.trace.half_vector_cells import (
    Model,
    Rule,
    azimuth_rule,
    point_rule,
    polar_rule,
    row_cells,
    row_slopes,
)
from gonio.trace.peak_grid import PeakGrid
from gonio.trace.scene import Optics

Array = NDArray[np.float64]

_GROUPS = 64  # batches are kept apart in that many groups at most
_FRESNEL = 1024
_RESOLUTION = 0.2  # of alpha: what a point of the quadrature stands for at most, and at least 1 degree
_FINE_SPREAD = 1.2  # of theta_h over a cell, of the resolution times its points along theta
_LEVELS = 10
_SLOPES = 0.05  # of alpha: what a point of the quadrature over a peak's cells stands for


class HalfVector:
    """Single bounces off one opaque surface of mirror facets, from the facets of many realisations.

    Parameters
    ----------
    optics : Optics
        Of a mirror or a conductor.
    to_channels : ndarray or None, shape (C, S)
        From the samples traced to the table's channels; None where they are the same.
    samples : int
        S.
    alpha : float
        As in `gonio.trace.facets.measure_facets`.

    Attributes
    ----------
    batches : int
    """

    def __init__(self, optics: Optics, to_channels: Array | None, samples: int, alpha: float) -> None:
        self.batches = 0
        self._fresnel = _reflectance(optics, samples)
        if to_channels is not None:
            self._fresnel = self._fresnel @ to_channels.T
        self._nodes = nodes(alpha)
        self._batches_per_group = 1
        self._count = np.zeros(_GROUPS)  # batches in each group
        self._sums = np.zeros((_GROUPS, PACKED))

    def add(self, packed: Array) -> None:
        """Add what `gonio.trace.facets.measure_facets` found on the next realisation."""
        group = self._open_group()
        self._count[group] += 1
        self._sums[group] += packed
        self.batches += 1

    @property
    def rays(self) -> int:
        """Occlusion rays cast."""
        return int(self._sums[:, 1].sum())

    def state(self) -> dict[str, NDArray]:
        """All that was learned so far, as arrays by name; not copies."""
        return {
            "batches": np.array([self.batches, self._batches_per_group]),
            "count": self._count,
            "sums": self._sums,
        }

    def restore(self, state: dict[str, NDArray]) -> None:
        """Go on from a `state`.

        Raises
        ------
        ValueError, KeyError
            An array is missing or of another shape.
        """
        self.batches, self._batches_per_group = (int(n) for n in state["batches"])
        self._count[...], self._sums[...] = state["count"], state["sums"]

    def _open_group(self) -> int:
        """Group of the next batch; where all are full, neighbours merge and each holds twice as many."""
        group = self.batches // self._batches_per_group
        if group == _GROUPS:
            for sums in (self._count, self._sums):
                sums[: _GROUPS // 2] = sums[::2] + sums[1::2]
                sums[_GROUPS // 2 :] = 0.0
            self._batches_per_group *= 2
            group = _GROUPS // 2
        return group

    def cells(
        self,
        theta_i: Array,
        theta_i_edges: Array | None,
        theta_r_edges: Array,
        delta_phi_edges: Array,
        threads: int | None = None,
    ) -> tuple[Array, Array]:
        """Cell averages of the BRDF of single bounces; at least two batches.

        Parameters
        ----------
        theta_i : ndarray, shape (I,)
            Rows, radians: exactly these angles, or where `theta_i_edges` are given, averages over projected
            solid angle between them.
        theta_i_edges : ndarray or None, shape (I + 1,)
        theta_r_edges, delta_phi_edges : ndarray, shapes (R + 1,) and (P + 1,)
            Radians.
        threads : int, optional

        Returns
        -------
        values, std_error : ndarray, shape (I, R * P, C)
            1/sr.
        """
        alpha = self._nodes.alpha
        resolution = max(math.radians(1.0), _RESOLUTION * alpha)
        points = _points(theta_r_edges, resolution)
        # D is averaged over the tilts between two points, but over no more than hardly bends it
        between = min(0.5 * float(np.diff(theta_r_edges).max()) / points, 0.1 * alpha)
        # an odd number of bins: an even one would not be centred, and half a bin off is 1 % of D at alpha 0.1
        model = self._model(2 * round(0.5 * between / STEP) + 1)

        def rules(finer: int) -> tuple[Rule, Rule, Rule]:
            polar = finer * points
            return (
                point_rule(theta_i, alpha)
                if theta_i_edges is None
                else polar_rule(theta_i_edges, polar, alpha),
                polar_rule(theta_r_edges, polar, alpha),
                azimuth_rule(delta_phi_edges, finer * _points(delta_phi_edges, resolution)),
            )

        fast, fine = rules(1), rules(4)
        coarse = _FINE_SPREAD * resolution * points
        cells = (len(theta_r_edges) - 1) * (len(delta_phi_edges) - 1)
        rows, channels = len(theta_i), self._fresnel.shape[1]
        values, std_error = np.zeros((2, rows, cells, channels))

        def average(row: int) -> None:
            row_cells(model, row, fast, fine, coarse, values[row], std_error[row])

        for_each(average, rows, threads)
        return values, std_error

    def slopes(
        self, theta_i: Array, theta_i_edges: Array | None, grid: PeakGrid, threads: int | None = None
    ) -> tuple[Array, Array]:
        """Averages of the energy g of single bounces over the cells of a peak; arguments as in `cells`.

        Returns
        -------
        values, std_error : ndarray, shape (I, S, Q, C)
            As `gonio.table.peak.Peak`.
        """
        alpha = self._nodes.alpha
        model = self._model(2 * round(0.5 * _SLOPES * alpha / STEP) + 1)
        areas = grid.areas
        values, std_error = np.zeros((2, len(theta_i), areas.size, self._fresnel.shape[1]))

        def average(row: int) -> None:
            between = (theta_i[row],) * 2 if theta_i_edges is None else tuple(theta_i_edges[row : row + 2])
            for angle, share in row_angles(between):
                at = visible_points(angle, *grid)
                weight = at.weight * at.measure / at.masked_cosines(alpha)
                points = np.arctan(at.slope), at.cos_d, at.cos_o, at.cos_h, weight, at.cos_i
                row_slopes(model, points, share, values[row], std_error[row])

        for_each(average, len(theta_i), threads)
        shape = len(theta_i), *areas.shape, -1
        return values.reshape(shape) / areas[..., None], std_error.reshape(shape) / areas[..., None]

    def _model(self, width: int) -> Model:
        """Means over all batches, D over so many bins of tilt, and how much they differ between groups of batches."""
        count, area, window, seen = self._groups()
        n = len(count)
        edges = STEP * np.arange(BINS + 1)
        solid_angle = 2.0 * math.pi * -np.diff(np.cos(edges))
        density = _moving_sum(area.sum(0), width) / self.batches / _moving_sum(solid_angle, width)
        # facets cover the plane once, before and after their average
        cosine = np.cos(edges[:-1] + 0.5 * STEP)
        density *= np.sum(area.sum(0) * cosine) / self.batches / np.sum(density * solid_angle * cosine)
        density_change = np.stack(
            [_deviations(_moving_sum(area, 2**level), count) for level in range(_LEVELS)]
        )
        rho_change = _deviations(seen, count) - _deviations(window, count)[:, :, None, None]
        total = window.sum(0)[:, None, None]
        rho = np.where(total > 0, seen.sum(0) / np.where(total > 0, total, 1.0), np.nan)
        for a in range(len(total)):  # tilts too rare to be seen look like the steepest that are not
            if a and (total[a] == 0 or np.count_nonzero(window[:, a]) < n // 2):
                rho[a], rho_change[:, a] = rho[a - 1], rho_change[:, a - 1]
        one_degree = np.sin(edges[:-1] + 0.5 * STEP) * math.radians(1.0) * 2.0 * math.pi
        facets = self._sums[:, 0].sum()
        floor = 3.0 / (facets * np.cos(edges[:-1] + 0.5 * STEP) * one_degree)
        return Model(
            STEP, width, density, floor, self._fresnel,
            axis(self._nodes.tilt), axis(self._nodes.opening), axis(self._nodes.turn),
            rho, count, np.ascontiguousarray(np.moveaxis(density_change, 1, 2)),
            np.ascontiguousarray(np.moveaxis(rho_change, 0, 3)),
        )  # fmt: skip

    def _groups(self) -> tuple[Array, Array, Array, Array]:
        """Batches of each group in use, and their sums: area by tilt, area in the windows, of that what is seen."""
        used = self._count > 0
        groups = [FacetSums.unpack(sums) for sums in self._sums[used]]
        return (
            self._count[used],
            np.stack([group.area for group in groups]),
            np.stack([group.window_area for group in groups]),
            np.stack([group.seen_area for group in groups]),
        )


def _deviations(sums: Array, count: Array) -> Array:
    """Relative deviations from the mean over all batches of sums over groups; 0 where there is nothing."""
    shape = (-1, *[1] * (sums.ndim - 1))
    mean = sums.sum(0) / count.sum()
    return np.where(mean > 0, sums / count.reshape(shape) / np.where(mean > 0, mean, 1.0) - 1.0, 0.0)


def _variance(deviations: Array, count: Array) -> Array:
    """Variance of the mean over batches, from deviations of groups of `count` batches each."""
    squares = np.tensordot(count, deviations**2, 1)
    return squares / (max(len(count) - 1, 1) * count.sum())


def _moving_sum(a: Array, width: int) -> Array:
    """Sums over `width` neighbours along the last axis, about each; fewer at the ends."""
    total = np.concatenate([np.zeros((*a.shape[:-1], 1)), np.cumsum(a, axis=-1)], axis=-1)
    centre = np.arange(a.shape[-1])
    low = np.maximum(centre - (width - 1) // 2, 0)
    high = np.minimum(centre + width // 2 + 1, a.shape[-1])
    return total[..., high] - total[..., low]


def _points(edges: Array, resolution: float) -> int:
    """Points of a quadrature over intervals this wide, at least 2."""
    return max(2, math.ceil(float(np.max(np.diff(edges))) / resolution - 1e-6))


def _reflectance(optics: Optics, samples: int) -> Array:
    """Reflectance for unpolarised light, shape (_FRESNEL, S), at theta_d uniform from 0 to pi/2."""
    if optics.eta_k is None:
        return np.ones((_FRESNEL, samples))
    cosine = np.cos(np.linspace(0.0, 0.5 * math.pi, _FRESNEL))
    return np.array(
        [[0.5 * sum(fresnel_conductor(max(0.0, c), eta, k)) for eta, k in optics.eta_k] for c in cosine]
    )
