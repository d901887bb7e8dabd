"""What a fit looks at: a table's usable cells, or single measurements, with weights and what was left out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fitting.grid import Grid
from fitting.kernels import pooled_variance
from gonio.core.parallel import for_each
from gonio.table.checks.reciprocity import AVERAGED
from gonio.table.table import Table
from microgeometry.errors import InputError

Array = NDArray[np.float64]

THETA_LIMIT_DEG = 80.0
"""Beyond it measurements are unreliable and customarily left out (Ngan et al. 2005)."""

_POOL = 400.0  # hits a block; the estimated variance is then good to 7 %, and chi^2 to 0.5 %


@dataclass(frozen=True, eq=False)
class Samples:
    """Values to be fitted.

    Parameters
    ----------
    grid : Grid
    cells : ndarray of int32, shape (N, 3)
        Row, ring and sector of each value in the grid.
    values : ndarray, shape (N, C)
        f_r in 1/sr.
    variance : ndarray, shape (N, C), or None
        Smoothed squared standard errors; None where errors are not known.
    cos_i : ndarray, shape (N,)
    sin_i, sin_o : ndarray, shape (N,)
        The sines in the metrics. For a table's cells: the mean over the cell, times its width over the
        mean width, so that uneven grids weigh as even ones.
    channels : tuple of str
    left_out : dict of str to int
        How many cells were left out, by reason.
    wavelengths_nm : tuple of float, optional
    provenance : mapping
        Of the table.
    theta_limit_deg : float
        Nothing beyond this polar angle is in here.
    estimated : bool
        The errors are a table's own, which are known to 3 % of chi^2.
    """

    grid: Grid
    cells: NDArray[np.int32]
    values: Array
    variance: Array | None
    cos_i: Array
    sin_i: Array
    sin_o: Array
    channels: tuple[str, ...]
    left_out: dict[str, int] = field(default_factory=dict)
    wavelengths_nm: tuple[float, ...] | None = None
    provenance: dict[str, Any] = field(default_factory=dict)
    theta_limit_deg: float = THETA_LIMIT_DEG
    estimated: bool = False

    @classmethod
    def of_table(cls, table: Table, theta_limit_deg: float = THETA_LIMIT_DEG) -> Samples:
        """The cells of a table whose middle lies within the limit, that were measured and carry information.

        Raises
        ------
        InputError
            The limit is not an angle from 0 to 90 degrees; or no cell is left: the message says why each was left out.
        """
        if not 0 < theta_limit_deg <= 90:
            raise InputError(
                f"theta limit: {theta_limit_deg:g}; an angle above 0, at most 90 degrees, is allowed"
            )
        limit = math.radians(theta_limit_deg) + 1e-9
        inside = (table.theta_i <= limit)[:, None, None] & (table.theta_r <= limit)[None, :, None]
        inside = np.broadcast_to(inside, table.values.shape[:3])
        gaps = np.zeros(inside.shape, bool) if table.gaps is None else table.gaps
        repeated = inside & ~gaps & _repeated(table)
        used = inside & ~gaps & ~repeated
        reasons = {
            f"theta above {theta_limit_deg:g} degrees": ~inside,
            "gap": inside & gaps,
            "repeats the cell of exchanged directions": repeated,
        }
        variance = None if table.std_error is None else _smooth(table, ~gaps)
        if variance is not None and not np.any(variance[used] > 0):
            variance = None  # errors all zero say nothing
        if variance is not None:
            known = np.all((variance > 0) & np.isfinite(variance), axis=-1)
            reasons["error not known"] = used & ~known
            used = used & known
        left_out = {reason: int(np.count_nonzero(mask)) for reason, mask in reasons.items()}
        left_out = {reason: n for reason, n in left_out.items() if n}
        if not np.any(used):
            why = ", ".join(f"{n} {reason}" for reason, n in left_out.items())
            raise InputError(
                f"table: no cell is left to fit ({why}); a fit needs measured cells: where they lie beyond, "
                "give a higher --theta-limit"
            )
        index = np.flatnonzero(used)

        def cells_of(by_axis: NDArray[Any]) -> NDArray[Any]:
            return np.broadcast_to(by_axis, used.shape)[used]

        def rows_of(by_cell: Array) -> Array:  # several times faster than a mask
            return np.take(by_cell.reshape(-1, len(table.channels)), index, axis=0)

        axes = np.ogrid[tuple(slice(0, n) for n in used.shape)]
        widths = np.diff(table.delta_phi_edges)
        cells = np.empty((len(index), 3), np.int32)

        def number(axis: int) -> None:
            cells[:, axis] = cells_of(axes[axis].astype(np.int32))

        # side by side, for most of the time goes into fresh memory
        tasks: list[Callable[[], Any]] = [
            lambda: rows_of(table.values),
            lambda: None if variance is None else rows_of(variance),
            lambda: cells_of(np.cos(table.theta_i)[:, None, None]),
            lambda: cells_of(_row_sines(table)[:, None, None]),
            lambda: cells_of(_ring_sines(table)[:, None] * (widths / widths.mean())),
            *(partial(number, axis) for axis in range(3)),
        ]
        values, variance, cos_i, sin_i, sin_o, *_ = for_each(lambda n: tasks[n](), len(tasks))
        return cls(
            grid=Grid.of_table(table),
            cells=cells,
            values=values,
            variance=variance,
            cos_i=cos_i,
            sin_i=sin_i,
            sin_o=sin_o,
            channels=table.channels,
            left_out=left_out,
            wavelengths_nm=table.wavelengths_nm,
            provenance=dict(table.provenance),
            theta_limit_deg=theta_limit_deg,
            estimated=True,
        )

    @classmethod
    def of_directions(
        cls,
        theta_i: ArrayLike,
        theta_r: ArrayLike,
        delta_phi: ArrayLike,
        values: ArrayLike,
        channels: tuple[str, ...],
        std_error: ArrayLike | None = None,
        theta_limit_deg: float = THETA_LIMIT_DEG,
    ) -> Samples:
        """Single measurements of an isotropic BRDF.

        Parameters
        ----------
        theta_i, theta_r, delta_phi : array_like, shape (N,)
            Radians; delta phi 0 is retro-reflection.
        values : array_like, shape (N, C)
            f_r in 1/sr.
        channels : tuple of str
        std_error : array_like, shape (N, C), optional
        theta_limit_deg : float
            Measurements with either polar angle above are left out.

        Raises
        ------
        InputError
            A shape, a NaN, a standard error that is not positive, or nothing left.
        """
        angles = np.stack([np.asarray(a, float).ravel() for a in (theta_i, theta_r, delta_phi)])
        f = np.asarray(values, float)
        if f.shape != (angles.shape[1], len(channels)):
            raise InputError(f"values: shape {f.shape}; {(angles.shape[1], len(channels))} is expected")
        if not (np.all(np.isfinite(angles)) and np.all(np.isfinite(f))):
            raise InputError("values or angles: contain NaN or infinity; finite numbers are expected")
        variance = None
        if std_error is not None:
            variance = np.asarray(std_error, float) ** 2
            if variance.shape != f.shape or not np.all((variance > 0) & np.isfinite(variance)):
                raise InputError(f"std_error: {f.shape} finite positive numbers are expected")
        used = np.all(angles[:2] <= math.radians(theta_limit_deg) + 1e-9, axis=0)
        if not used.any():
            raise InputError(f"values: no measurement is left below the limit of {theta_limit_deg:g} degrees")
        angles = angles[:, used]
        index = np.arange(angles.shape[1], dtype=np.int32)
        left = int(np.count_nonzero(~used))
        return cls(
            grid=Grid.of_directions(*angles),
            cells=np.stack([index] * 3, axis=1),
            values=f[used],
            variance=None if variance is None else variance[used],
            cos_i=np.cos(angles[0]),
            sin_i=np.sin(angles[0]),
            sin_o=np.sin(angles[1]),
            channels=tuple(channels),
            left_out={f"theta above {theta_limit_deg:g} degrees": left} if left else {},
            theta_limit_deg=theta_limit_deg,
        )

    def take(self, picks: NDArray[np.intp]) -> Samples:
        """Some of the samples."""
        return replace(
            self,
            cells=self.cells[picks],
            values=self.values[picks],
            variance=None if self.variance is None else self.variance[picks],
            cos_i=self.cos_i[picks],
            sin_i=self.sin_i[picks],
            sin_o=self.sin_o[picks],
        )

    def terms(self, kinds: NDArray[np.int64], shapes: Array, levels: int | NDArray[np.int8]) -> Array:
        """Cell averages of a model's terms, shape (N, 2 L)."""
        return self.grid.terms(kinds, shapes, self.cells, levels)


