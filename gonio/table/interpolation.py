r"""Evaluating and sampling tables: scalar kernels on a pool of tables.

Directions are tuples in the local frame, `wi` to the light and `wo` to the detector, both away from the
surface and of unit length. Values are f_r in 1/sr without cosine, densities are per solid angle. On or
below the horizon there is no reflection: values and densities are 0 where either direction has z < 0.

The interpolant
---------------
With u = sin^2 theta_r and phi = delta phi in [0, pi], a row's function is bilinear in (u, phi) between the
cells' centres (in u and phi), constant beyond them, and the azimuth's average at u = 0. Between rows it is
linear in v = sin^2 theta_i, constant beyond the first and last. As u and v are treated alike, a reciprocal
table of cells stays reciprocal between them.

1. The measure is flat: cos(theta) d omega = sin(theta) cos(theta) d theta d phi = 1/2 du dphi. Both signs
   of the azimuth count, so the reflectance of a row is exactly the double trapezoid sum
   A = int_0^1 int_0^pi f(u, phi) du dphi. Each row and channel is multiplied by
   (albedo - delta term)/A, hence re-integrates to what the table states.
2. The density sampled is that of the channel mean: pdf = fbar(wi, wo) cos(theta_o) / Abar(theta_i), with
   Abar(v) = (1 - w) Abar_a + w Abar_b between rows a and b. The weight f cos/pdf has the channel mean Abar,
   the same for every sample: the mean channel's noise is that of the light alone.
3. Sampling it: row a with probability (1 - w) Abar_a / Abar, else b. In the row, u from the marginal
   m(u) = int f dphi, which is piecewise linear; then phi from f(u, phi)/m(u), piecewise linear as well, its
   cumulative sum at the nodes being the blend (1 - t) M_k + t M_(k+1) of those of the two rings that enclose
   u. A fair coin gives the azimuth its sign: half the density for each, and du dphi = 2 cos d omega turns
   f/A into f cos/A. (The scheme is that of Mitsuba's Marginal2D, Dupuy & Jakob 2018, section 4.)
4. Where the table has a peak (`gonio.table.peak`), a function q of half-vector slopes, interpolated alike with
   u = (slope/extent)^2 and psi, is added: f = q / (4 w), w = `gonio.core.masking.masked_cosines`, which smooths
   what the horizon cuts off (`gonio.table.highlight`). It is drawn by another, bilinear too, of the energy
   g = 4 f cos(theta_o) (wi.h) h_z^3 in each cell; where this reaches below the horizon it is reflected at the
   plane. The weight is Abar then but for what g interpolated differs from that of q, in the cells that the horizon
   cuts. A sample is of table or peak with the probability of their shares.
5. On a segment of width h with end values p, q, the point below which lies the mass h s solves
   p t + (q - p) t^2/2 = s: t = 2 s / (p + sqrt(p^2 + 2 (q - p) s)), without cancellation.
"""

from __future__ import annotations

import math

from gonio.core.jit import kernel
from gonio.core.masking import masked_cosines
from gonio.table.inverse import draw, draw_between
from gonio.table.pool import (
    AXES,
    BUCKETS,
    MARGINAL,
    MEAN,
    N_BUCKETS,
    N_CHANNELS,
    N_PHI,
    N_ROWS,
    N_U,
    PEAK,
    ROWS,
    VALUES,
)

_PER_RADIAN = N_BUCKETS / math.pi


@kernel(allocates=False)
def _locate(axes, first, buckets, bucket, x, position):
    """Node at or below `x`, and how far `x` is to the next as a fraction; `position` is x in buckets."""
    b = min(max(int(position), 0), N_BUCKETS - 1)
    low = buckets[bucket + b]
    high = buckets[bucket + b + 1] + 1
    while high - low > 1:
        middle = (low + high) // 2
        if axes[first + middle] <= x:
            low = middle
        else:
            high = middle
    left = axes[first + low]
    return low, min(1.0, max(0.0, (x - left) / (axes[first + low + 1] - left)))


@kernel(allocates=False)
def locate_row(pool, t, v):
    """Rows a, b that enclose v = sin^2 theta_i and the weight of b."""
    n = pool.header[t, N_ROWS]
    if n == 1:
        return 0, 0, 0.0
    a, w = _locate(pool.axes, pool.header[t, AXES], pool.buckets, pool.header[t, BUCKETS], v, v * N_BUCKETS)
    return a, a + 1, w


