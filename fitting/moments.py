"""The compiled loop of the fit: over all cells, once, whatever the number of parameters.

A vector v is made for every cell: the averages over the cell of the model's terms, and of their derivatives
by the shape parameters. What an objective, its gradient and its Gauss-Newton matrix hold of the table are
sums over cells of w v v', w v r and w r^2 with the residual r, so these are all that is kept: no row of a
Jacobian is ever stored, and nothing is copied. The residual is formed cell by cell, at coefficients that are
given, so that nothing cancels where a fit is all but perfect.

v holds the terms of all lobes first, then for every parameter the derivatives of its own lobe's terms.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.cube_root import cube_root
from fitting.models.dispatch import SIDE, lobe_side, lobe_slopes, lobe_terms_of_sides
from gonio.core.jit import kernel
from gonio.core.parallel import for_each

Array = NDArray[np.float64]

QUADRATIC, LOG, ABSOLUTE_LOG, CUBE_ROOT = range(4)
"""Which difference is measured: f - g; of ln(1 + f cos_i), squared or its modulus; of (f cos_i)^(1/3)."""

BLOCK = 64
"""Cells whose vectors are made at once."""

_SIDE = SIDE
_CHUNK = 2000  # cells at least
_CHUNKS = 32  # at most; a function of the number of cells only, so that sums do not depend on the threads


class Shapes(NamedTuple):
    """Lobes as the kernel takes them.

    kinds, shape (L,); counts, shape (L, 2), numbers of terms and of parameters; packed, shape (L, SIZE);
    tangents, shape (L, parameters, SIZE), see `Lobe.tangents`.
    """

    kinds: NDArray[np.int64]
    counts: NDArray[np.int64]
    packed: Array
    tangents: Array


class Cells(NamedTuple):
    """Cells and what was measured there.

    nodes, three arrays of shape (levels, n, nodes, 3), of rows, rings and sectors; exact_rows; cells, shape
    (N, 3); levels, shape (N,), see `fitting.grid`; values, shape (N, C); weights, shape (N, C), or (N, 1)
    where all channels weigh the same; cos_i, shape (N,).
    """

    nodes: tuple[Array, Array, Array]
    exact_rows: bool
    cells: NDArray[np.int32]
    levels: NDArray[np.int8]
    values: Array
    weights: Array
    cos_i: Array

    def part(self, chosen: slice) -> tuple[Any, ...]:
        """Some of the cells, as arguments of the compiled loops."""
        each = (self.cells, self.levels, self.values, self.weights, self.cos_i)
        return (*self.nodes, self.exact_rows, *(array[chosen] for array in each))


class Moments(NamedTuple):
    """Sums over cells: objective, shape (C,); right, w v r, shape (C, V); gram, w v v', shape (C, V, V).

    Of a difference that is not quadratic w and r are those of the quadratic that touches it: of the same
    slope, and of the curvature of its Gauss-Newton matrix.
    """

    objective: Array
    right: Array
    gram: Array


def moments(
    shapes: Shapes, cells: Cells, factors: Array, difference: int, scale: float, slopes: bool
) -> Moments:
    """All sums at given shapes and coefficients.

    Parameters
    ----------
    shapes : Shapes
    cells : Cells
    factors : ndarray, shape (T, C)
        Of every term.
    difference : int
        QUADRATIC, LOG, ABSOLUTE_LOG or CUBE_ROOT.
    scale : float
        Where a modulus is rounded off; below which a cube root's slope no longer grows.
    slopes : bool
        Whether v holds the derivatives.

    Returns
    -------
    Moments
    """
    n, channels = cells.values.shape
    size = int(shapes.counts[:, 0].sum())
    if slopes:
        size += int((shapes.counts[:, 0] * shapes.counts[:, 1]).sum())
    grams = cells.weights.shape[1] if difference == QUADRATIC else channels
    chunks = max(1, min(_CHUNKS, n // _CHUNK))

    def task(chunk: int) -> tuple[Array, Array, Array]:
        part = slice(chunk * n // chunks, (chunk + 1) * n // chunks)
        sums: tuple[Array, Array, Array] = _moments(
            *shapes, *cells.part(part), factors, difference, scale, slopes, size, grams
        )
        return sums

    objective, right, lower = (np.sum(parts, axis=0) for parts in zip(*for_each(task, chunks), strict=True))
    full = lower + np.swapaxes(np.tril(lower, -1), 1, 2)
    return Moments(objective, right, np.broadcast_to(full, (channels, size, size)))


@kernel
def new_scratch(tangents):
    """For `averages`: the derivatives of a lobe; then for every lobe two rows, cos theta and `lobe_side` of each."""
    lobes, parameters = tangents.shape[:2]
    return np.full((1 + 2 * lobes, max(2 * parameters, 1 + _SIDE)), np.nan)


@kernel(allocates=False)
def averages(
    kinds, counts, packed, tangents, rows, rings, sectors, exact_rows, cells, levels, slopes, scratch, out
):  # fmt: skip
    """The vectors v of some cells, into rows of `out`; a call for each would cost as much as what it does.

    `scratch` is of `new_scratch`, for these lobes, and remembers the last cell's; `slopes`: derivatives as well.
    """
    first_slope = 0
    for k in range(len(kinds)):
        first_slope += counts[k, 0]
    for n in range(len(cells)):
        i, r, s, level = cells[n, 0], cells[n, 1], cells[n, 2], np.int64(levels[n])
        nodes = 1 << level
        row_nodes = 1 if exact_rows else nodes
        for k in range(out.shape[1]):
            out[n, k] = 0.0
        for a in range(row_nodes):
            wi = (rows[level, i, a, 0], 0.0, rows[level, i, a, 1])
            for b in range(nodes):
                sine, cosine = rings[level, r, b, 0], rings[level, r, b, 1]
                weight = rows[level, i, a, 2] * rings[level, r, b, 2]
                for c in range(nodes):
                    wo = (sine * sectors[level, s, c, 1], sine * sectors[level, s, c, 0], cosine)
                    w = weight * sectors[level, s, c, 2]
                    term, slope = 0, first_slope
                    for k in range(len(kinds)):
                        side_i, side_o = scratch[1 + 2 * k], scratch[2 + 2 * k]
                        # cells side by side in delta phi have these in common
                        if side_i[0] != wi[2]:
                            side_i[0] = wi[2]
                            lobe_side(kinds[k], packed[k], tangents[k], wi, side_i[1:])
                        if side_o[0] != wo[2]:
                            side_o[0] = wo[2]
                            lobe_side(kinds[k], packed[k], tangents[k], wo, side_o[1:])
                        values = lobe_terms_of_sides(kinds[k], packed[k], wi, wo, side_i[1:], side_o[1:])
                        out[n, term] += w * values[0]
                        if counts[k, 0] == 2:
                            out[n, term + 1] += w * values[1]
                        term += counts[k, 0]
                        if not slopes or counts[k, 1] == 0:
                            continue
                        if values[0] == 0.0 and values[1] == 0.0:  # nothing here, nor near here
                            slope += counts[k, 0] * counts[k, 1]
                            continue
                        lobe_slopes(
                            kinds[k], packed[k], tangents[k], wi, wo, values, side_i[1:], side_o[1:], scratch[0]
                        )  # fmt: skip
                        for j in range(counts[k, 1]):
                            out[n, slope] += w * scratch[0, 2 * j]
                            if counts[k, 0] == 2:
                                out[n, slope + 1] += w * scratch[0, 2 * j + 1]
                            slope += counts[k, 0]


@kernel
def _moments(
    kinds, counts, packed, tangents, rows, rings, sectors, exact_rows, cells, levels, values, weights, cos_i,
    factors, difference, scale, slopes, size, grams,
):  # fmt: skip
    """The sums over some cells, of `gram` lower triangles.

    In arrays of its own: threads that write side by side in memory wait for each other, at twice the time.
    """
    terms, channels = factors.shape[0], values.shape[1]
    block, scratch = np.empty((BLOCK, size)), new_scratch(tangents)
    objective, right, gram = np.zeros(channels), np.zeros((channels, size)), np.zeros((grams, size, size))
    shared = weights.shape[1] == 1
    for n in range(len(cells)):
        at = n % BLOCK
        if at == 0:
            averages(
                kinds, counts, packed, tangents, rows, rings, sectors, exact_rows, cells[n : n + BLOCK],
                levels[n : n + BLOCK], slopes, scratch, block,
            )  # fmt: skip
        v = block[at]
        for channel in range(channels):
            model = 0.0
            for t in range(terms):
                model += factors[t, channel] * v[t]
            w = weights[n, 0 if shared else channel]
            r = values[n, channel] - model
            if difference == QUADRATIC:
                objective[channel] += w * r * r
            else:
                value, w, r = touching(difference, scale, values[n, channel], model, cos_i[n], w)
                objective[channel] += value
            wr = w * r
            for j in range(size):
                right[channel, j] += wr * v[j]
            if channel < grams:
                for j in range(size):
                    wv = w * v[j]
                    for k in range(j + 1):
                        gram[channel, j, k] += wv * v[k]
    return objective, right, gram


@kernel(allocates=False)
def touching(difference, scale, measured, model, cos_i, weight):
    """The objective of one value, and weight and residual of the quadratic that touches it there.

    For a difference d = h(f) - h(g): w d^2 has the slope -2 w h' d and the Gauss-Newton curvature
    2 w h'^2, as w h'^2 (d/h' - (g' - g))^2 has; the modulus of d is sqrt(d^2 + scale^2), of slope d/sqrt,
    and of the curvature by which iteratively re-weighted least squares never step too far.
    """
    # noise and interpolation leave values just below 0, where the logarithm and the root mean nothing
    f, g = max(0.0, measured * cos_i), max(0.0, model * cos_i)
    if difference == CUBE_ROOT:
        root = cube_root(max(g, scale))
        d = cube_root(f) - cube_root(g)
        slope = cos_i / (3.0 * root * root)
        return weight * d * d, weight * slope * slope, d / slope
    d = math.log1p(f) - math.log1p(g)
    slope = cos_i / (1.0 + g)
    if difference == LOG:
        return weight * d * d, weight * slope * slope, d / slope
    modulus = math.sqrt(d * d + scale * scale)
    return weight * modulus, 0.5 * weight * slope * slope / modulus, d / slope
