"""A binned table averaged with itself, light and detector exchanged: f(i, o) = f(o, i).

Where rows are cells on the rings' grid, the cell that two such sums belong to is the same, and paths of one row tell as
much of it as those of the other. Both are pooled as one sum of weights over one sum of exposures (paths of the row x
projected solid angle of the ring), never by inverse variances, which of few paths go with the values. That is done only
where the table passes the chi^2 test of reciprocity (`gonio.table.checks`), and the table says so.

It also does for the pole what merging its cells would, and without a model of f there: the ring theta_r in [0, 1]
degree has a 57th of the projected solid angle of that at 45 degrees, but the cells its own are pooled with lie on the
latter, in the row of the pole. (Tables by half vectors and next-event estimates need neither: their cells do not
wait for paths.)

The two errors add up as those of independent sums do, but for what the rows of a batch have in common: the realisation
of a random surface. How much that is shows in how much closer the two values are than their errors say.
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
        Binned.
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
    values, std_error, hits = table.values.copy(), np.array(table.std_error), np.array(table.hits)
    exposure = paths[:, None] * np.diff(np.sin(table.theta_r_edges) ** 2)
    common = _common(table)
    for row in range(len(values)):
        here, there = (row, slice(row + 1, None)), (slice(row + 1, None), row)
        own, other = (exposure[place][:, None, None] for place in (here, there))
        mean = (own * values[here] + other * values[there]) / (own + other)
        one, two = std_error[here] ** 2, std_error[there] ** 2
        found, found_there = ((hits[place] > 0)[..., None] for place in (here, there))
        # an empty cell errs by what its partner says is to be expected in it; two of them have one bound
        one, two = (
            np.where(found_there & ~found, two * other / own, one),
            np.where(found & ~found_there, one * own / other, two),
        )
        shared = 2.0 * common[row, row + 1 :, None, :] * np.sqrt(one * two) * own * other
        error = np.sqrt(own**2 * one + other**2 * two + shared) / (own + other)
        bound = 1.0 / (1.0 / std_error[here] + 1.0 / std_error[there])
        error = np.where(found | found_there, error, bound)
        for place in (here, there):
            values[place], std_error[place] = mean, error
        hits[here] = hits[there] = hits[here] + hits[there]
    light = np.einsum("irpc,rp->ic", values, table.projected_solid_angles)
    counted = table.row_albedo - table.specular
    values *= np.where(light != 0, counted / np.where(light != 0, light, 1.0), 1.0)[:, None, None, :]
    return table.replace(values=values, std_error=std_error, hits=hits)


def _common(table: Table) -> Array:
    """Correlation of f(i, o) and f(o, i), shape (I, R, 1).

    1 less the mean square of their difference in units of its error.
    """
    assert table.std_error is not None
    assert table.hits is not None
    sums = np.zeros((2, *table.values.shape[:2], 1))
    for row in range(len(table.values)):
        asked = table.hits[row] + table.hits[:, row] >= _FEWEST
        variance = table.std_error[row] ** 2 + table.std_error[:, row] ** 2
        z2 = (table.values[row] - table.values[:, row]) ** 2 / variance
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
