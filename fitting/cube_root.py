"""The cube root, at half the price of the C library's."""

from __future__ import annotations

import numpy as np

from gonio.core.jit import kernel

_LEAST, _MOST = 1e-290, 1e300  # beyond, subnormal numbers have other bits, and sums overflow
# two thirds of the exponent's bias, moved to where the error of the start is the same, 3 %, either way
_BITS = 0x2A9F7893782DA1CE


@kernel(allocates=False)
def cube_root(x):
    """The real cube root, within 1e-14: a third of the number's bits, then Halley's step twice."""
    if not _LEAST < x < _MOST:
        return np.cbrt(x)
    root = np.int64(np.float64(x).view(np.int64) // 3 + _BITS).view(np.float64)
    for _ in range(2):
        cube = root * root * root
        root *= (cube + 2.0 * x) / (2.0 * cube + x)
    return root
