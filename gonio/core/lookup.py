"""Finding the interval of a monotone axis that holds a number, in constant time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.core.jit import kernel

_BUCKETS_PER_INTERVAL = 8


class Axis(NamedTuple):
    """Increasing edges with a table of uniform buckets: each knows the first interval that reaches into it."""

    edges: NDArray[np.float64]
    first: NDArray[np.int64]
    scale: float


def axis(edges: ArrayLike) -> Axis:
    """Prepare increasing edges, shape (n + 1,), for `find`."""
    edges = np.ascontiguousarray(edges, float)
    buckets = _BUCKETS_PER_INTERVAL * (len(edges) - 1)
    starts = np.linspace(edges[0], edges[-1], buckets + 1)
    first = np.clip(np.searchsorted(edges, starts, side="right") - 1, 0, len(edges) - 2)
    first = np.maximum(first - 1, 0)  # one back: a rounded bucket index must not overshoot
    return Axis(edges, first.astype(np.int64), buckets / float(edges[-1] - edges[0]))


@kernel(allocates=False)
def find(axis, x):
    """Index i of the interval edges[i] <= x < edges[i + 1]; the outermost intervals take what lies beyond."""
    bucket = int((x - axis.edges[0]) * axis.scale)
    bucket = max(0, min(bucket, axis.first.shape[0] - 1))
    i = axis.first[bucket]
    last = axis.edges.shape[0] - 2
    # two steps without a branch: which of them it takes is chance, and no processor guesses it
    i = min(i + (axis.edges[i + 1] <= x), last)
    i = min(i + (axis.edges[i + 1] <= x), last)
    while i < last and axis.edges[i + 1] <= x:
        i += 1
    return i
