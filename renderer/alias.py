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
    heights = scaled.tolist()  # plain numbers: a loop that runs once a scene is not worth compiling
    threshold, other = np.ones(len(heights), np.float32), np.arange(len(heights), dtype=np.int32)
    small = np.flatnonzero(scaled < 1).tolist()
    large = iter(np.flatnonzero(scaled >= 1).tolist())
    tall = next(large, None)
    # fill every column that is too short from one that is too tall
    while small and tall is not None:
        short = small.pop()
        threshold[short] = heights[short]
        other[short] = tall
        heights[tall] -= 1.0 - heights[short]
        if heights[tall] < 1.0:
            small.append(tall)
            tall = next(large, None)
    return threshold, other


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
