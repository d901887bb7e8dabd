"""The anisotropic BRDF table: one more axis, and cells that move with the highlight."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.core.directions import direction
from gonio.table import many
from gonio.table.anisotropic_pool import AnisotropicPool, pool_anisotropic
from gonio.table.brdf_table import BRDFTable, check_arrays, check_channels, check_parts
from gonio.table.tilts import slope_widths, tilt_measures
from microgeometry.errors import InputError

Array = NDArray[np.float64]

_AXES = ("theta_i", "phi_i", "tilt_x_edges", "tilt_y_edges", "channels", "wavelengths_nm")


@dataclass(frozen=True, eq=False)
class AnisotropicTable(BRDFTable):
    """A BRDF over (theta_i, phi_i) and the outgoing hemisphere, with its error bars. Immutable.

    Rows are exact directions of incidence: theta_i against the normal, phi_i from the specimen's x axis. The
    outgoing directions of each are cut into cells of equal tilts of the half vector along x and y
    (`gonio.table.tilts`), as fine as the surface's slopes are narrow. A highlight, however narrow, stays in the same
    cells from row to row, so some hundred rows of some thousand cells hold what 262 million cells of one degree
    would, and what cells of one degree would not.

    Parameters
    ----------
    energy : ndarray of float32, shape (T, P, X, Y, C)
        Of the light of a row, the fraction that leaves into each cell, the delta term apart. It sums to the
        albedo; over the cell's projected solid angle (`brdf`) it is the mean BRDF.
    theta_i : ndarray, shape (T,)
        Radians, increasing, from 0 to below pi/2.
    phi_i : ndarray, shape (P,)
        Radians, evenly around from 0.
    tilt_x_edges, tilt_y_edges : ndarray, shapes (X + 1,) and (Y + 1,)
        Radians, increasing from -pi/2 to pi/2.
    channels : tuple of str
        Names of the C channels.
    row_albedo : ndarray, shape (T, P, C)
        Directional-hemispherical reflectance of each row, delta term included.
    std_error : ndarray of float32, shape (T, P, X, Y, C), optional
        Standard error of `energy`. None: unknown.
    albedo_std_error, specular, specular_std_error : ndarray, shape (T, P, C), optional
        As in `gonio.table.table.Table`. Default zeros.
    wavelengths_nm, ledger, provenance, parts
        As in `gonio.table.table.Table`; in the part "transmission" directions are turned up at the plane, so
        that straight through is where the mirror direction is.

    Raises
    ------
    InputError
        A shape, a range or a NaN; the message names the field, what was found and what is expected.
    """

    energy: NDArray[np.float32]
    theta_i: Array
    phi_i: Array
    tilt_x_edges: Array
    tilt_y_edges: Array
    channels: tuple[str, ...]
    row_albedo: Array
    std_error: NDArray[np.float32] | None = None
    albedo_std_error: Array = field(default_factory=lambda: np.zeros(()))
    specular: Array = field(default_factory=lambda: np.zeros(()))
    specular_std_error: Array = field(default_factory=lambda: np.zeros(()))
    wavelengths_nm: tuple[float, ...] | None = None
    ledger: Mapping[str, float] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    parts: Mapping[str, AnisotropicTable] = field(default_factory=dict)

    def __post_init__(self) -> None:
        shape = np.shape(self.energy)
        if len(shape) != 5 or 0 in shape:
            raise InputError(f"energy: shape {shape}; (theta_i, phi_i, tilt_x, tilt_y, channel) is expected")
        n_theta, n_phi, n_x, n_y, channels = shape
        rows = (n_theta, n_phi, channels)
        expected = {
            "energy": shape, "std_error": shape, "theta_i": (n_theta,), "phi_i": (n_phi,),
            "tilt_x_edges": (n_x + 1,), "tilt_y_edges": (n_y + 1,), "row_albedo": rows,
            "albedo_std_error": rows, "specular": rows, "specular_std_error": rows,
        }  # fmt: skip
        check_arrays(self, expected, {"energy": np.float32, "std_error": np.float32})
        check_channels(self, channels)
        self._check_axes()
        check_parts(self, _AXES)

    def _check_axes(self) -> None:
        theta, phi = self.theta_i, self.phi_i
        if not (np.all(np.diff(theta) > 0) and theta[0] >= 0 and theta[-1] < np.pi / 2):
            raise InputError(
                f"theta_i: must increase within 0 to below pi/2 radians, found {theta[0]} to {theta[-1]}"
            )
        if not np.allclose(phi, 2 * np.pi / len(phi) * np.arange(len(phi)), rtol=0, atol=1e-9):
            raise InputError(f"phi_i: must be {len(phi)} angles evenly around from 0, radians")
        for name in ("tilt_x_edges", "tilt_y_edges"):
            edges = getattr(self, name)
            ends = abs(edges[0] + np.pi / 2) < 1e-9 and abs(edges[-1] - np.pi / 2) < 1e-9
            if not (ends and np.all(np.diff(edges) > 0)):
                raise InputError(
                    f"{name}: must increase from -pi/2 to pi/2 radians, found {edges[0]} to {edges[-1]}"
                )

    @property
    def nbytes(self) -> int:
        """Bytes of the cells' values and errors, without parts."""
        return self.energy.nbytes + (0 if self.std_error is None else self.std_error.nbytes)

    @cached_property
    def pool(self) -> AnisotropicPool:
        """The table laid out for the kernels of `gonio.table.anisotropic_interpolation`, as table 0 of a pool."""
        return pool_anisotropic([self])

    def cells(self, theta: int, phi: int) -> tuple[Array, Array]:
        """Directions to the middle of each cell of a row, and the cells' projected solid angles.

        Returns
        -------
        wo : ndarray, shape (X, Y, 3)
        areas : ndarray, shape (X, Y)
            sr, by quadrature; they sum to pi.
        """
        wi = direction(self.theta_i[theta], self.phi_i[phi])
        return tilt_measures(wi, self.tilt_x_edges, self.tilt_y_edges)

    def brdf(self, theta: int, phi: int) -> Array:
        """Mean BRDF of the cells of a row, 1/sr, shape (X, Y, C)."""
        return self.energy[theta, phi] / self.cells(theta, phi)[1][..., None]

    def _pools(self) -> tuple[None, AnisotropicPool]:
        return None, self.pool

    def albedo(self, theta_i: ArrayLike, phi_i: ArrayLike) -> Array:
        """Directional-hemispherical reflectance, delta term included, interpolated between the rows.

        Parameters
        ----------
        theta_i, phi_i : array_like, shape (...)
            Radians.

        Returns
        -------
        ndarray, shape (..., C)
        """
        albedo, specular = self._row_quantities(theta_i, phi_i)
        return albedo + specular

    def directional_specular(self, theta_i: ArrayLike, phi_i: ArrayLike) -> Array:
        """Reflectance into exactly the mirror direction; as `albedo`."""
        return self._row_quantities(theta_i, phi_i)[1]

    def _row_quantities(self, theta_i: ArrayLike, phi_i: ArrayLike) -> tuple[Array, Array]:
        wi = direction(theta_i, phi_i)
        flat_wi = np.ascontiguousarray(wi.reshape(-1, 3))
        albedo = np.empty((len(flat_wi), len(self.channels)))
        specular = np.empty_like(albedo)
        many.row_quantities_anisotropic_many(self.pool, 0, flat_wi, albedo, specular)
        shape = (*wi.shape[:-1], -1)
        return albedo.reshape(shape), specular.reshape(shape)


