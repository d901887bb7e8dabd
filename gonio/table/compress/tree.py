"""Compression by an adaptive tree of blocks (tensor tree), each with a cosine transform of its own.

The array of equal importance (`gonio.table.compress.frame`) is cut into blocks of up to 32 x 32 x 64 cells
(theta_i, theta_r, delta phi; all channels together). A block is either a leaf, its cosine transform quantised,
or is halved along every axis into children. Which is cheaper is decided from the smallest blocks up by
Lagrange's cost: squared error + lambda x bits, lambda in proportion to the step squared as the theory of
uniform quantisers has it (Sullivan & Wiegand 1998, "Rate-distortion optimization for video compression").
So a peak costs what it holds, wherever it is, and smooth parts of the table next to nothing.

Leaves are stored level by level, the largest blocks first. The transform is orthonormal, the error of the
coefficients that of the values.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from gonio.core.jit import kernel
from gonio.table.compress.arithmetic import Decoder, Encoder
from gonio.table.compress.frame import Frame, hold, shape_of
from gonio.table.compress.packing import step_of
from gonio.table.table import Table

Array = NDArray[np.float64]
Block = tuple[int, int, int]

_LARGEST: Block = (32, 32, 64)
_LAMBDA = 0.12  # times step^2: 2 ln 2/12 for fine quantisers
_ROUND = 0.4  # a coefficient is rounded up from 0.6 on: most just below are noise, and 0 is cheap
_BITS_ZERO, _BITS_SIGN = 0.15, 3.5  # rough cost of a 0, and of place and sign of another number
_KNOWN = 64


class Level(NamedTuple):
    """All blocks of one size."""

    block: Block
    coefficients: NDArray[np.float32]
    """(blocks along i, r, phi, cells of a block x channels)."""


def encode(table: Table, bounds: Array, quick: bool = False, base: Array | None = None) -> dict[str, Any]:
    """As `gonio.table.compress.dct.encode`; of the values less `base`, where it is given."""
    shape = table.values.shape

    def prepare(frame: Frame) -> Callable[[float], Array]:
        levels = _levels(frame.normalise(table.values))
        return lambda step: frame.restore(_assemble(shape, *_choose(levels, step), step))

    frame, step = hold(table, bounds, prepare, quick, base)
    leaves, splits = _choose(_levels(frame.normalise(table.values)), step)
    encoder = Encoder()
    for block, leaf, split in zip(block_sizes(shape), leaves, [*splits, None], strict=True):
        if split is not None:
            encoder.flags(split[None])
        encoder.blocks(leaf.reshape(-1, *block, shape[3]))
    return {"step": step, **frame.content(), "tree": encoder.bytes()}


def decode(content: Mapping[str, Any], fields: Mapping[str, Any], base: Array | None = None) -> Array:
    """As `gonio.table.compress.dct.decode`; `base` as in `encode`."""
    shape = shape_of(fields)
    frame, step = Frame.read(content, fields, base), step_of(content)
    sizes = block_sizes(shape)
    decoder = Decoder(content["tree"])
    leaves, splits, n = [], [], int(np.prod(_grid(shape, sizes[0])))
    for block, child in zip(sizes, [*sizes[1:], None], strict=True):
        split = np.zeros(n, bool) if child is None else decoder.flags((1, n))[0]
        count = n - int(split.sum())
        leaves.append(
            decoder.blocks((count, *block, shape[3])).reshape(count, int(np.prod(block)) * shape[3])
        )
        if child is not None:
            splits.append(split)
            n = int(split.sum()) * int(np.prod(_ratio(block, child)))
    decoder.end()
    return frame.restore(_assemble(shape, leaves, splits, step))


def block_sizes(shape: tuple[int, ...]) -> list[Block]:
    """Sizes of blocks from the largest to the smallest, whose longest side is 2."""
    top = tuple(min(most, 1 << int(np.ceil(np.log2(n)))) for most, n in zip(_LARGEST, shape[:3], strict=True))
    halvings = max(1, int(np.log2(max(top))))
    return [(max(1, top[0] >> k), max(1, top[1] >> k), max(1, top[2] >> k)) for k in range(halvings)]


def _grid(shape: tuple[int, ...], block: Block) -> Block:
    """Number of blocks along each axis, all of the largest ones filled up."""
    top = block_sizes(shape)[0]
    i, r, p = (-(-n // most) * (most // b) for n, most, b in zip(shape, top, block, strict=False))
    return i, r, p


def _ratio(block: Block, child: Block) -> Block:
    """Children along each axis."""
    return block[0] // child[0], block[1] // child[1], block[2] // child[2]


def _levels(array: Array) -> list[Level]:
    """Cosine transforms of all blocks of all sizes."""
    shape = array.shape
    top = block_sizes(shape)[0]
    padding = [(0, -n % most) for n, most in zip(shape, top, strict=False)]
    padded = np.pad(array, [*padding, (0, 0)], mode="edge").astype(np.float32)
    levels = []
    for block in block_sizes(shape):
        grid, channels = _grid(shape, block), shape[3]
        cut = padded.reshape(grid[0], block[0], grid[1], block[1], grid[2], block[2], channels)
        cells = cut.transpose(0, 2, 4, 1, 3, 5, 6)
        coefficients = fft.dctn(cells, axes=(3, 4, 5, 6), norm="ortho", workers=-1).reshape(*grid, -1)
        levels.append(Level(block, coefficients))
    return levels


def _choose(levels: list[Level], step: float) -> tuple[list[NDArray], list[NDArray[np.bool_]]]:
    """The cheapest tree: leaves of each level, shape (n, coefficients), and which nodes of it are split."""
    keeps: list[NDArray[np.bool_]] = []
    below: NDArray | None = None
    for at in range(len(levels) - 1, -1, -1):
        level = levels[at]
        grid = level.coefficients.shape[:3]
        flat = level.coefficients.reshape(-1, level.coefficients.shape[3])
        costs = np.empty(len(flat))
        _costs(flat, 1.0 / step, _BIT_TABLE, costs)
        cost = costs.reshape(grid)
        if below is None:
            keep, below = np.ones(grid, bool), cost
        else:
            a, b, c = _ratio(level.block, levels[at + 1].block)
            children = below.reshape(grid[0], a, grid[1], b, grid[2], c).sum(axis=(1, 3, 5)) + _LAMBDA
            keep = cost <= children
            below = np.where(keep, cost, children)
        keeps.append(keep)
    leaves, splits = [], []
    alive = np.ones(levels[0].coefficients.shape[:3], bool)
    for at, (level, keep) in enumerate(zip(levels, reversed(keeps), strict=True)):
        scaled = level.coefficients[alive & keep] / step
        leaves.append((np.sign(scaled) * np.floor(np.abs(scaled) + _ROUND)).astype(np.int32))
        if at + 1 < len(levels):
            splits.append(~keep[alive])
            alive = _children(alive & ~keep, _ratio(level.block, levels[at + 1].block))
    return leaves, splits


def _assemble(
    shape: tuple[int, ...], leaves: list[NDArray], splits: list[NDArray[np.bool_]], step: float
) -> Array:
    """The array from its leaves."""
    sizes = block_sizes(shape)
    grid = _grid(shape, sizes[0])
    padded = np.zeros([n * b for n, b in zip(grid, sizes[0], strict=True)] + [shape[3]])
    alive = np.ones(grid, bool)
    for at, (block, leaf) in enumerate(zip(sizes, leaves, strict=True)):
        here = alive.copy()
        if at < len(splits):
            here[alive] = ~splits[at]
        if len(leaf):
            coefficients = (leaf * step).reshape(-1, *block, shape[3])
            cells = fft.idctn(coefficients, axes=(1, 2, 3, 4), norm="ortho", workers=-1)
            grid = here.shape
            view = padded.reshape(grid[0], block[0], grid[1], block[1], grid[2], block[2], shape[3])
            view.transpose(0, 2, 4, 1, 3, 5, 6)[here] = cells
        if at + 1 < len(sizes):
            alive = _children(alive & ~here, _ratio(block, sizes[at + 1]))
    return padded[: shape[0], : shape[1], : shape[2]]


def _children(nodes: NDArray[np.bool_], ratio: Block) -> NDArray[np.bool_]:
    """Mark all children of the marked nodes."""
    for axis, n in enumerate(ratio):
        nodes = np.repeat(nodes, n, axis)
    return nodes


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
