"""Thin films by Abeles' characteristic matrices (Born & Wolf, section 1.6), one film at a time."""

from __future__ import annotations

import math

import numpy as np

from tests.oracles.fresnel import snell


def film_stack(cos_i, n_above, films, n_below, wavelength):
    """Amplitudes and intensities of a coherent stack.

    Parameters
    ----------
    cos_i : float
    n_above : float
        Real: where the light comes from.
    films : list of (complex, float)
        Index and thickness, top to bottom; thickness in the units of the wavelength.
    n_below : complex
    wavelength : float
        In vacuum.

    Returns
    -------
    r : ndarray, shape (2,)
        Reflected amplitudes (s, p), with r_p = -r_s at normal incidence.
    T : ndarray, shape (2,)
        Transmitted intensity over incident, per area of the interface; meaningful for a real n_below.
    """
    r, t = film_amplitudes(cos_i, n_above, films, n_below, wavelength)
    return r, np.abs(t) ** 2


def film_amplitudes(cos_i, n_above, films, n_below, wavelength):
    """Amplitudes (s, p) reflected and transmitted, the latter scaled so that its square is the intensity."""
    r, t = [], []
    cosines = [complex(snell(cos_i, n_above, n)) for n, _ in films]
    cos_b = complex(snell(cos_i, n_above, n_below))
    for polarisation in "sp":

        def admittance(n, c, polarisation=polarisation):
            return n * c if polarisation == "s" else n / c

        m = np.eye(2, dtype=complex)
        for (n, d), c in zip(films, cosines, strict=True):
            delta = 2 * math.pi * n * d * c / wavelength
            y = admittance(n, c)
            m = m @ np.array(
                [[np.cos(delta), -1j * np.sin(delta) / y], [-1j * y * np.sin(delta), np.cos(delta)]]
            )
        y0, yb = admittance(n_above, cos_i), admittance(n_below, cos_b)
        b, c = m @ np.array([1.0, yb])
        amplitude = (y0 * b - c) / (y0 * b + c)
        # of tangential fields; the p amplitude of this project has the other sign
        r.append(amplitude if polarisation == "s" else -amplitude)
        t.append(2 * np.sqrt(np.real(y0) * max(0.0, np.real(yb))) / (y0 * b + c))
    return np.array(r), np.array(t)
