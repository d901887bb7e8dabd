"""Compression by an adaptive tree of blocks (tensor tree), each with a cosine transform of its own.

The array of equal importance (`gonio.table.compress.frame`) is cut into blocks of up to 96 x 96 x 192 cells
(theta_i, theta_r, delta phi; all channels together) by halving its axes. A block is either a leaf, its cosine
transform quantised, or is halved along every axis into children. Which is cheaper is decided from the smallest
blocks up by Lagrange's cost: squared error + lambda x bits, lambda in proportion to the step squared as the theory
of uniform quantisers has it (Sullivan & Wiegand 1998, "Rate-distortion optimization for video compression").
So a peak costs what it holds, wherever it is, and smooth parts of the table next to nothing.

An odd number of cells is halved into two that differ by one: a block filled up with cells that are not in the table
would pay for them, a third more bytes in tables of 90 x 90 x 180. First is stored which blocks are leaves, then the
leaves, both level by level, the largest blocks first, and in a level those of one shape together. The transform is
orthonormal, the error of the coefficients that of the values.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from gonio.core.jit import kernel
from gonio.formats.hdf5_content import stored_bytes
from gonio.table.compress.arithmetic import Decoder, Encoder
from gonio.table.compress.frame import Frame, shape_of
from gonio.table.compress.metric import excess
from gonio.table.compress.packing import step_of
from gonio.table.compress.search import Excess, hold, suit_most
from gonio.table.table import Table

Array = NDArray[np.float64]
Block = tuple[int, ...]

_LARGEST: Block = (96, 96, 192)
_LAMBDA = 0.12  # times step^2: 2 ln 2/12 for fine quantisers
_ROUND = 0.4  # a coefficient is rounded up from 0.6 on: most just below are noise, and 0 is cheap
_BITS_ZERO, _BITS_SIGN = 0.15, 3.5  # rough cost of a 0, and of place and sign of another number
_KNOWN = 64


class Group(NamedTuple):
    """Blocks of one level and one shape."""

    block: Block
    at: tuple[NDArray[np.int64], ...]
    """Which of the level's blocks, along each axis."""
    cells: tuple[NDArray[np.int64], ...]
    """Their cells along each axis, shape (blocks, cells of a block)."""


class Level(NamedTuple):
    """All blocks of a table that was halved as many times."""

    grid: Block
    """Number of blocks along each axis."""
    groups: list[Group]


def encode(table: Table, bounds: Array, quick: bool = False, base: Array | None = None) -> dict[str, Any]:
    """As `gonio.table.compress.dct.encode`; of the values less `base`, where it is given."""
    frame = Frame.of_table(table, bounds, base)
    return encode_values(frame, table.values, partial(excess, table, bounds=bounds), quick)


def encode_values(frame: Frame, values: Array, over: Excess, quick: bool = False) -> dict[str, Any]:
    """Compress values in a frame, with errors over what is allowed as `search.hold` wants them."""
    shape = values.shape
    levels = levels_of(shape)

    def prepare(frame: Frame) -> Callable[[float], Array]:
        coefficients = _transform(frame.normalise(values), levels)
        return lambda step: frame.values(_assemble(shape, levels, *_choose(levels, coefficients, step), step))

    step = hold(frame, over, prepare, quick)
    packed = [_pack(values, levels, frame, step)]
    if not quick and (other := suit_most(frame, over, prepare, step)) is not None:
        packed.append(_pack(values, levels, *other))
    return min(packed, key=stored_bytes)


def _pack(values: Array, levels: list[Level], frame: Frame, step: float) -> dict[str, Any]:
    kept, leaves = _choose(levels, _transform(frame.normalise(values), levels), step)
    decoded = frame.values(_assemble(values.shape, levels, kept, leaves, step))
    encoder = Encoder()
    alive = np.ones(levels[0].grid, bool)
    for here, child in zip(kept, levels[1:], strict=False):
        encoder.flags(~here[alive][None])
        alive = _children(alive & ~here, child.grid)
    for level, of_groups in zip(levels, leaves, strict=True):
        for group, numbers in zip(level.groups, of_groups, strict=True):
            encoder.blocks(numbers.reshape(-1, *group.block, values.shape[3]))
    return {**frame.content(step, decoded), "tree": encoder.bytes()}


def decode(content: Mapping[str, Any], fields: Mapping[str, Any], base: Array | None = None) -> Array:
    """As `gonio.table.compress.dct.decode`; `base` as in `encode`."""
    return decode_values(content, Frame.read_table(content, fields, base), shape_of(fields))


def decode_values(content: Mapping[str, Any], frame: Frame, shape: tuple[int, int, int, int]) -> Array:
    """The inverse of `encode_values`; raises as `gonio.table.compress.dct.decode`."""
    step = step_of(content)
    levels = levels_of(shape)
    decoder = Decoder(content["tree"])
    kept = []
    alive = np.ones(levels[0].grid, bool)
    for child in levels[1:]:
        here = alive.copy()
        here[alive] = ~decoder.flags((1, int(alive.sum())))[0]
        kept.append(here)
        alive = _children(alive & ~here, child.grid)
    kept.append(alive)
    leaves = [
        [decoder.blocks((int(here[np.ix_(*g.at)].sum()), *g.block, shape[3])) for g in level.groups]
        for level, here in zip(levels, kept, strict=True)
    ]
    decoder.end()
    return frame.correct(frame.values(_assemble(shape, levels, kept, leaves, step)))