@kernel(allocates=False)
def _locate_point(pool, t, u, phi):
    """Node and fraction in u, node and fraction in phi."""
    axis = pool.header[t, AXES] + pool.header[t, N_ROWS]
    bucket = pool.header[t, BUCKETS] + N_BUCKETS + 1
    k, x = _locate(pool.axes, axis, pool.buckets, bucket, u, u * N_BUCKETS)
    axis += pool.header[t, N_U]
    bucket += N_BUCKETS + 1
    j, y = _locate(pool.axes, axis, pool.buckets, bucket, phi, phi * _PER_RADIAN)
    return k, x, j, y


@kernel(allocates=False)
def _coordinates(wi, wo):
    """The coordinates v = sin^2 theta_i, u = sin^2 theta_r delta phi; on the normal the azimuth is +x's."""
    v = wi[0] * wi[0] + wi[1] * wi[1]
    u = wo[0] * wo[0] + wo[1] * wo[1]
    length = math.sqrt(v * u)
    if length > 0.0:
        cosine = (wi[0] * wo[0] + wi[1] * wo[1]) / length
    elif u > 0.0:
        cosine = wo[0] / math.sqrt(u)
    else:
        cosine = 1.0
    return min(1.0, v), min(1.0, u), math.acos(min(1.0, max(-1.0, cosine)))


@kernel(allocates=False)
def eval_table(pool, t, wi, wo, out):
    """BRDF of table `t`, without its delta term.

    Parameters
    ----------
    pool : Pool
    t : int
        Which table of the pool.
    wi, wo : direction
    out : ndarray, shape (C,)
        Receives f_r in 1/sr per channel; 0 where a direction is below the horizon.
    """
    if wi[2] < 0.0 or wo[2] < 0.0:
        for c in range(pool.header[t, N_CHANNELS]):
            out[c] = 0.0
        return
    v, u, phi = _coordinates(wi, wo)
    _values(pool, t, v, u, phi, None, out)
    if pool.header[t, PEAK] >= 0:
        _add_peak(pool, pool.header[t, PEAK], wi, wo, v, out)


@kernel(allocates=False)
def _add_peak(pool, peak, wi, wo, v, out):
    """Add a peak's values to `out`, shape (C,)."""
    u, psi, density = _slopes(pool, peak, wi, wo, 1.0)
    if density > 0.0:
        scale = 0.25 / masked_cosines(pool.alpha[peak], wi[2], wo[2])
        _values(pool, peak, v, u, psi, scale, out)


@kernel(allocates=False)
def _slopes(pool, peak, wi, wo, side):
    """A peak's coordinates u and psi of two directions, and d(u, psi)/d omega_o over 2 cos(theta_o).

    The latter is 0 outside of the peak's grid. `side` = -1: of what the plane turned up, from (x, y, -z).
    """
    x, y, z = wi[0] + wo[0], wi[1] + wo[1], wi[2] + side * wo[2]
    across2 = x * x + y * y
    extent2 = pool.extent[peak] ** 2
    if not (across2 < extent2 * z * z and wo[2] > 0.0):
        return 0.0, 0.0, 0.0
    length = math.sqrt((wi[0] * wi[0] + wi[1] * wi[1]) * across2)
    cosine = 1.0
    if length > 0.0:
        cosine = (wi[0] * x + wi[1] * y) / length * math.copysign(1.0, z)
    # |wi + wo| = 2 wi.h
    density = 0.5 * (across2 + z * z) / (extent2 * wo[2] * abs(z) ** 3)
    return across2 / (extent2 * z * z), math.acos(min(1.0, max(-1.0, cosine))), density


