"""Smith's masking and shadowing of a surface of Beckmann facets: kernels."""

from __future__ import annotations

import math

from gonio.core.jit import kernel

_ALL = 6.0  # beyond, erf is 1 in double precision


@kernel(allocates=False)
def projected_area(alpha, cosine, sine):
    """Area of a Beckmann surface that faces a direction, projected on it: (1 + Lambda) cos theta.

    Heitz 2014, "Understanding the masking-shadowing function in microfacet-based BRDFs", eq. 74, so written
    that it holds up to the horizon; visible or not, per area of the plane.

    Parameters
    ----------
    alpha : float
    cosine, sine : float
        Of theta, the cosine not below 0.
    """
    if cosine >= _ALL * alpha * sine:
        return cosine
    a = cosine / (alpha * sine)
    return 0.5 * cosine * (1.0 + math.erf(a)) + 0.5 * alpha * sine * math.exp(-a * a) / math.sqrt(math.pi)


@kernel(allocates=False)
def masked_cosines(alpha, cos_i, cos_o):
    """The product of both cosines over the share of facets that both see: P_i cos_o + P_o cos_i - cos_i cos_o.

    Height-correlated (Heitz 2014, eq. 99), P = (1 + Lambda) cos theta: f of a rough mirror is F D over 4 times this.
    """
    p_i = projected_area(alpha, cos_i, math.sqrt(max(0.0, 1.0 - cos_i * cos_i)))
    p_o = projected_area(alpha, cos_o, math.sqrt(max(0.0, 1.0 - cos_o * cos_o)))
    return p_i * cos_o + p_o * cos_i - cos_i * cos_o


@kernel(allocates=False)
def masked_cosines_many(alpha, cos_i, cos_o, out):
    """`masked_cosines` of arrays `cos_o` and `out`, shape (N,)."""
    for n in range(len(cos_o)):
        out[n] = masked_cosines(alpha, cos_i, cos_o[n])