def levels_of(shape: tuple[int, ...]) -> list[Level]:
    """Levels from the largest blocks to the smallest, whose longest side is 2 to 4 cells."""
    cells = np.array(shape[:3])
    most = np.log2(cells).astype(int)  # an axis is halved until one cell is left
    first = int(max(0, *np.ceil(np.log2(cells / _LARGEST))))
    levels = []
    for halvings in range(first, max(first + 1, int(most.max()))):
        axes = [_pieces(n, min(halvings, k)) for n, k in zip(cells.tolist(), most.tolist(), strict=True)]
        groups = [
            Group(
                tuple(p.shape[1] for _, p in piece), tuple(at for at, _ in piece), tuple(p for _, p in piece)
            )
            for piece in product(*axes)
        ]
        levels.append(Level(tuple(1 << min(halvings, k) for k in most.tolist()), groups))
    return levels


def _pieces(n: int, halvings: int) -> list[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Cells 0 to n halved again and again: of each size which pieces have it, and their cells, shape (pieces, size)."""
    cuts = (np.arange((1 << halvings) + 1) * n) >> halvings
    sizes = np.diff(cuts)
    found = []
    for size in np.unique(sizes)[::-1]:
        at = np.flatnonzero(sizes == size)
        found.append((at, cuts[at][:, None] + np.arange(size)))
    return found


def _places(group: Group) -> tuple[NDArray[np.int64], ...]:
    """Index of all cells of a group's blocks: (blocks along i, r, phi, cells along i, r, phi)."""
    i, r, p = group.cells
    return i[:, None, None, :, None, None], r[None, :, None, None, :, None], p[None, None, :, None, None, :]


def _transform(array: Array, levels: list[Level]) -> list[list[NDArray[np.float32]]]:
    """Cosine transforms of all blocks of all groups: (blocks along i, r, phi, coefficients)."""
    single = array.astype(np.float32)
    found = []
    for level in levels:
        of_groups = []
        for group in level.groups:
            cells = single[_places(group)]
            coefficients = fft.dctn(cells, axes=(3, 4, 5, 6), norm="ortho", workers=-1, overwrite_x=True)
            of_groups.append(coefficients.reshape(*cells.shape[:3], -1))
        found.append(of_groups)
    return found


def _choose(
    levels: list[Level], coefficients: list[list[NDArray[np.float32]]], step: float
) -> tuple[list[NDArray[np.bool_]], list[list[NDArray[np.int32]]]]:
    """The cheapest tree: which blocks of each level are leaves, and those of each group, shape (n, coefficients)."""
    keeps: list[NDArray[np.bool_]] = []
    below: NDArray | None = None
    for level, of_groups in zip(reversed(levels), reversed(coefficients), strict=True):
        cost = np.empty(level.grid)
        for group, numbers in zip(level.groups, of_groups, strict=True):
            costs = np.empty(int(np.prod(numbers.shape[:3])))
            _costs(numbers.reshape(len(costs), -1), 1.0 / step, _BIT_TABLE, costs)
            cost[np.ix_(*group.at)] = costs.reshape(numbers.shape[:3])
        if below is None:
            keep, below = np.ones(level.grid, bool), cost
        else:
            a, b, c = (n // m for n, m in zip(below.shape, level.grid, strict=True))
            i, r, p = level.grid
            children = below.reshape(i, a, r, b, p, c).sum(axis=(1, 3, 5)) + _LAMBDA
            keep = cost <= children
            below = np.where(keep, cost, children)
        keeps.append(keep)
    kept: list[NDArray[np.bool_]] = []
    leaves = []
    alive = np.ones(levels[0].grid, bool)
    for at, (level, keep) in enumerate(zip(levels, reversed(keeps), strict=True)):
        if at:
            alive = _children(alive & ~kept[-1], level.grid)
        kept.append(alive & keep)
        quantised = []
        for group, numbers in zip(level.groups, coefficients[at], strict=True):
            scaled = numbers[kept[-1][np.ix_(*group.at)]] / step
            quantised.append((np.sign(scaled) * np.floor(np.abs(scaled) + _ROUND)).astype(np.int32))
        leaves.append(quantised)
    return kept, leaves


def _assemble(
    shape: tuple[int, ...],
    levels: list[Level],
    kept: list[NDArray[np.bool_]],
    leaves: list[list[NDArray[np.int32]]],
    step: float,
) -> Array:
    """The array from its leaves."""
    array = np.zeros(shape)
    for level, here, of_groups in zip(levels, kept, leaves, strict=True):
        for group, leaf in zip(level.groups, of_groups, strict=True):
            if len(leaf) == 0:
                continue
            coefficients = (leaf * step).reshape(-1, *group.block, shape[3])
            cells = fft.idctn(coefficients, axes=(1, 2, 3, 4), norm="ortho", workers=-1, overwrite_x=True)
            # of each leaf its block along every axis, and of that the cells
            i, r, p = (of[n] for of, n in zip(group.cells, here[np.ix_(*group.at)].nonzero(), strict=True))
            array[i[:, :, None, None], r[:, None, :, None], p[:, None, None, :]] = cells
    return array


def _children(blocks: NDArray[np.bool_], grid: Block) -> NDArray[np.bool_]:
    """Mark all children of the marked blocks, on their own grid."""
    for axis, n in enumerate(grid):
        blocks = np.repeat(blocks, n // blocks.shape[axis], axis)
    return blocks


_BIT_TABLE = np.array([_BITS_ZERO] + [1.5 * np.log2(1 + n) + _BITS_SIGN for n in range(1, _KNOWN)])


@kernel(allocates=False)
def _costs(coefficients, inverse, bits, cost):
    """Lagrange's cost of each block, in units of step^2."""
    last = bits.shape[0] - 1
    for n in range(coefficients.shape[0]):
        total = 0.0
        for k in range(coefficients.shape[1]):
            x = abs(coefficients[n, k] * inverse)
            q = int(x + _ROUND)
            total += (x - q) * (x - q) + _LAMBDA * bits[min(q, last)]
        cost[n] = total
