"""Drawing from densities that are linear between nodes: kernels that all tables sample by.

Nodes carry their density and the mass below them, interleaved, as `gonio.table.pool` lays them out.
"""

from __future__ import annotations

import math

from gonio.core.jit import kernel


@kernel(allocates=False)
def invert_linear(p, q, s):
    """Where on a unit segment of linear density from p to q the mass s is reached.

    Equation 5 of `gonio.table.interpolation`.
    """
    root = p + math.sqrt(max(0.0, p * p + 2.0 * (q - p) * s))
    if root <= 0.0:
        return 0.0
    return min(1.0, max(0.0, 2.0 * s / root))


@kernel(allocates=False)
def draw(density, first, n, axes, axis, uniform):
    """Node and fraction beyond it of a number drawn from one density.

    Parameters
    ----------
    density : ndarray
        From `first` on, density and mass below of `n` nodes.
    axes : ndarray
        From `axis` on, where these nodes are.
    uniform : float
        In [0, 1).
    """
    return draw_between(density, first, first, n, 0.0, axes, axis, uniform)


@kernel(allocates=False)
def draw_between(density, inner, outer, n, part, axes, axis, uniform):
    """As `draw`, from the mixture of the densities at `inner` and, `part` of it, at `outer`."""
    last = 2 * (n - 1) + 1
    target = uniform * ((1.0 - part) * density[inner + last] + part * density[outer + last])
    low = 0
    high = n - 1
    while high - low > 1:
        middle = (low + high) // 2
        at = 2 * middle + 1
        if (1.0 - part) * density[inner + at] + part * density[outer + at] <= target:
            low = middle
        else:
            high = middle
    at = 2 * low
    below = (1.0 - part) * density[inner + at + 1] + part * density[outer + at + 1]
    p = (1.0 - part) * density[inner + at] + part * density[outer + at]
    q = (1.0 - part) * density[inner + at + 2] + part * density[outer + at + 2]
    return low, invert_linear(p, q, (target - below) / (axes[axis + low + 1] - axes[axis + low]))