@kernel(inline=True, allocates=False)
def _values(pool, t, v, u, phi, scale, out):
    """Put the function of line `t` at a point into `out`, shape (C,); with a `scale`, add so much of it."""
    n = pool.header[t, N_CHANNELS]
    a, b, w = locate_row(pool, t, v)
    k, x, j, y = _locate_point(pool, t, u, phi)
    w00 = (1.0 - x) * (1.0 - y)
    w01 = (1.0 - x) * y
    w10 = x * (1.0 - y)
    w11 = x * y
    n_u = pool.header[t, N_U]
    n_phi = pool.header[t, N_PHI]
    ring = n_phi * n
    at_a = pool.header[t, VALUES] + ((a * n_u + k) * n_phi + j) * n
    at_b = pool.header[t, VALUES] + ((b * n_u + k) * n_phi + j) * n
    factor_a = pool.header[t, ROWS] + a * (1 + 3 * n) + 1
    factor_b = pool.header[t, ROWS] + b * (1 + 3 * n) + 1
    values = pool.values
    for c in range(n):
        p = at_a + c
        q = at_b + c
        f_a = w00 * values[p] + w01 * values[p + n] + w10 * values[p + ring] + w11 * values[p + ring + n]
        f_b = w00 * values[q] + w01 * values[q + n] + w10 * values[q + ring] + w11 * values[q + ring + n]
        f = (1.0 - w) * pool.rows[factor_a + c] * f_a + w * pool.rows[factor_b + c] * f_b
        if scale is None:
            out[c] = f
        else:
            out[c] += scale * f


@kernel(allocates=False)
def _mean(pool, t, a, b, w, k, x, j, y):
    """Channel mean fbar at a located point."""
    n_u = pool.header[t, N_U]
    n_phi = pool.header[t, N_PHI]
    p = pool.header[t, MEAN] + 2 * ((a * n_u + k) * n_phi + j)
    q = pool.header[t, MEAN] + 2 * ((b * n_u + k) * n_phi + j)
    ring = 2 * n_phi
    mean = pool.mean
    f_a = (1.0 - x) * ((1.0 - y) * mean[p] + y * mean[p + 2]) + x * (
        (1.0 - y) * mean[p + ring] + y * mean[p + ring + 2]
    )
    f_b = (1.0 - x) * ((1.0 - y) * mean[q] + y * mean[q + 2]) + x * (
        (1.0 - y) * mean[q + ring] + y * mean[q + ring + 2]
    )
    return (1.0 - w) * f_a + w * f_b


@kernel(allocates=False)
def _row_mean(pool, t, row):
    """Abar of one row: the channel mean's reflectance without delta term."""
    return pool.rows[pool.header[t, ROWS] + row * (1 + 3 * pool.header[t, N_CHANNELS])]


@kernel(allocates=False)
def _mean_albedo(pool, t, a, b, w):
    """Abar between rows; 0 of a peak that does not exist. A peak has its table's rows."""
    if t < 0:
        return 0.0
    return (1.0 - w) * _row_mean(pool, t, a) + w * _row_mean(pool, t, b)


@kernel(allocates=False)
def pdf_table(pool, t, wi, wo):
    """Density per solid angle with which `sample_table` draws `wo`: fbar cos(theta_o) / Abar.

    0 below the horizon, and everywhere where nothing is reflected.
    """
    if wi[2] < 0.0 or wo[2] <= 0.0:
        return 0.0
    v, u, phi = _coordinates(wi, wo)
    a, b, w = locate_row(pool, t, v)
    peak = pool.header[t, PEAK]
    total = _mean_albedo(pool, t, a, b, w) + _mean_albedo(pool, peak, a, b, w)
    if total <= 0.0:
        return 0.0
    k, x, j, y = _locate_point(pool, t, u, phi)
    value = _mean(pool, t, a, b, w, k, x, j, y)
    if peak >= 0:
        for side in (1.0, -1.0):
            u, psi, density = _slopes(pool, peak, wi, wo, side)
            if density > 0.0:
                k, x, j, y = _locate_point(pool, peak, u, psi)
                value += density * _mean(pool, peak, a, b, w, k, x, j, y)
    return value * wo[2] / total


@kernel(allocates=False)
def _sample_u(pool, t, row, uniform):
    """Ring k and fraction x of a u drawn from the row's marginal."""
    n_u = pool.header[t, N_U]
    axis = pool.header[t, AXES] + pool.header[t, N_ROWS]
    return draw(pool.marginal, pool.header[t, MARGINAL] + 2 * row * n_u, n_u, pool.axes, axis, uniform)


@kernel(allocates=False)
def _sample_phi(pool, t, row, k, x, uniform):
    """Sector j and fraction y of a phi drawn from the row's conditional at ring k, fraction x."""
    n_phi = pool.header[t, N_PHI]
    inner = pool.header[t, MEAN] + 2 * (row * pool.header[t, N_U] + k) * n_phi
    axis = pool.header[t, AXES] + pool.header[t, N_ROWS] + pool.header[t, N_U]
    return draw_between(pool.mean, inner, inner + 2 * n_phi, n_phi, x, pool.axes, axis, uniform)


