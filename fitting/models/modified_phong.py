"""Lafortune and Willems 1994: Phong's lobe about the mirror direction, reciprocal and energy-conserving.

f_r = k_s (n + 2)/(2 pi) cos^n of the angle between `wo` and the mirror direction of `wi`.
"""

from __future__ import annotations

import math

from fitting.models.contract import SHAPE, VARIANTS, Lobe, Parameter, Term
from gonio.core.directions import combine, frame
from gonio.core.jit import kernel

FAMILY = 7

LOBE = Lobe(
    name="modified_phong",
    kind=VARIANTS * FAMILY,
    parameters=(Parameter("exponent", 1.0, 1e6, "log", "n; 100 is a highlight of 6 degrees"),),
    terms=(Term("ks"),),
    source="Lafortune and Willems, Using the modified Phong reflectance model, KU Leuven CW 197, 1994",
)


@kernel(allocates=False)
def terms(p, wi, wo):
    """The lobe at k_s = 1, 1/sr."""
    return (p[SHAPE] + 2.0) / (2.0 * math.pi) * _power(p[SHAPE], wi, wo), 0.0


@kernel(allocates=False)
def slopes(p, wi, wo, values, out):
    """Derivative by the exponent; see `fitting.models.contract`."""
    half_chord2 = _half_chord2(wi, wo)
    out[0], out[1] = 0.0, 0.0
    if half_chord2 < 1.0:
        out[0] = values[0] * (1.0 / (p[SHAPE] + 2.0) + math.log1p(-half_chord2))


@kernel(allocates=False)
def sample(p, wi, u0, u1):
    """A direction about the mirror direction, of density (n + 1)/(2 pi) cos^n; may fall below the horizon."""
    mirror = (-wi[0], -wi[1], wi[2])
    s, t = frame(mirror)
    # cos = (1 - u0)^(1/(n+1)); the sine by expm1, since cos rounds to 1 at large n
    log_cos = math.log1p(-u0) / (p[SHAPE] + 1.0)
    sine = math.sqrt(-math.expm1(2.0 * log_cos))
    phi = 2.0 * math.pi * u1
    return combine(sine * math.cos(phi), s, sine * math.sin(phi), t, math.exp(log_cos), mirror)


@kernel(allocates=False)
def pdf(p, wi, wo):
    """Density of `sample`, 1/sr."""
    return (p[SHAPE] + 1.0) / (2.0 * math.pi) * _power(p[SHAPE], wi, wo)


@kernel(allocates=False)
def _power(n, wi, wo):
    """cos^n, from the chord: at n = 1e6 a rounded cosine would cost ten digits."""
    half_chord2 = _half_chord2(wi, wo)
    if half_chord2 >= 1.0:
        return 0.0
    return math.exp(n * math.log1p(-half_chord2))


@kernel(allocates=False)
def _half_chord2(wi, wo):
    x, y, z = wo[0] + wi[0], wo[1] + wi[1], wo[2] - wi[2]
    return 0.5 * (x * x + y * y + z * z)
