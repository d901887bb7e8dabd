"""The environment map: light from infinitely far away, looked up and drawn from.

The map has Mitsuba's layout: with v a direction in the map's frame, column u = atan2(v_x, -v_z) / 2 pi with
pixel centres at (i + 1/2) / W, row v = acos(v_y) / pi with the first and the last row exactly on the
poles, bilinear between. The *cells* between four neighbouring pixels are what we draw from: a cell in
proportion to its solid angle times the mean luminance of its corners, then a direction uniform in the
cell's solid angle. So the density is constant in each cell and needs no sine at the poles; a constant
map of one pixel is drawn from exactly uniformly.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gonio.core.jit import kernel
from microgeometry.errors import InputError
from renderer.alias import alias_table, draw
from renderer.scene import Array
from renderer.scene import Environment as Description

LUMINANCE = np.array([0.212671, 0.715160, 0.072169])
"""Weights of linear BT.709 RGB in luminance."""


class Environment(NamedTuple):
    """An environment map as kernels take it."""

    radiance: np.ndarray  # float32 (H, W, 3), H >= 2
    to_local: np.ndarray  # (3, 3), world to map
    threshold: np.ndarray  # float32 ((H - 1) W,), alias table over the cells
    other: np.ndarray  # int32
    density: np.ndarray  # float32, probability density of each cell in 1/sr


def pack_environment(environment: Description | None) -> Environment:
    """Arrays of an environment; None is black.

    Raises
    ------
    InputError
        A map of the wrong shape, with negative or non-finite pixels, or a transform that is no rotation.
    """
    if environment is None:
        environment = Description(np.zeros((1, 1, 3)))
    radiance = np.asarray(environment.radiance, np.float64) * environment.scale
    if radiance.ndim != 3 or radiance.shape[2] != 3 or 0 in radiance.shape:
        raise InputError(f"environment: the map has shape {radiance.shape}; (height, width, 3) is needed")
    if not np.all(np.isfinite(radiance)) or radiance.min() < 0:
        raise InputError(
            "environment: the map has negative or non-finite pixels; radiance is finite and >= 0"
        )
    if len(radiance) == 1:
        radiance = np.repeat(radiance, 2, axis=0)
    height, width = radiance.shape[:2]
    luminance = radiance @ LUMINANCE
    rows = luminance[1:] + luminance[:-1]
    corners = 0.25 * (rows + np.roll(rows, -1, axis=1))
    edges = np.cos(np.pi * np.arange(height) / (height - 1))
    solid_angle = (-np.diff(edges) * 2 * np.pi / width)[:, None]
    power = corners * solid_angle
    # A cell darker than its neighbours is never starved: a thousandth of all samples are uniform.
    total = power.sum()
    power = power + (1e-3 * total if total > 0 else 1.0) * solid_angle / (4 * np.pi)
    power /= power.sum()
    return Environment(
        radiance.astype(np.float32),
        np.ascontiguousarray(_rotation(environment.to_world).T),
        *alias_table(power.ravel()),
        (power / solid_angle).ravel().astype(np.float32),
    )


def _rotation(to_world: Array) -> Array:
    linear = np.asarray(to_world, np.float64)[:3, :3]
    size = np.cbrt(abs(np.linalg.det(linear)))
    if size == 0 or not np.allclose(linear.T @ linear, size**2 * np.eye(3), atol=1e-6 * size**2):
        raise InputError("environment: to_world is not a rotation; only rotations and mirrorings turn a map")
    return linear / size


@kernel(allocates=False)
def _position(environment, direction):
    """Column and row of a direction, in pixels, and its cell: (x, y, column, row)."""
    m = environment.to_local
    height, width = environment.radiance.shape[0], environment.radiance.shape[1]
    x = m[0, 0] * direction[0] + m[0, 1] * direction[1] + m[0, 2] * direction[2]
    y = m[1, 0] * direction[0] + m[1, 1] * direction[1] + m[1, 2] * direction[2]
    z = m[2, 0] * direction[0] + m[2, 1] * direction[1] + m[2, 2] * direction[2]
    u = math.atan2(x, -z) / (2.0 * math.pi) * width - 0.5
    if u < 0.0:
        u += width
    v = math.acos(min(1.0, max(-1.0, y))) / math.pi * (height - 1)
    return u, v, min(int(u), width - 1), min(int(v), height - 2)


@kernel(allocates=False)
def environment_radiance(environment, direction):
    """Radiance from `direction` (world, away from the scene) and density with which it is drawn.

    Returns
    -------
    tuple of 4 float
        Red, green, blue, and the probability density in 1/sr.
    """
    image = environment.radiance
    width = image.shape[1]
    u, v, column, row = _position(environment, direction)
    right = column + 1 if column + 1 < width else 0
    a, b = u - column, v - row
    w00, w01, w10, w11 = (1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b
    red = w00 * image[row, column, 0] + w01 * image[row, right, 0]
    red += w10 * image[row + 1, column, 0] + w11 * image[row + 1, right, 0]
    green = w00 * image[row, column, 1] + w01 * image[row, right, 1]
    green += w10 * image[row + 1, column, 1] + w11 * image[row + 1, right, 1]
    blue = w00 * image[row, column, 2] + w01 * image[row, right, 2]
    blue += w10 * image[row + 1, column, 2] + w11 * image[row + 1, right, 2]
    return red, green, blue, np.float64(environment.density[row * width + column])


@kernel(allocates=False)
def sample_environment(environment, u0, u1, u2):
    """Direction towards the environment, drawn with the density `environment_radiance` gives."""
    m = environment.to_local
    height, width = environment.radiance.shape[0], environment.radiance.shape[1]
    cell = draw(environment.threshold, environment.other, 0, len(environment.density), u0)
    row = cell // width
    column = cell - row * width
    top = math.cos(math.pi * row / (height - 1))
    bottom = math.cos(math.pi * (row + 1) / (height - 1))
    y = top + (bottom - top) * u1
    r = math.sqrt(max(0.0, 1.0 - y * y))
    phi = 2.0 * math.pi * (column + 0.5 + u2) / width
    x, z = r * math.sin(phi), -r * math.cos(phi)
    return (
        m[0, 0] * x + m[1, 0] * y + m[2, 0] * z,
        m[0, 1] * x + m[1, 1] * y + m[2, 1] * z,
        m[0, 2] * x + m[1, 2] * y + m[2, 2] * z,
    )