@kernel(allocates=False)
def sample_table(pool, t, wi, u0, u1, u2):
    """Draw `wo` in proportion to the channel mean of f cos(theta_o), without the delta term.

    Parameters
    ----------
    pool : Pool
    t : int
        Which table of the pool.
    wi : direction
    u0, u1, u2 : float
        Uniform in [0, 1): u0 for theta_o, u1 for delta phi, u2 for the row and the azimuth's sign.

    Returns
    -------
    wo : direction
    pdf : float
        Per solid angle; 0 where nothing is reflected (`wo` is then the normal, and to be discarded).
    """
    v = min(1.0, wi[0] * wi[0] + wi[1] * wi[1])
    a, b, w = locate_row(pool, t, v)
    peak = pool.header[t, PEAK]
    own = _mean_albedo(pool, t, a, b, w)
    total = own + _mean_albedo(pool, peak, a, b, w)
    if wi[2] < 0.0 or total <= 0.0:
        return (0.0, 0.0, 1.0), 0.0
    ex, ey = 1.0, 0.0
    if v > 0.0:
        length = math.sqrt(wi[0] * wi[0] + wi[1] * wi[1])
        ex, ey = wi[0] / length, wi[1] / length
    u2 *= total
    if total > own and u2 >= own:
        wo = _sample_slope(pool, peak, wi, ex, ey, a, b, w, u0, u1, u2 - own)
        return wo, pdf_table(pool, t, wi, wo)
    u, cos_phi, sin_phi, mean = _sample_line(pool, t, a, b, w, u0, u1, u2)
    radius = math.sqrt(min(1.0, u))
    cos_o = math.sqrt(max(0.0, 1.0 - u))
    wo = (radius * (cos_phi * ex - sin_phi * ey), radius * (cos_phi * ey + sin_phi * ex), cos_o)
    if peak >= 0:
        return wo, pdf_table(pool, t, wi, wo)
    return wo, mean * cos_o / total


@kernel(allocates=False)
def _sample_slope(pool, peak, wi, ex, ey, a, b, w, u0, u1, u2):
    """Draw `wo` from a peak; (ex, ey) is the azimuth of `wi`, the rest as in `_sample_line`."""
    u, cos_psi, sin_psi, _ = _sample_line(pool, peak, a, b, w, u0, u1, u2)
    slope = pool.extent[peak] * math.sqrt(u)
    cos_h = 1.0 / math.sqrt(1.0 + slope * slope)
    sin_h = slope * cos_h
    h = (sin_h * (cos_psi * ex - sin_psi * ey), sin_h * (cos_psi * ey + sin_psi * ex), cos_h)
    twice = 2.0 * (wi[0] * h[0] + wi[1] * h[1] + wi[2] * h[2])
    return twice * h[0] - wi[0], twice * h[1] - wi[1], abs(twice * h[2] - wi[2])


@kernel(allocates=False)
def _sample_line(pool, t, a, b, w, u0, u1, u2):
    """Draw a point of line `t`, between rows a and b, in proportion to its mean; `u2` is uniform in [0, its Abar).

    Returns u, cosine and sine of the azimuth, and the channel mean there.
    """
    share_a = (1.0 - w) * _row_mean(pool, t, a)
    share_b = w * _row_mean(pool, t, b)
    row = a
    left = u2 / share_a if share_a > 0.0 else 0.0
    if u2 >= share_a and share_b > 0.0:
        row = b
        left = (u2 - share_a) / share_b
    k, x = _sample_u(pool, t, row, u0)
    j, y = _sample_phi(pool, t, row, k, x, u1)
    axis = pool.header[t, AXES] + pool.header[t, N_ROWS]
    u = (1.0 - x) * pool.axes[axis + k] + x * pool.axes[axis + k + 1]
    axis += pool.header[t, N_U]
    phi = (1.0 - y) * pool.axes[axis + j] + y * pool.axes[axis + j + 1]
    sin_phi = math.sin(phi) if left < 0.5 else -math.sin(phi)
    return u, math.cos(phi), sin_phi, _mean(pool, t, a, b, w, k, x, j, y)
