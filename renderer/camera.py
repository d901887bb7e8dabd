"""The camera as kernels take it: a ray through a pixel."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gonio.core.jit import kernel


class View(NamedTuple):
    """The camera as kernels take it."""

    to_world: np.ndarray  # (4, 4), axes of unit length
    tangents: np.ndarray  # (2,), of half the angles of view
    lens: np.ndarray  # (2,), aperture radius and focus distance
    size: np.ndarray  # int64 (2,), width and height


@kernel(allocates=False)
def camera_ray(view, x, y, u):
    """Origin and direction through pixel (x, y) at the position and lens point that `u` draws."""
    m = view.to_world
    a = (1.0 - 2.0 * (x + u[0]) / view.size[0]) * view.tangents[0]
    b = (1.0 - 2.0 * (y + u[1]) / view.size[1]) * view.tangents[1]
    ox, oy, oz = m[0, 3], m[1, 3], m[2, 3]
    radius, focus = view.lens[0], view.lens[1]
    if radius > 0.0:
        r, phi = radius * math.sqrt(u[2]), 2.0 * math.pi * u[3]
        s, t = r * math.cos(phi), r * math.sin(phi)
        ox, oy, oz = (
            ox + s * m[0, 0] + t * m[0, 1],
            oy + s * m[1, 0] + t * m[1, 1],
            oz + s * m[2, 0] + t * m[2, 1],
        )
        a, b = a - s / focus, b - t / focus
    scale = 1.0 / math.sqrt(a * a + b * b + 1.0)
    a, b = a * scale, b * scale
    return (ox, oy, oz), (
        a * m[0, 0] + b * m[0, 1] + scale * m[0, 2],
        a * m[1, 0] + b * m[1, 1] + scale * m[1, 2],
        a * m[2, 0] + b * m[2, 1] + scale * m[2, 2],
    )
