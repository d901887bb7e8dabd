"""The closed form of a brushed mirror: single bounces off Gaussian slopes of two widths."""

import numpy as np
from scipy import special


def beckmann(wi, wo, alpha_x, alpha_y, correlated=True):
    """f = D G2 / (4 cos_i cos_o) with Smith's height-correlated G2 (Heitz 2014, equations 72, 85, 99), shape (N, 1).

    Not correlated: G2 = G1 G1, as Mitsuba has it.
    """
    slopes = (wi + wo)[:, :2] / (wi + wo)[:, 2:]
    p22 = np.exp(-((slopes[:, 0] / alpha_x) ** 2) - (slopes[:, 1] / alpha_y) ** 2)
    d = p22 / (np.pi * alpha_x * alpha_y) * (1 + (slopes**2).sum(axis=1)) ** 2
    a, b = _smith(wi, alpha_x, alpha_y), _smith(wo, alpha_x, alpha_y)
    g2 = 1 / (1 + a + b if correlated else (1 + a) * (1 + b))
    return (d * g2 / (4 * wi[:, 2] * wo[:, 2]))[:, None]


def _smith(w, alpha_x, alpha_y):
    a = w[:, 2] / np.maximum(np.hypot(alpha_x * w[:, 0], alpha_y * w[:, 1]), 1e-9)
    return 0.5 * (special.erf(a) - 1) + np.exp(-a * a) / (2 * a * np.sqrt(np.pi))