def _repeated(table: Table) -> NDArray[np.bool_]:
    """One cell of each pair (i, o), (o, i) that a table averaged by reciprocity holds twice, shape (I, R, 1).

    By turns that of the larger and of the smaller theta_i, so that neither half weighs more.
    """
    row, ring = np.ogrid[: len(table.theta_i), : len(table.theta_r)]
    averaged = AVERAGED in table.provenance  # see `gonio.trace.reciprocal`
    return (averaged & (row != ring) & ((row < ring) == ((row + ring) % 2 == 0)))[:, :, None]


def _smooth(table: Table, usable: NDArray[np.bool_]) -> Array:
    """Squared standard errors, smoothed row by row; see `fitting.kernels.pooled_variance`."""
    assert table.std_error is not None
    variance = np.where(np.isfinite(table.std_error), table.std_error, 0.0) ** 2
    if table.hits is not None:
        counts = table.hits.astype(float)
    else:  # the number of equal hits that would give this error
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(variance > 0, table.values**2 / variance, 0.0)
        counts = np.mean(ratio, axis=-1)
    areas = table.projected_solid_angles
    return np.stack(
        for_each(
            lambda i: pooled_variance(table.values[i], variance[i], counts[i], usable[i], areas, _POOL),
            len(variance),
        )
    )


def _row_sines(table: Table) -> Array:
    edges = table.theta_i_edges
    if edges is None:  # each angle stands for the interval to the middle of its neighbours
        middle = 0.5 * (table.theta_i[1:] + table.theta_i[:-1])
        edges = np.concatenate([[0.0], middle, [np.pi / 2]])
    return -np.diff(np.cos(edges)) / np.diff(edges).mean()


def _ring_sines(table: Table) -> Array:
    return -np.diff(np.cos(table.theta_r_edges)) / np.diff(table.theta_r_edges).mean()
