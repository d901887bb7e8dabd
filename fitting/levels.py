"""How many quadrature nodes each cell needs for its average."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitting.moments import BLOCK, QUADRATIC, Cells, averages, new_scratch, touching
from fitting.problem import Problem
from gonio.core.jit import kernel
from gonio.core.parallel import for_each

Array = NDArray[np.float64]

_CHUNKS = 32
_POINTS = 2_500_000  # most quadrature points of a look at all cells
_NEGLIGIBLE = 1e-10  # of the objective of a model that is 0
_UNNOTICED = 1e-2  # of chi^2: a tenth of a standard error
_MANY = 100_000  # cells; of more only one in a block is looked at
_BLOCK = np.array([1, 1, 2], np.int32)  # powers of 2, by axis: shifts are faster than divisions
_NEIGHBOUR = 0.25  # of a neighbouring block's error is the least expected


def refine(problem: Problem, x: Array, coefficients: Array) -> None:
    """Give every cell of a problem the nodes it needs at these parameters.

    A cell goes to the next level where the two differ; the largest weighted differences come first, until
    what is left is negligible or half of the points still to be had are used. Of a large table all cells about
    the mirror direction are looked at first, and one in every block elsewhere.
    """
    grid = problem.samples.grid
    if grid.rows.shape[0] == 1:
        return
    levels = problem.cells.levels
    tolerance = _NEGLIGIBLE * problem.norm
    if problem.objective.name == "chi2":
        tolerance = max(tolerance, _UNNOTICED)
    dimensions = 2 if grid.exact_rows else 3
    points = len(levels)
    chosen = np.arange(len(levels))
    for level in (1, 2, 3, 4):
        each = 2 ** (dimensions * level)
        affordable = (_POINTS - points) // (2 * each)
        if level > 1:  # sorted: the rest could not be afforded
            chosen = chosen[:affordable]
        if affordable <= 0 or len(chosen) == 0:
            break
        if level == 1 and len(chosen) > _MANY:
            error = _sketched(problem, x, coefficients)
        else:
            error = _change(problem, x, coefficients, chosen, level)
        chosen = chosen[_worst(error, tolerance, affordable)]
        levels[chosen] = level
        points += each * len(chosen)


def _worst(error: Array, tolerance: float, most: int) -> NDArray[np.intp]:
    """Those without which the sum of the rest is below the tolerance, the largest first; `most` at most."""
    if len(error) > most:  # only the largest need to be in order
        largest = np.argpartition(error, len(error) - most)[len(error) - most :]
    else:
        largest = np.arange(len(error))
    order = largest[np.argsort(error[largest])[::-1]]
    left = error.sum() - np.concatenate([[0.0], np.cumsum(error[order])[:-1]])
    return order[: int(np.count_nonzero(left > tolerance))]


def _sketched(problem: Problem, x: Array, coefficients: Array) -> Array:
    """The change from level 0 to 1 of all cells: of one in a block taken for the others, if they are smooth."""
    cells: NDArray[np.int32] = problem.cells.cells
    within = cells.T & ((1 << _BLOCK) - 1)[:, None]
    first = (within[0] | within[1] | within[2]) == 0
    mirror = problem.samples.grid.near_mirror(cells)
    seen = np.flatnonzero(first | mirror)
    change = _change(problem, x, coefficients, seen, 1)
    block = tuple((cells.T >> _BLOCK[:, None]) + 1)
    error = np.zeros([int(axis.max()) + 2 for axis in block])  # a margin, for the neighbours
    error[tuple(axis[seen[first[seen]]] for axis in block)] = change[first[seen]]
    for axis in range(3):
        near = np.maximum(np.roll(error, 1, axis), np.roll(error, -1, axis))
        error = np.maximum(error, _NEIGHBOUR * near)
    out = error[block]
    out[seen[mirror[seen]]] = change[mirror[seen]]
    return out


def _change(problem: Problem, x: Array, coefficients: Array, chosen: NDArray[np.intp], level: int) -> Array:
    """What each cell's average at `level` differs from that at the level below, squared and weighted."""
    shapes = problem.shapes(x)
    back = problem.coefficients.feedback(shapes.packed)
    factors = problem.coefficients.factors(coefficients, back)
    cells: Cells = problem.cells
    out = np.empty(len(chosen))

    def task(chunk: int) -> None:
        part = slice(chunk * len(chosen) // _CHUNKS, (chunk + 1) * len(chosen) // _CHUNKS)
        _changes(
            *shapes,
            *cells.nodes,
            cells.exact_rows,
            cells.cells,
            cells.values,
            cells.weights,
            cells.cos_i,
            factors,
            problem.objective.difference,
            problem.objective.scale,
            chosen[part],
            level,
            out[part],
        )

    for_each(task, _CHUNKS)
    return out


@kernel
def _changes(
    kinds, counts, packed, tangents, rows, rings, sectors, exact_rows, cells, values, weights, cos_i, factors,
    difference, scale, chosen, level, out,
):  # fmt: skip
    terms, channels = factors.shape
    coarse, fine, scratch = np.empty((BLOCK, terms)), np.empty((BLOCK, terms)), new_scratch(tangents)
    lower, upper = np.full(BLOCK, level - 1, np.int8), np.full(BLOCK, level, np.int8)
    for m in range(len(chosen)):
        at = m % BLOCK
        if at == 0:
            some = cells[chosen[m : m + BLOCK]]
            averages(
                kinds, counts, packed, tangents, rows, rings, sectors, exact_rows, some, lower, False, scratch,
                coarse,
            )  # fmt: skip
            averages(
                kinds, counts, packed, tangents, rows, rings, sectors, exact_rows, some, upper, False, scratch,
                fine,
            )  # fmt: skip
        n, before, v = chosen[m], coarse[at], fine[at]
        out[m] = 0.0
        for channel in range(channels):
            low, high = 0.0, 0.0
            for t in range(terms):
                low += factors[t, channel] * before[t]
                high += factors[t, channel] * v[t]
            w = weights[n, 0 if weights.shape[1] == 1 else channel]
            if difference != QUADRATIC:
                _, w, _ = touching(difference, scale, values[n, channel], high, cos_i[n], w)
            out[m] += w * (high - low) ** 2
