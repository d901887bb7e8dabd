"""Fitted and hand-written models as materials: sums of lobes, drawn from as a mixture of exact density.

A lobe is chosen in proportion to its coefficients, the direction from it; the density is that of all
lobes together. Lobes are drawn from for light that comes from the camera's side: they are reciprocal, and
so in shape are those that transmit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fitting.models.dispatch import lobe_pdf, lobe_sample, lobe_terms
from gonio.core.jit import kernel


class Lobes(NamedTuple):
    """Lobes of all models of a scene, laid end to end."""

    kind: np.ndarray  # int64 (K,)
    shape: np.ndarray  # (K, SIZE), packed lobes
    weight: np.ndarray  # (K, 7): RGB of the first term, RGB of the second, chance among the model's lobes


@kernel(allocates=False)
def analytic_evaluate(lobes, first, count, wi, wo):
    """As `renderer.materials.evaluate`, for lobes [first, first + count)."""
    red, green, blue, density = 0.0, 0.0, 0.0, 0.0
    for k in range(first, first + count):
        one, two = lobe_terms(lobes.kind[k], lobes.shape[k], wi, wo)
        w = lobes.weight
        red += w[k, 0] * one + w[k, 3] * two
        green += w[k, 1] * one + w[k, 4] * two
        blue += w[k, 2] * one + w[k, 5] * two
        density += w[k, 6] * lobe_pdf(lobes.kind[k], lobes.shape[k], wo, wi)
    cosine = abs(wi[2])
    return red * cosine, green * cosine, blue * cosine, density


@kernel(allocates=False)
def analytic_sample(lobes, first, count, wo, u0, u1, u2):
    """As `renderer.materials.sample`, `wo` above the horizon unless a lobe transmits."""
    k = first
    last = first + count - 1
    while k < last and u0 >= lobes.weight[k, 6]:
        u0 -= lobes.weight[k, 6]
        k += 1
    if count == 0:
        return (0.0, 0.0, 1.0), 0.0, 0.0, 0.0, 0.0
    wi = lobe_sample(lobes.kind[k], lobes.shape[k], wo, u1, u2)
    # a direction its own lobe has no use for must not count for another
    if lobe_pdf(lobes.kind[k], lobes.shape[k], wo, wi) <= 0.0:
        return wi, 0.0, 0.0, 0.0, 0.0
    red, green, blue, density = analytic_evaluate(lobes, first, count, wi, wo)
    return wi, red / density, green / density, blue / density, density
