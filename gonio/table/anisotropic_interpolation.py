r"""Evaluating and sampling anisotropic tables: scalar kernels on a pool of tables.

Directions are tuples in the specimen's frame, `wi` to the light and `wo` to the detector, both away from the
surface and of unit length; x is the specimen's x, from which phi_i counts. Values and densities are as in
`gonio.table.interpolation`.

The interpolant
---------------
Light of one bounce off facets is f = F D G / (4 cos theta_i cos theta_o), and D, where all that is narrow stands,
depends on the half vector alone. So what is interpolated is

    q = f cos(theta_i) cos(theta_o) / G,

G the shadowing of a surface with the slopes that the cells are made for (`gonio.table.anisotropic_pool.shadowing`):
q is finite and smooth up to the horizon, and need not know the true shadowing, only its course. Within a row
(theta_i, phi_i) it is bilinear in the tilts (x, y) of the half vector (`gonio.table.tilts`), constant beyond the
outermost nodes; a node's value is the cell's energy over the integral of G / (cos theta_i cos theta_o) over the cell.
Between the four rows around `wi` it is linear in theta_i and phi_i, each row taken at the same half vector: highlights
stay in line however far apart the rows are. By this half vector a row sends light to a cos theta_o of its own, and
what is near its horizon, or beyond, is known better from the others: rows count in proportion to this cosine as well.
Each row and channel is multiplied so that it re-integrates to what the table states, by quadrature over quarters of
cells; between rows the integral follows the albedo as closely as the rows stand.

Samples are drawn row by row: one of the four in proportion to its weight times its energy, then (x, y) from the
channel mean's energy per dx dy, piecewise bilinear as well, as in `gonio.table.interpolation` 3 and 4. The density
is exactly that of the mixture, and integrates to 1; the weight f cos(theta_o) / pdf is the albedo but for what the
interpolations of g and of the energy differ by.
"""

from __future__ import annotations

import math

from gonio.core.jit import kernel
from gonio.table.anisotropic_pool import (
    A_AXES,
    A_CHANNELS,
    A_MARGINAL,
    A_MEAN,
    A_PHI,
    A_ROWS,
    A_THETA,
    A_VALUES,
    A_X,
    A_Y,
    ROW,
    shadowing,
)
from gonio.table.inverse import draw, draw_between
from gonio.table.tilts import from_tilts, to_tilts


@kernel(allocates=False)
def _enclosing(axes, first, count, x):
    """Node at or below `x` of `count` nodes, and how far `x` is to the next as a fraction, 0 to 1."""
    low = 0
    high = count - 1
    while high - low > 1:
        middle = (low + high) // 2
        if axes[first + middle] <= x:
            low = middle
        else:
            high = middle
    left = axes[first + low]
    return low, min(1.0, max(0.0, (x - left) / (axes[first + low + 1] - left)))


@kernel(allocates=False)
def _rows(pool, t, wi):
    """The first of the two theta_i and the weight of the second; the two phi_i and the weight of the second."""
    header = pool.header
    n_theta, n_phi = header[t, A_THETA], header[t, A_PHI]
    across = math.sqrt(wi[0] * wi[0] + wi[1] * wi[1])
    a, s = 0, 0.0
    if n_theta > 1:
        a, s = _enclosing(pool.axes, header[t, A_AXES], n_theta, math.atan2(across, wi[2]))
    turn = math.atan2(wi[1], wi[0]) / (2.0 * math.pi) * n_phi if across > 0.0 else 0.0
    if turn < 0.0:
        turn += n_phi
    b = min(int(turn), n_phi - 1)
    return a, s, b, (b + 1) % n_phi, min(1.0, turn - b)


@kernel(allocates=False)
def _row(n_phi, n_theta, a, b, c, which):
    """Number of the row that is corner `which` (0 to 3) of those around."""
    up = a + 1 if which >= 2 and a + 1 < n_theta else a
    return up * n_phi + (c if which % 2 else b)


@kernel(allocates=False)
def _weight(s, r, which):
    """Its weight."""
    return (s if which >= 2 else 1.0 - s) * (r if which % 2 else 1.0 - r)


@kernel(allocates=False)
def _point(pool, t, x, y):
    """Node and fraction in x, node and fraction in y."""
    header = pool.header
    axis = header[t, A_AXES] + header[t, A_THETA]
    j, u = _enclosing(pool.axes, axis, header[t, A_X], x)
    k, v = _enclosing(pool.axes, axis + header[t, A_X], header[t, A_Y], y)
    return j, u, k, v


@kernel(allocates=False)
def eval_anisotropic(pool, t, wi, wo, out):
    """BRDF of table `t`, without its delta term.

    Parameters
    ----------
    pool : AnisotropicPool
    t : int
        Which table of the pool.
    wi, wo : direction
    out : ndarray, shape (C,)
        Receives f_r in 1/sr per channel; 0 where a direction is below the horizon.
    """
    header = pool.header
    n = header[t, A_CHANNELS]
    for channel in range(n):
        out[channel] = 0.0
    if wi[2] < 0.0 or wo[2] < 0.0:
        return
    hx, hy, hz = wi[0] + wo[0], wi[1] + wo[1], wi[2] + wo[2]
    square = hx * hx + hy * hy + hz * hz
    if square == 0.0:
        return
    a, s, b, c, r = _rows(pool, t, wi)
    widths = pool.widths[t, 0], pool.widths[t, 1]
    n_x, n_y = header[t, A_X], header[t, A_Y]
    line = n_y * n
    values = pool.values
    total = 0.0
    for which in range(4):
        weight = _weight(s, r, which)
        if weight == 0.0:
            continue
        row = _row(header[t, A_PHI], header[t, A_THETA], a, b, c, which)
        first = header[t, A_ROWS] + row * (ROW + 3 * n)
        i = pool.rows[first + 1], pool.rows[first + 2], pool.rows[first + 3]
        double = 2.0 * (i[0] * hx + i[1] * hy + i[2] * hz) / square
        o = double * hx - i[0], double * hy - i[1], double * hz - i[2]
        if o[2] <= 0.0:
            continue
        weight *= o[2]
        total += weight
        x, y, _ = to_tilts(i, o, widths)
        j, u, k, v = _point(pool, t, x, y)
        p = header[t, A_VALUES] + ((row * n_x + j) * n_y + k) * n
        for channel in range(n):
            low = (1.0 - v) * values[p + channel] + v * values[p + n + channel]
            high = (1.0 - v) * values[p + line + channel] + v * values[p + line + n + channel]
            out[channel] += weight * pool.rows[first + ROW + channel] * ((1.0 - u) * low + u * high)
    scale = shadowing(wi, wo, widths) / total if total > 0.0 else 0.0
    for channel in range(n):
        out[channel] *= scale


