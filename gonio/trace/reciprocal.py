"""A table averaged with itself, light and detector exchanged: f(i, o) = f(o, i).

Where rows are cells on the rings' grid, the cell that two such values belong to is the same, and paths of one row tell
as much of it as those of the other. Sums of binned paths are pooled as one sum of weights over one sum of exposures
(paths of the row x projected solid angle of the ring), never by inverse variances, which of few paths go with the
values. Next-event estimates have no such exposure, but a finite error in every cell: there it is the inverse of the
mean variance over the ring. All that is done only where the table passes the chi^2 test of reciprocity
(`gonio.table.checks`), and the table says so.

It also does for the pole what merging its cells would, and without a model of f there: the ring theta_r in [0, 1]
degree has a 57th of the projected solid angle of that at 45 degrees, but the cells its own are pooled with lie on the
latter, in the row of the pole. Tables by half vectors need neither: single bounces are the same both ways to begin
with, and the rest is averaged where it is counted (`gonio.trace.remainder`).

The two errors add up as those of independent sums do, but for what the rows of a batch have in common: the realisation
of a random surface, and points that serve several rows. How much that is shows in how much closer the two values are
than their errors say.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.table.checks.reciprocity import AVERAGED, check_reciprocity
from gonio.table.parts import orders_of
from gonio.table.table import Table

Array = NDArray[np.float64]

_MOST_CELLS = (
    5_000_000  # times channels: of one degree, RGB. To test a larger table takes more memory than to trace it
)
_REACH = 4  # rows and rings to either side whose pairs tell how much of their noise a pair has in common
_FEWEST = 20  # paths of a pair that is asked
_PRIOR = 200.0  # pairs of no common noise that these are counted with


def reciprocal(table: Table, paths: NDArray[np.int64]) -> Table:
    """The table averaged, where it passes the test; the same table where it does not or cannot be tested.

    Parameters
    ----------
    table : Table
        Of binned paths, or of next-event estimates, which counts no hits.
    paths : ndarray of int, shape (I,)
        Of each row.

    Returns
    -------
    Table
        Its provenance says ``reciprocity``. Rows are scaled to their albedos, which stay as counted, as do the delta
        term and what is transmitted.
    """
    if table.peak is not None or table.values.size > _MOST_CELLS:
        return table
    if table.hits is None and np.any(table.specular > 0):
        return (
            table  # below a mirror most of their error is that of the row's energy, which no other row knows
        )
    test = {check.name: check for check in check_reciprocity(table)}.get("reciprocity of cells")
    if test is None or not test.passed or not test.numbers["dof"]:
        return table
    orders = {name: _average(order, paths) for name, order in orders_of(table).items()}
    whole = _average(table, paths)
    if orders:
        whole = whole.replace(values=np.sum([order.values for order in orders.values()], axis=0))
    said = (
        f"f(i, o) and f(o, i) averaged: chi^2 of their difference {test.numbers['chi2_per_dof']:.3f} per degree of "
        f"freedom, of {test.numbers['dof']}; the two cells of a pair hold the same light, counted once"
    )
    return whole.replace(parts={**table.parts, **orders}, provenance={**table.provenance, AVERAGED: said})


def _average(table: Table, paths: NDArray[np.int64]) -> Table:
    values, std_error = table.values.copy(), np.array(table.std_error)
    hits = None
    variance = there = std_error**2
    of_albedo = np.zeros((len(values), 1))
    if table.hits is None:
        # rows were scaled to their albedos and will be again: that error is a row's own, and stays
        lit = table.row_albedo > 0
        of_albedo = np.where(lit, table.albedo_std_error, 0.0) / np.where(lit, table.row_albedo, 1.0)
        variance = np.maximum(there - (values * of_albedo[:, None, None, :]) ** 2, 0.0)
        seen = np.ones(values.shape[:3], bool)
        exposures = tuple(1.0 / np.maximum(v.mean(axis=(2, 3)), 1e-300) for v in (variance, there))
    else:
        seen = table.hits > 0
        hits = table.hits + table.hits.swapaxes(0, 1)
        itself = np.arange(len(hits))
        hits[itself, itself] = table.hits[itself, itself]
        exposures = (paths[:, None] * np.diff(np.sin(table.theta_r_edges) ** 2),) * 2
    common = _common(table)
    for row in range(len(values)):
        own, other = exposures[0][row][:, None, None], exposures[1][:, row][:, None, None]
        mean = (own * table.values[row] + other * table.values[:, row]) / (own + other)
        one, two = variance[row], there[:, row]
        found, found_there = seen[row][..., None], seen[:, row][..., None]
        # an empty cell errs by what its partner says is to be expected in it; two of them have one bound
        one, two = (
            np.where(found_there & ~found, two * other / own, one),
            np.where(found & ~found_there, one * own / other, two),
        )
        shared = 2.0 * common[row][:, None, :] * np.sqrt(one * two) * own * other
        error = np.sqrt(own**2 * one + other**2 * two + shared) / (own + other)
        bound = 1.0 / np.sum(
            [1.0 / np.sqrt(np.maximum(v, 1e-300)) for v in (variance[row], there[:, row])], axis=0
        )
        error = np.hypot(np.where(found | found_there, error, bound), mean * of_albedo[row])
        pairs = np.arange(len(mean)) != row
        values[row, pairs], std_error[row, pairs] = mean[pairs], error[pairs]
    light = np.einsum("irpc,rp->ic", values, table.projected_solid_angles)
    counted = table.row_albedo - table.specular
    values *= np.where(light != 0, counted / np.where(light != 0, light, 1.0), 1.0)[:, None, None, :]
    return table.replace(values=values, std_error=std_error, hits=hits)


def _common(table: Table) -> Array:
    """Correlation of f(i, o) and f(o, i), shape (I, R, 1).

    1 less the mean square of their difference in units of its error.
    """
    assert table.std_error is not None
    sums = np.zeros((2, *table.values.shape[:2], 1))
    for row in range(len(table.values)):
        variance = table.std_error[row] ** 2 + table.std_error[:, row] ** 2
        if table.hits is None:
            asked = np.all(variance > 0, axis=-1)
        else:
            asked = table.hits[row] + table.hits[:, row] >= _FEWEST
        z2 = (table.values[row] - table.values[:, row]) ** 2 / np.maximum(variance, 1e-300)
        sums[0, row, :, 0] = np.where(asked, z2.mean(axis=-1), 0.0).sum(axis=-1)
        sums[1, row, :, 0] = asked.sum(axis=-1)
        sums[:, row, row] = 0.0
    for axis in (1, 2):
        upto = np.cumsum(np.insert(sums, 0, 0.0, axis=axis), axis=axis)
        index = np.arange(sums.shape[axis])
        sums = np.take(upto, np.minimum(index + _REACH + 1, len(index)), axis=axis) - np.take(
            upto, np.maximum(index - _REACH, 0), axis=axis
        )
    return np.maximum(1.0 - (sums[0] + _PRIOR) / (sums[1] + _PRIOR), 0.0)
