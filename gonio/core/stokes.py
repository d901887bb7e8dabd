"""Polarised light as Stokes vectors along a path, as kernels on scalars.

(I, Q, U, V) is taken against a unit vector e perpendicular to the direction d of propagation; the second
axis is d x e. With the fields E_1, E_2 along them (time dependence exp(-i omega t))

    I = |E_1|^2 + |E_2|^2,   Q = |E_1|^2 - |E_2|^2,   U + i V = 2 E_1 E_2*,

so V > 0 turns clockwise for an observer who faces the source (right-handed in Born & Wolf, section 1.4.2).
"""

from __future__ import annotations

import math

from gonio.core.directions import frame
from gonio.core.jit import kernel

_PARALLEL = 1e-20  # |d x n|^2 below which rounding decides where d x n points


@kernel(allocates=False)
def perpendicular(d, n):
    """Unit vector s along d x n; any vector perpendicular to `d` where the two are parallel.

    Parameters
    ----------
    d, n : direction
    """
    x = d[1] * n[2] - d[2] * n[1]
    y = d[2] * n[0] - d[0] * n[2]
    z = d[0] * n[1] - d[1] * n[0]
    length2 = x * x + y * y + z * z
    if length2 < _PARALLEL:
        return frame(d)[0]
    length = math.sqrt(length2)
    return x / length, y / length, z / length


@kernel(allocates=False)
def rotation(e, d, e_new):
    """Cosine and sine of twice the angle from the axis `e` to `e_new`, about the direction `d`.

    Against the new axis light has (cos Q + sin U, cos U - sin Q); I and V stay.

    Parameters
    ----------
    e, d, e_new : direction
        Old axis, direction of propagation, new axis; the axes are perpendicular to `d`.
    """
    # e_new = cos(phi) e + sin(phi) d x e
    cosine = e[0] * e_new[0] + e[1] * e_new[1] + e[2] * e_new[2]
    sine = (
        (d[1] * e[2] - d[2] * e[1]) * e_new[0]
        + (d[2] * e[0] - d[0] * e[2]) * e_new[1]
        + (d[0] * e[1] - d[1] * e[0]) * e_new[2]
    )
    # divided by cos^2 + sin^2, so that axes of rounded length leave Q^2 + U^2 as it is
    scale = 1.0 / (cosine * cosine + sine * sine)
    return (cosine - sine) * (cosine + sine) * scale, 2.0 * sine * cosine * scale


@kernel(allocates=False)
def mueller(i, q, u, v, a_s2, a_p2, cross):
    """Stokes vector (I, Q, U, V) after an interaction that multiplies E_s by a_s and E_p by a_p.

    Parameters
    ----------
    i, q, u, v : float
        Stokes vector before, against s.
    a_s2, a_p2 : float
        |a_s|^2 and |a_p|^2.
    cross : complex or float
        a_s a_p*.
    """
    mean = 0.5 * (a_s2 + a_p2)
    half = 0.5 * (a_s2 - a_p2)
    re, im = cross.real, cross.imag
    return mean * i + half * q, half * i + mean * q, re * u - im * v, re * v + im * u
