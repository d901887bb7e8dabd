"""The alias method: draw from a discrete distribution with one number and one look-up (Vose 1991)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.core.jit import kernel


def alias_table(weights: ArrayLike) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Tables for `draw`.

    Parameters
    ----------
    weights : array_like, shape (N,)
        Not negative; need not sum to one. All zero: every index is as likely.

    Returns
    -------
    threshold : ndarray of float32, shape (N,)
        Chance to keep the column drawn.
    other : ndarray of int32, shape (N,)
        What to take instead.
    """
    scaled = np.array(weights, np.float64)
    total = scaled.sum()
    scaled = scaled * (len(scaled) / total) if total > 0 else np.ones(len(scaled))
    threshold = np.ones(len(scaled), np.float32)
    other = np.arange(len(scaled), dtype=np.int32)
    small, large = np.flatnonzero(scaled < 1).astype(np.int32), np.flatnonzero(scaled >= 1).astype(np.int32)
    _pair(scaled, small, large, threshold, other)
    return threshold, other


@kernel
def _pair(scaled, small, large, threshold, other):
    """Fill every column that is too short from one that is too long."""
    stack = np.empty(len(scaled), np.int32)
    stack[: len(small)] = small
    n_small, i_large = len(small), 0
    while n_small > 0 and i_large < len(large):
        n_small -= 1
        short, tall = stack[n_small], large[i_large]
        threshold[short] = scaled[short]
        other[short] = tall
        scaled[tall] -= 1.0 - scaled[short]
        if scaled[tall] < 1.0:
            i_large += 1
            stack[n_small] = tall
            n_small += 1


@kernel(allocates=False)
def draw(threshold, other, first, count, u):
    """Index within [first, first + count) of tables laid end to end, from one uniform number.

    `other` counts from `first`.
    """
    x = u * count
    column = min(int(x), count - 1)
    if x - column < threshold[first + column]:
        return first + column
    return first + other[first + column]