def tabulate_brdf(
    brdf: Callable[[Array, Array], Array],
    theta_i: ArrayLike,
    n_phi: int,
    tilt_x_edges: Array,
    tilt_y_edges: Array,
    channels: Sequence[str],
    finer: int = 1,
) -> AnisotropicTable:
    """Tabulate a function of two directions.

    Parameters
    ----------
    brdf : callable
        ``brdf(wi, wo)``, directions of shape (N, 3) in the specimen's frame: f_r in 1/sr, shape (N, C).
    theta_i : array_like, shape (T,)
        Radians.
    n_phi : int
        P, azimuths evenly around.
    tilt_x_edges, tilt_y_edges : ndarray
        See `gonio.table.tilts.tilt_edges`.
    channels : sequence of str
    finer : int
        Intervals along each side of a cell, in each of which the function is taken once.
    """
    theta: Array = np.asarray(theta_i, float)
    phi: Array = 2.0 * np.pi / n_phi * np.arange(n_phi, dtype=np.float64)
    x, y = (_refined(edges, finer) for edges in (tilt_x_edges, tilt_y_edges))
    widths = slope_widths(tilt_x_edges, tilt_y_edges)
    n_x, n_y = len(tilt_x_edges) - 1, len(tilt_y_edges) - 1
    energy = np.empty((len(theta), n_phi, n_x, n_y, len(channels)), np.float32)
    for a in range(len(theta)):
        for b in range(n_phi):
            wi = direction(theta[a], phi[b])
            wo, areas = tilt_measures(wi, x, y, widths)
            values = brdf(np.broadcast_to(wi, (areas.size, 3)), wo.reshape(-1, 3)) * areas.reshape(-1, 1)
            energy[a, b] = values.reshape(n_x, finer, n_y, finer, -1).sum(axis=(1, 3))
    return AnisotropicTable(
        energy, theta, phi, tilt_x_edges, tilt_y_edges, tuple(channels), energy.astype(float).sum(axis=(2, 3))
    )


def _refined(edges: Array, finer: int) -> Array:
    """Edges with so many intervals in place of each."""
    inside = edges[:-1, None] + np.diff(edges)[:, None] * np.arange(finer) / finer
    return np.append(inside.ravel(), edges[-1])
