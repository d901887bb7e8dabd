"""Compiled loops about cells: averages of a model's terms, pooling of variances.

Cells are triples (row, ring, sector) into three small tables of quadrature nodes (see `fitting.grid`),
so no direction is stored per cell and nothing is copied per evaluation. A table of nodes has the shape
(levels, n, nodes, 3): sine, cosine and weight; level l has the first 2**l nodes in use.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitting.moments import averages, new_scratch
from gonio.core.jit import kernel
from gonio.core.parallel import for_each

CHUNKS = 32  # fixed, so that sums do not depend on the number of threads


def cell_terms(
    kinds: NDArray, shapes: NDArray, nodes: tuple, cells: NDArray, levels: NDArray, exact_rows: bool
) -> NDArray[np.float64]:
    """Averages of the terms over many cells.

    Parameters
    ----------
    kinds : ndarray of int64, shape (L,)
    shapes : ndarray, shape (L, SIZE)
    nodes : tuple of three ndarrays, shape (levels, n, nodes, 3)
        Of rows, rings and sectors.
    cells : ndarray of int32, shape (N, 3)
    levels : ndarray of int8, shape (N,)
    exact_rows : bool
        Rows are single angles: one node whatever the level.

    Returns
    -------
    ndarray, shape (N, 2 L)
        1/sr.
    """
    n, lobes = len(cells), len(kinds)
    out = np.empty((n, 2 * lobes))
    counts = np.tile(np.array([2, 0]), (lobes, 1))  # both terms of each lobe, no derivatives
    tangents = np.empty((lobes, 0, shapes.shape[1]))

    def task(chunk: int) -> None:
        part = slice(chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS)
        _cell_terms(kinds, counts, shapes, tangents, *nodes, exact_rows, cells[part], levels[part], out[part])

    for_each(task, CHUNKS)
    return out


@kernel
def _cell_terms(kinds, counts, shapes, tangents, rows, rings, sectors, exact_rows, cells, levels, out):
    averages(
        kinds, counts, shapes, tangents, rows, rings, sectors, exact_rows, cells, levels, False,
        new_scratch(tangents), out,
    )  # fmt: skip


@kernel
def pooled_variance(values, variance, counts, usable, areas, least):
    """Variances of one row's cells, smoothed over blocks that hold enough hits.

    A variance estimated from the cell's own few hits is low where the value happens to be low, so
    weights made of it pull a fit down by about one hit per cell. Here a cell's variance comes from the
    cells of the other colour of a chessboard within its block: as large on average, but independent of
    what this cell happened to count.

    Parameters
    ----------
    values : ndarray, shape (R, P, C)
    variance : ndarray, shape (R, P, C)
        Their squared standard errors.
    counts : ndarray, shape (R, P)
        Hits.
    usable : ndarray of bool, shape (R, P)
        Cells that were measured.
    areas : ndarray, shape (R, P)
        Projected solid angles: a value's variance goes as value / area.
    least : float
        Blocks are halved, along the longer side first, while both halves hold this many hits.

    Returns
    -------
    ndarray, shape (R, P, C)
        0 where a block has no hits at all.
    """
    rings, sectors, channels = variance.shape
    sums = np.zeros((rings + 1, sectors + 1))
    for r in range(rings):
        for s in range(sectors):
            own = counts[r, s] if usable[r, s] else 0.0
            sums[r + 1, s + 1] = sums[r, s + 1] + sums[r + 1, s] - sums[r, s] + own
    out = np.zeros((rings, sectors, channels))
    stack = [(0, rings, 0, sectors)]
    while len(stack) > 0:
        block = stack.pop()
        r0, r1, s0, s1 = block
        by_rings = (r0, (r0 + r1) // 2, s0, s1), ((r0 + r1) // 2, r1, s0, s1)
        by_sectors = (r0, r1, s0, (s0 + s1) // 2), (r0, r1, (s0 + s1) // 2, s1)
        tall = (r1 - r0) * 2 >= s1 - s0  # sectors span twice the angle
        first, second = by_rings if tall else by_sectors
        if min(_hits(sums, first), _hits(sums, second)) < least:
            first, second = by_sectors if tall else by_rings
        if min(_hits(sums, first), _hits(sums, second)) >= least:
            stack.append(first)
            stack.append(second)
        else:
            _smooth_block(values, variance, usable, areas, r0, r1, s0, s1, out)
    return out


@kernel
def _hits(sums, block):
    """Hits in a block, from the table of sums."""
    r0, r1, s0, s1 = block
    return sums[r1, s1] - sums[r0, s1] - sums[r1, s0] + sums[r0, s0]


@kernel
def _smooth_block(values, variance, usable, areas, r0, r1, s0, s1, out):
    """Variance x area is taken as constant over a block and estimated from each chessboard colour.

    A fit uses the inverse: of n Poisson hits E[1/(n + 1)] is 1/mean but for a share exp(-mean), so an estimate
    from n hits, or of the scatter of n equal ones, is made larger by (n + 1)/n.
    """
    for channel in range(out.shape[2]):
        squares = np.zeros(2)
        fourth = np.zeros(2)
        area = np.zeros(2)
        for r in range(r0, r1):
            for s in range(s0, s1):
                if usable[r, s]:
                    # an empty cell's error is an upper bound; its share of the variance is zero
                    v, y = variance[r, s, channel], values[r, s, channel]
                    if v > 0.0 and y != 0.0:
                        square = v * areas[r, s] ** 2
                        squares[(r + s) % 2] += square
                        fourth[(r + s) % 2] += square * square * min(1.0, v / (y * y))  # y^2/v hits
                    area[(r + s) % 2] += areas[r, s]
        for colour in range(2):
            if squares[colour] > 0.0:
                squares[colour] *= 1.0 + fourth[colour] / squares[colour] ** 2
        for r in range(r0, r1):
            for s in range(s0, s1):
                other = 1 - (r + s) % 2
                if squares[other] > 0.0:
                    out[r, s, channel] = squares[other] / area[other] / areas[r, s]
                elif squares[1 - other] > 0.0:
                    out[r, s, channel] = squares[1 - other] / area[1 - other] / areas[r, s]
