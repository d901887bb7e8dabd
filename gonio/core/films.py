"""A stack of thin films between two half-spaces, as a kernel on scalars.

The tangential fields (B, C) = (E, H) are carried from the substrate up through the films by their
characteristic matrices (Born & Wolf, section 1.6.2), each multiplied by exp(i delta), delta the film's
phase: its entries then stay bounded for any thickness and absorption, and regular at the critical angle
of a film.
"""

from __future__ import annotations

import math

from gonio.core.jit import kernel
from gonio.core.optics import root

_GRAZING = 1e-60  # stands for cos theta = 0: there all is 0/0 where indices are equal
_LARGE = 1e200  # |B|^2 + |C|^2 of a hundred strong mirrors on top of each other


@kernel(allocates=False)
def film_amplitudes(cos_i, n_above, films, thicknesses, n_below, k_below, wavelength):
    """Reflection and transmission of plane waves by coherent films.

    Signs and axes as in `gonio.core.optics`.

    Parameters
    ----------
    cos_i : float
        Cosine of the angle of incidence, in [0, 1].
    n_above : float
        Index on the incident side, real.
    films : ndarray, shape (M, 2)
        Absolute indices n, k of the films in the order the light meets them, k >= 0; M may be 0.
    thicknesses : ndarray, shape (M,)
        Metres.
    n_below, k_below : float
        Absolute index of the substrate.
    wavelength : float
        In vacuum, metres.

    Returns
    -------
    r_s, r_p : complex
        Amplitude reflectances.
    T_s, T_p : float
        Fractions of the incident power that enter the substrate; 0 at total internal reflection.
    cross : complex
        t_s t_p*, times the factor that makes intensities of it: |cross|^2 = T_s T_p. Of no meaning in an
        absorbing substrate.
    """
    cos_i = max(cos_i, _GRAZING)
    normal0 = n_above * cos_i  # n cos(theta) of the incident side
    index2_0 = n_above * n_above
    normal, index2 = _normal(n_above, cos_i, n_below, k_below)
    b_s, c_s = complex(1.0, 0.0), normal
    b_p, c_p = normal, index2
    decay = 1.0  # amplitude of exp(i delta) taken out of (b, c), product over the films
    rest_s, rest_p = 1.0, 1.0
    power_s = normal.real
    power_p = normal.real * index2.real + normal.imag * index2.imag
    for layer in range(films.shape[0] - 1, -1, -1):
        normal, index2 = _normal(n_above, cos_i, films[layer, 0], films[layer, 1])
        path = 2.0 * math.pi * thicknesses[layer] / wavelength
        # delta = x + i y;  exp(2 i delta) - 1 to full relative accuracy
        x, y = path * normal.real, path * normal.imag
        sine, cosine = math.sin(x), math.cos(x)
        fading = math.expm1(-y) if y != 0.0 else 0.0
        fading2 = fading * (2.0 + fading)
        difference = complex(
            fading2 * (1.0 - 2.0 * sine * sine) - 2.0 * sine * sine, (1.0 + fading2) * 2.0 * sine * cosine
        )
        decay *= 1.0 + fading
        # exp(i delta) times cos(delta), -i sin(delta) n cos(theta) and -i sin(delta) / (n cos(theta))
        diagonal = 1.0 + 0.5 * difference
        down = -0.5 * difference * normal
        up = complex(0.0, -path) if normal == 0.0 else -0.5 * difference / normal
        b_s, c_s = diagonal * b_s + up * c_s, diagonal * c_s + down * b_s
        b_p, c_p = diagonal * b_p + down / index2 * c_p, diagonal * c_p + index2 * up * b_p
        b_s, c_s, rest_s = _bounded(b_s, c_s, rest_s)
        b_p, c_p, rest_p = _bounded(b_p, c_p, rest_p)
    inverse_s = 1.0 / (normal0 * b_s + c_s)
    inverse_p = 1.0 / (normal0 * c_p + index2_0 * b_p)
    r_s = (normal0 * b_s - c_s) * inverse_s
    r_p = (normal0 * c_p - index2_0 * b_p) * inverse_p
    t_s = decay * rest_s * inverse_s
    t_p = decay * rest_p * inverse_p
    factor = 4.0 * normal0
    return (
        r_s,
        r_p,
        factor * power_s * (t_s.real * t_s.real + t_s.imag * t_s.imag),
        factor * index2_0 * power_p * (t_p.real * t_p.real + t_p.imag * t_p.imag),
        factor * n_above * n_below * power_s * (t_s * t_p.conjugate()),
    )


@kernel(allocates=False)
def _normal(n_above, cos_i, n, k):
    """(n cos(theta), n^2) in a medium of index n + i k, complex."""
    # n^2 - (n_above sin theta_i)^2
    real = (n - n_above) * (n + n_above) - k * k + (n_above * cos_i) * (n_above * cos_i)
    imaginary = 2.0 * n * k
    a, b = root(real, imaginary)
    return complex(a, b), complex((n - k) * (n + k), imaginary)


@kernel(allocates=False)
def _bounded(b, c, rest):
    """Tangential fields scaled down where they have grown out of all bounds, and 1 over the growth."""
    size2 = b.real * b.real + b.imag * b.imag + c.real * c.real + c.imag * c.imag
    if size2 < _LARGE:
        return b, c, rest
    scale = 1.0 / math.sqrt(size2)
    return scale * b, scale * c, scale * rest
