"""All lights of a scene, drawn from one at a time: each as likely, then a direction towards it.

Area lights shine from the side of their normal. Triangles and disks are drawn from uniformly in area,
spheres uniformly in the solid angle they fill (Shirley et al. 1996).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gonio.core.directions import frame
from gonio.core.jit import kernel
from renderer.alias import draw
from renderer.environment import Environment, environment_radiance, sample_environment

ENVIRONMENT, POINT, DIRECTIONAL, AREA = range(4)
TRIANGLE, SPHERE, DISK = range(3)
FAR = 1e30


class Lights(NamedTuple):
    """The lights of a scene as kernels take them; `P` emitting primitives are laid end to end."""

    kind: np.ndarray  # int64 (L,)
    colour: np.ndarray  # (L, 3): radiance, intensity or irradiance
    vector: np.ndarray  # (L, 3): position or direction
    area: np.ndarray  # (L,) of an area light's primitives together
    first: np.ndarray  # int64 (L,), its first primitive
    n_primitives: np.ndarray  # int64 (L,)
    primitive: np.ndarray  # int64 (P,)
    data: np.ndarray  # (P, 12): a corner and two edges and normal; or centre, radius, orientation
    threshold: np.ndarray  # float32 (P,), alias tables by area within each light
    other: np.ndarray  # int32 (P,)
    environment: Environment


@kernel(allocates=False)
def sphere_density(distance2, radius2):
    """Density in 1/sr of a direction uniform in the cone a sphere fills, from outside it."""
    sine2 = radius2 / distance2
    return (1.0 + math.sqrt(1.0 - sine2)) / (2.0 * math.pi * sine2)


@kernel(allocates=False)
def area_density(lights, light, origin, distance2, cosine):
    """Density in 1/sr with which `sample_light` draws a point of area light `light`, seen from `origin`.

    Parameters
    ----------
    distance2 : float
        Squared distance from `origin` to the point.
    cosine : float
        Cosine at the light, > 0.
    """
    n_lights = len(lights.kind)
    first = lights.first[light]
    if lights.primitive[first] == SPHERE:
        data = lights.data
        x, y, z = data[first, 0] - origin[0], data[first, 1] - origin[1], data[first, 2] - origin[2]
        centre2, radius2 = x * x + y * y + z * z, data[first, 3] * data[first, 3]
        if centre2 > radius2 * 1.0001:
            return sphere_density(centre2, radius2) / n_lights
    return distance2 / (cosine * lights.area[light] * n_lights)


@kernel(allocates=False)
def _sample_cone(data, p, x, y, z, centre2, u1, u2):
    """Point of sphere `p` in a direction uniform in the cone it fills: (direction, distance)."""
    radius2 = data[p, 3] * data[p, 3]
    sine2_max = radius2 / centre2
    one_minus_cos = u1 * sine2_max / (1.0 + math.sqrt(1.0 - sine2_max))
    cosine = 1.0 - one_minus_cos
    sine2 = one_minus_cos * (1.0 + cosine)
    sine = math.sqrt(sine2)
    centre = math.sqrt(centre2)
    axis = (x / centre, y / centre, z / centre)
    s, t = frame(axis)
    a, b = sine * math.cos(2.0 * math.pi * u2), sine * math.sin(2.0 * math.pi * u2)
    direction = (
        a * s[0] + b * t[0] + cosine * axis[0],
        a * s[1] + b * t[1] + cosine * axis[1],
        a * s[2] + b * t[2] + cosine * axis[2],
    )
    return direction, centre * cosine - math.sqrt(max(0.0, radius2 - centre2 * sine2))


@kernel(allocates=False)
def _area_point(lights, p, u1, u2):
    """Point uniform on primitive `p` and the normal there: (point, normal)."""
    data = lights.data
    kind = lights.primitive[p]
    if kind == SPHERE:
        z = 1.0 - 2.0 * u1
        r = math.sqrt(max(0.0, 1.0 - z * z))
        x, y = r * math.cos(2.0 * math.pi * u2), r * math.sin(2.0 * math.pi * u2)
        radius, sign = data[p, 3], data[p, 4]
        point = (data[p, 0] + radius * x, data[p, 1] + radius * y, data[p, 2] + radius * z)
        return point, (sign * x, sign * y, sign * z)
    if kind == DISK:
        r = math.sqrt(u1)
        a, b = r * math.cos(2.0 * math.pi * u2), r * math.sin(2.0 * math.pi * u2)
    else:
        r = math.sqrt(u1)
        a, b = r * (1.0 - u2), r * u2
    point = (
        data[p, 0] + a * data[p, 3] + b * data[p, 6],
        data[p, 1] + a * data[p, 4] + b * data[p, 7],
        data[p, 2] + a * data[p, 5] + b * data[p, 8],
    )
    return point, (data[p, 9], data[p, 10], data[p, 11])


@kernel(allocates=False)
def sample_light(lights, origin, u0, u1, u2, u3):
    """A direction from `origin` towards a light, drawn at random.

    Returns
    -------
    direction : tuple of 3 float
        Unit vector.
    distance : float
        To the light; `FAR` for light from infinity.
    red, green, blue : float
        Radiance over the density of the direction (irradiance over chance for a delta light), occluders
        apart; black where the light shines away.
    density : float
        In 1/sr, the choice of the light included; 0 for a delta light.
    """
    n_lights = len(lights.kind)
    light = min(int(u0 * n_lights), n_lights - 1)
    kind = lights.kind[light]
    red, green, blue = lights.colour[light, 0], lights.colour[light, 1], lights.colour[light, 2]
    if kind == ENVIRONMENT:
        direction = sample_environment(lights.environment, u1, u2, u3)
        red, green, blue, density = environment_radiance(lights.environment, direction)
        density /= n_lights
        return direction, FAR, red / density, green / density, blue / density, density
    vector = lights.vector
    if kind == DIRECTIONAL:
        direction = (-vector[light, 0], -vector[light, 1], -vector[light, 2])
        return direction, FAR, red * n_lights, green * n_lights, blue * n_lights, 0.0
    if kind == POINT:
        point = (vector[light, 0], vector[light, 1], vector[light, 2])
        normal = (0.0, 0.0, 0.0)
    else:
        first = lights.first[light]
        p = draw(lights.threshold, lights.other, first, lights.n_primitives[light], u1)
        if lights.primitive[p] == SPHERE:
            data = lights.data
            x, y, z = data[p, 0] - origin[0], data[p, 1] - origin[1], data[p, 2] - origin[2]
            centre2 = x * x + y * y + z * z
            if centre2 > data[p, 3] * data[p, 3] * 1.0001:
                direction, distance = _sample_cone(data, p, x, y, z, centre2, u2, u3)
                density = sphere_density(centre2, data[p, 3] * data[p, 3]) / n_lights
                factor = 1.0 / density if data[p, 4] > 0.0 else 0.0
                return direction, distance, red * factor, green * factor, blue * factor, density
        point, normal = _area_point(lights, p, u2, u3)
    x, y, z = point[0] - origin[0], point[1] - origin[1], point[2] - origin[2]
    distance2 = max(x * x + y * y + z * z, 1e-300)
    distance = math.sqrt(distance2)
    x, y, z = x / distance, y / distance, z / distance
    if kind == POINT:
        factor = n_lights / distance2
        return (x, y, z), distance, red * factor, green * factor, blue * factor, 0.0
    cosine = -(x * normal[0] + y * normal[1] + z * normal[2])
    if cosine <= 0.0:
        return (x, y, z), distance, 0.0, 0.0, 0.0, 1.0
    density = distance2 / (cosine * lights.area[light] * n_lights)
    return (x, y, z), distance, red / density, green / density, blue / density, density
