"""The BRDF table: what a measurement leaves behind."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.core.directions import projected_solid_angles
from gonio.table import many
from gonio.table.brdf_table import BRDFTable, check_arrays, check_channels, check_parts
from gonio.table.peak import Peak
from gonio.table.pool import Pool, pool_tables
from microgeometry.errors import InputError

Array = NDArray[np.float64]

# What parts have in common with their table
_SHARED = ("theta_i", "theta_i_edges", "theta_r_edges", "delta_phi_edges", "channels", "wavelengths_nm")


@dataclass(frozen=True, eq=False)
class Table(BRDFTable):
    """An isotropic BRDF on a (theta_i, theta_r, delta phi) grid, with its error bars. Immutable.

    Angles are radians between the outward directions and the macroscopic normal; delta phi, folded to
    [0, pi], is 0 at retro-reflection and pi on the mirror side. Values are f_r in 1/sr without cosine.

    Parameters
    ----------
    values : ndarray, shape (I, R, P, C)
        Mean BRDF over each cell: sum(w) / (N x projected solid angle of the cell), delta term apart.
    theta_i : ndarray, shape (I,)
        The rows' angles of incidence, increasing. Where `theta_i_edges` is given, the middle of the row.
    theta_r_edges : ndarray, shape (R + 1,)
        Increasing, from 0 to pi/2.
    delta_phi_edges : ndarray, shape (P + 1,)
        Increasing, from 0 to pi.
    channels : tuple of str
        Names of the C channels: ("R", "G", "B"), or one a wavelength.
    row_albedo : ndarray, shape (I, C)
        Directional-hemispherical reflectance of each row, delta term included.
    theta_i_edges : ndarray, shape (I + 1,), optional
        Rows are cells of incidence whose directions were drawn in proportion to projected solid angle;
        None where the rows are exactly the angles `theta_i`.
    std_error : ndarray, shape (I, R, P, C), optional
        Standard error of each value's mean; never 0 in a cell that light could reach. None: unknown.
    hits : ndarray of int64, shape (I, R, P), optional
        Paths that ended in each cell. None: not a traced table.
    gaps : ndarray of bool, shape (I, R, P), optional
        Cells nobody measured; their values are 0 and mean nothing. None: no gaps.
    albedo_std_error, specular, specular_std_error : ndarray, shape (I, C), optional
        Standard errors, and the delta (mirror) term: reflectance into exactly the mirror direction.
        Default zeros.
    wavelengths_nm : tuple of float, optional
        One a channel, where the channels are (or stand for) wavelengths.
    peak : Peak, optional
        A highlight too narrow for the cells, on a finer grid about the mirror direction. The cells hold its
        light too; evaluation and sampling take it from here.
    ledger : mapping of str to float
        Where the energy went: paths, reflected, transmitted, absorbed, killed, lost (in units of
        incident energy, mean over channels), and "absorbed: <what>", whose sum is absorbed.
    provenance : mapping
        What was measured and how; any JSON: specimen text, seed, versions, command, estimator,
        batches, seconds, surface statistics.
    parts : mapping of str to Table
        Light of one kind each, on the same grid and channels: "transmission" (what left below: theta_r is
        then the angle from -z, delta phi = pi is straight through, row_albedo the transmittance) and, by
        number of bounces, "L1", "L2", ..., "L<K>+", which add up to this table. Parts have parts of their
        own; names and access are in `gonio.table.parts`.

    Raises
    ------
    InputError
        A shape, a range or a NaN; the message names the field, what was found and what is expected.
    """

    values: Array
    theta_i: Array
    theta_r_edges: Array
    delta_phi_edges: Array
    channels: tuple[str, ...]
    row_albedo: Array
    theta_i_edges: Array | None = None
    std_error: Array | None = None
    hits: NDArray[np.int64] | None = None
    gaps: NDArray[np.bool_] | None = None
    albedo_std_error: Array = field(default_factory=lambda: np.zeros(()))
    specular: Array = field(default_factory=lambda: np.zeros(()))
    specular_std_error: Array = field(default_factory=lambda: np.zeros(()))
    wavelengths_nm: tuple[float, ...] | None = None
    peak: Peak | None = None
    ledger: Mapping[str, float] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    parts: Mapping[str, Table] = field(default_factory=dict)

    def __post_init__(self) -> None:
        shape = np.shape(self.values)
        if len(shape) != 4 or 0 in shape:
            raise InputError(f"values: shape {shape}; (theta_i, theta_r, delta_phi, channel) is expected")
        rows, rings, sectors, channels = shape
        expected = {
            "values": shape,
            "std_error": shape,
            "hits": shape[:3],
            "gaps": shape[:3],
            "theta_i": (rows,),
            "theta_i_edges": (rows + 1,),
            "theta_r_edges": (rings + 1,),
            "delta_phi_edges": (sectors + 1,),
            "row_albedo": (rows, channels),
            "albedo_std_error": (rows, channels),
            "specular": (rows, channels),
            "specular_std_error": (rows, channels),
        }
        check_arrays(self, expected, {"hits": np.int64, "gaps": np.bool_})
        check_channels(self, channels)
        self._check_axis("theta_r_edges", 0.0, np.pi / 2)
        self._check_axis("delta_phi_edges", 0.0, np.pi)
        self._check_rows()
        if self.peak is not None and self.peak.values.shape[::3] != (rows, channels):
            raise InputError(
                f"peak/values: shape {self.peak.values.shape}; {rows} rows and {channels} channels are expected"
            )
        check_parts(self, _SHARED)

    def _check_axis(self, name: str, first: float, last: float) -> None:
        edges = getattr(self, name)
        if not np.all(np.diff(edges) > 0) or abs(edges[0] - first) > 1e-9 or abs(edges[-1] - last) > 1e-9:
            raise InputError(
                f"{name}: must increase from {first} to {last:.9f} radians, found {edges[0]} to {edges[-1]}"
            )

    def _check_rows(self) -> None:
        for name, angles in (("theta_i", self.theta_i), ("theta_i_edges", self.theta_i_edges)):
            if angles is None:
                continue
            inside = angles[0] >= 0 and angles[-1] <= np.pi / 2 + 1e-9
            if not (np.all(np.diff(angles) > 0) and inside):
                raise InputError(
                    f"{name}: must increase within 0 to pi/2 radians, found {angles[0]} to {angles[-1]}"
                )

    @property
    def theta_r(self) -> Array:
        """Middle of each ring of cells, radians, shape (R,)."""
        return 0.5 * (self.theta_r_edges[1:] + self.theta_r_edges[:-1])

    @property
    def delta_phi(self) -> Array:
        """Middle of each sector of cells, radians, shape (P,)."""
        return 0.5 * (self.delta_phi_edges[1:] + self.delta_phi_edges[:-1])

    @property
    def projected_solid_angles(self) -> Array:
        """Projected solid angle of each cell, both signs of delta phi, sr, shape (R, P); sums to pi."""
        return projected_solid_angles(self.theta_r_edges, self.delta_phi_edges)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Any:
        """Read a table from a file of any format known by its suffix; see `gonio.formats`.

        Returns
        -------
        Table or AnisotropicTable
            The latter from an .h5 that holds one.

        Raises
        ------
        InputError
            The file is missing, of an unknown format, damaged or not a table; the message says which.
        """
        from gonio import formats  # the formats are built on this class

        return formats.read_any(path)

    @cached_property
    def pool(self) -> Pool:
        """The table laid out for the kernels of `gonio.table.interpolation`, as table 0 of a pool."""
        return pool_tables([self])

    def _pools(self) -> tuple[Pool, None]:
        return self.pool, None

    def albedo(self, theta_i: ArrayLike) -> Array:
        """Directional-hemispherical reflectance, delta term included, interpolated between the rows.

        Parameters
        ----------
        theta_i : array_like, shape (...)
            Radians.

        Returns
        -------
        ndarray, shape (..., C)
        """
        cos_i = np.cos(np.asarray(theta_i, float))
        albedo = np.empty((cos_i.size, len(self.channels)))
        specular = np.empty_like(albedo)
        many.row_quantities_many(self.pool, 0, cos_i.ravel(), albedo, specular)
        return (albedo + specular).reshape(*cos_i.shape, -1)
