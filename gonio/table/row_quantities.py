"""What a table knows of a row as a whole, interpolated between rows: albedo and the delta term."""

from __future__ import annotations

import math

from gonio.core.jit import kernel
from gonio.table.interpolation import locate_row
from gonio.table.pool import AXES, BENDS, N_CHANNELS, PEAK, ROWS

_ALBEDO, _SPECULAR = 1, 2  # columns of `Pool.rows`


@kernel(allocates=False)
def _row_quantity(pool, t, cos_i, column, out):
    n = pool.header[t, N_CHANNELS]
    peak = pool.header[t, PEAK]
    a, b, w = locate_row(pool, t, 1.0 - cos_i * cos_i)
    first = pool.header[t, ROWS] + 1 + column * n
    for c in range(n):
        at_a = pool.rows[first + a * (1 + 3 * n) + c]
        at_b = pool.rows[first + b * (1 + 3 * n) + c]
        out[c] = (1.0 - w) * at_a + w * at_b if cos_i >= 0.0 else 0.0
    if peak >= 0 and cos_i >= 0.0:
        first = pool.header[peak, ROWS] + 1 + column * n
        # as `gonio.table.highlight.bends_between`
        x = 1.0 - math.sqrt(1.0 - w) if pool.axes[pool.header[t, AXES] + b] >= 1.0 else w
        for c in range(n):
            at_a = pool.rows[first + a * (1 + 3 * n) + c]
            at_b = pool.rows[first + b * (1 + 3 * n) + c]
            out[c] += (1.0 - w) * at_a + w * at_b
            if column == _ALBEDO:
                bend = pool.header[peak, BENDS] + 2 * a * n + c
                out[c] += x * (1.0 - x) * (pool.bends[bend] + x * pool.bends[bend + n])


@kernel(allocates=False)
def albedo_table(pool, t, cos_i, out):
    """Directional-hemispherical reflectance without the delta term, which `eval_table` integrates to.

    Parameters
    ----------
    pool : Pool
    t : int
        Which table of the pool.
    cos_i : float
        Cosine of the angle of incidence; below 0 the reflectance is 0.
    out : ndarray, shape (C,)
        Receives the reflectance per channel.
    """
    _row_quantity(pool, t, cos_i, _ALBEDO, out)


@kernel(allocates=False)
def specular_table(pool, t, cos_i, out):
    """Reflectance into exactly the mirror direction (the delta term); arguments as `albedo_table`."""
    _row_quantity(pool, t, cos_i, _SPECULAR, out)
