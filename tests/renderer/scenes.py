"""Scenes and pictures the tests share."""

from __future__ import annotations

import numpy as np

from gonio.table.table import Table
from renderer.meshes import rectangle, transformed
from renderer.render import render
from renderer.scene import Camera, Environment, Material, Scene, look_at

WHITE = Material("diffuse", {"reflectance": 1.0})


def constant(*rgb):
    return Environment(np.reshape(rgb or (1.0, 1.0, 1.0), (1, 1, 3)).astype(float))


def square(half=1.0, z=0.0, material=None, emission=None, down=False):
    """The square of the given half width in the plane `z`, facing +z."""
    matrix = np.diag([half, half, half, 1.0])
    matrix[2, 3] = z
    mesh = transformed(rectangle(), matrix, flip=down)
    return type(mesh)(mesh.vertices, mesh.faces, None, material or WHITE, emission)


def spot(origin=(3.0, 1.0, 2.0), target=(0.0, 0.0, 0.0), size=4, fov=0.01):
    """A camera that sees one point, in effect: the radiance of all pixels is that of `target`."""
    return Camera(look_at(origin, target, (0, 0, 1)), fov, width=size, height=size)


def mean(scene, spp, seed=0, **options):
    """Mean over all pixels and its standard error, each shape (3,)."""
    image = render(scene, spp=spp, seed=seed, **options)
    n = image.pixels.shape[0] * image.pixels.shape[1]
    return image.pixels.mean(axis=(0, 1)), np.sqrt((image.std_error**2).sum(axis=(0, 1))) / n


def assert_within(value, expected, std_error, sigmas=4.5):
    """Error bars must be small enough to mean something, and cover the truth."""
    value, expected, std_error = np.broadcast_arrays(value, expected, std_error)
    assert np.all(std_error < 0.02 * np.abs(expected)), f"too noisy: {std_error} of {expected}"
    z = (value - expected) / np.maximum(std_error, 1e-6 * np.abs(expected))
    assert np.all(np.abs(z) < sigmas), f"{value}, expected {expected} +- {std_error}: z = {z}"


def table_of(brdf, albedo, specular=0.0, tint=(1.0, 1.0, 1.0), n=18):
    """A table with `brdf(theta_i, theta_r, delta_phi)` in its cells and the given albedo by row."""
    edges, sectors = np.linspace(0, np.pi / 2, n + 1), np.linspace(0, np.pi, n + 1)
    mid, phi = 0.5 * (edges[1:] + edges[:-1]), 0.5 * (sectors[1:] + sectors[:-1])
    values = brdf(mid[:, None, None], mid[None, :, None], phi[None, None, :]) + np.zeros((n, n, n))
    tint = np.array(tint)
    return Table(
        values[..., None] * tint,
        mid,
        edges,
        sectors,
        ("R", "G", "B")[: len(tint)],
        np.outer(albedo + np.zeros(n), tint) + specular,
        theta_i_edges=edges,
        specular=specular,
    )


def lambert_table(albedo=1.0, **options):
    return table_of(lambda i, r, p: albedo / np.pi, albedo, **options)


def simple(shapes, environment=None, lights=(), camera=None, max_depth=16):
    return Scene(camera or spot(), tuple(shapes), environment, tuple(lights), max_depth)