@kernel(allocates=False)
def _row_energy(pool, t, row):
    """Integral of the channel mean that samples of one row are drawn from."""
    return pool.rows[pool.header[t, A_ROWS] + row * (ROW + 3 * pool.header[t, A_CHANNELS])]


@kernel(allocates=False)
def pdf_anisotropic(pool, t, wi, wo):
    """Density per solid angle with which `sample_anisotropic` draws `wo`.

    0 below the horizon, and everywhere where nothing is reflected.
    """
    if wi[2] < 0.0 or wo[2] <= 0.0:
        return 0.0
    header = pool.header
    x, y, density = to_tilts(wi, wo, (pool.widths[t, 0], pool.widths[t, 1]))
    j, u, k, v = _point(pool, t, x, y)
    a, s, b, c, r = _rows(pool, t, wi)
    n_x, n_y = header[t, A_X], header[t, A_Y]
    energy = 0.0
    total = 0.0
    mean = pool.mean
    for which in range(4):
        weight = _weight(s, r, which)
        if weight == 0.0:
            continue
        row = _row(header[t, A_PHI], header[t, A_THETA], a, b, c, which)
        total += weight * _row_energy(pool, t, row)
        p = header[t, A_MEAN] + 2 * ((row * n_x + j) * n_y + k)
        low = (1.0 - v) * mean[p] + v * mean[p + 2]
        p += 2 * n_y
        high = (1.0 - v) * mean[p] + v * mean[p + 2]
        energy += weight * ((1.0 - u) * low + u * high)
    if total <= 0.0:
        return 0.0
    return energy * density / total


@kernel(allocates=False)
def sample_anisotropic(pool, t, wi, u0, u1, u2):
    """Draw `wo` about in proportion to the channel mean of f cos(theta_o), without the delta term.

    Parameters
    ----------
    pool : AnisotropicPool
    t : int
        Which table of the pool.
    wi : direction
    u0, u1, u2 : float
        Uniform in [0, 1): u0 for the tilt along x, u1 for that along y, u2 for the row.

    Returns
    -------
    wo : direction
    pdf : float
        Per solid angle; 0 where nothing is reflected (`wo` is then the normal, and to be discarded).
    """
    header = pool.header
    a, s, b, c, r = _rows(pool, t, wi)
    total = 0.0
    for which in range(4):
        row = _row(header[t, A_PHI], header[t, A_THETA], a, b, c, which)
        total += _weight(s, r, which) * _row_energy(pool, t, row)
    if wi[2] < 0.0 or total <= 0.0:
        return (0.0, 0.0, 1.0), 0.0
    left = u2 * total
    chosen = -1
    for which in range(4):
        row = _row(header[t, A_PHI], header[t, A_THETA], a, b, c, which)
        share = _weight(s, r, which) * _row_energy(pool, t, row)
        if share > 0.0:
            chosen = row
            if left < share:
                break
        left -= share
    n_x, n_y = header[t, A_X], header[t, A_Y]
    axis_x = header[t, A_AXES] + header[t, A_THETA]
    axis_y = axis_x + n_x
    axes = pool.axes
    j, u = draw(pool.marginal, header[t, A_MARGINAL] + 2 * chosen * n_x, n_x, axes, axis_x, u0)
    inner = header[t, A_MEAN] + 2 * (chosen * n_x + j) * n_y
    k, v = draw_between(pool.mean, inner, inner + 2 * n_y, n_y, u, axes, axis_y, u1)
    x = (1.0 - u) * axes[axis_x + j] + u * axes[axis_x + j + 1]
    y = (1.0 - v) * axes[axis_y + k] + v * axes[axis_y + k + 1]
    wo = from_tilts(wi, x, y, (pool.widths[t, 0], pool.widths[t, 1]))
    return wo, pdf_anisotropic(pool, t, wi, wo)


@kernel(allocates=False)
def row_quantities_anisotropic(pool, t, wi, albedo, specular):
    """Reflectance without the delta term, and the delta term, each of shape (C,), linear between the rows."""
    header = pool.header
    n = header[t, A_CHANNELS]
    for channel in range(n):
        albedo[channel] = 0.0
        specular[channel] = 0.0
    a, s, b, c, r = _rows(pool, t, wi)
    for which in range(4):
        weight = _weight(s, r, which)
        row = _row(header[t, A_PHI], header[t, A_THETA], a, b, c, which)
        first = header[t, A_ROWS] + row * (ROW + 3 * n) + ROW + n
        for channel in range(n):
            albedo[channel] += weight * pool.rows[first + channel]
            specular[channel] += weight * pool.rows[first + n + channel]
