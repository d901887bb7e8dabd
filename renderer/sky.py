"""An environment to render under: a clear sky with a sun, over a dark ground."""

from __future__ import annotations

import numpy as np

from gonio.core.directions import direction
from renderer.scene import Array

_ZENITH = np.array([0.22, 0.42, 0.85])
_HORIZON = np.array([0.85, 0.90, 0.95])
_GROUND = np.array([0.16, 0.14, 0.12])
_SUN = np.array([1.0, 0.86, 0.68])


def sky(
    height: int = 128, *, sun: tuple[float, float, float] = (-0.55, 0.62, 0.56), sun_deg: float = 4.0
) -> Array:
    """A latitude-longitude map, +y up, for `renderer.scene.Environment`.

    Parameters
    ----------
    height : int
        Rows; there are twice as many columns.
    sun : tuple of 3 float
        Towards the sun.
    sun_deg : float
        Radius of the sun, degrees; its rim is soft, so that it survives a coarse map.

    Returns
    -------
    ndarray, shape (height, 2 height, 3)
        Radiance; a horizontal surface receives about 2 from the sky and 2 from the sun.
    """
    theta = np.pi * np.arange(height)[:, None] / (height - 1)
    phi = 2 * np.pi * (np.arange(2 * height)[None, :] + 0.5) / (2 * height)
    # the map's u runs from -z over +x; `direction` turns from +x to +y about +z
    local = direction(theta, phi)
    v = np.stack([local[..., 1], local[..., 2], -local[..., 0]], axis=-1)
    up = v[..., 1:2]
    above = _HORIZON + (_ZENITH - _HORIZON) * np.sqrt(np.clip(up, 0, 1))
    # a horizon two degrees soft: no aliasing in mirrors
    mix = np.clip(0.5 + up / np.radians(4), 0, 1)
    image = mix * above + (1 - mix) * _GROUND
    toward = np.asarray(sun) / np.linalg.norm(sun)
    distance = np.degrees(np.arccos(np.clip(v @ toward, -1, 1)))[..., None]
    disk = np.clip((sun_deg + 0.75 - distance) / 1.5, 0, 1)
    radiance = 3.2 / (np.pi * np.radians(sun_deg) ** 2)
    halo = 0.8 * np.exp(-distance / 9.0)
    return image + mix * (radiance * disk + halo) * _SUN
