"""Pictures of a specimen's surfaces, rendered from the very triangles that are measured."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from microgeometry.tile import Tile
from renderer.block import Block, Triangles, cut_block
from renderer.image import Image
from renderer.render import render
from renderer.scene import Array, Camera, DirectionalLight, Environment, Material, Mesh, Scene, look_at

_WIDTH, _HEIGHT, _SPP = 560, 400, 16
_SUN, _SKY = np.array([0.85, 0.82, 0.77]), np.array([0.36, 0.38, 0.42])
_CLAY, _PLANE, _CUT, _GROUND = (0.74, 0.66, 0.56), (0.45, 0.55, 0.62), (0.30, 0.23, 0.19), (0.80, 0.80, 0.80)
_FOV_DEG = 16.0
# The camera sees the cut y = 0, where grooves show their profile, and the far end of x; the sun stands at
# the upper left of the picture, as on maps.
_CAMERA_AZIMUTH, _CAMERA_ELEVATION = math.radians(-62.0), math.radians(33.0)
_SUN_AZIMUTH = math.radians(172.0)


def _toward(azimuth: float, elevation: float) -> Array:
    return np.array(
        [
            math.cos(elevation) * math.cos(azimuth),
            math.cos(elevation) * math.sin(azimuth),
            math.sin(elevation),
        ]
    )



def block_scenes(block: Block, sun_elevation: float, width: int = _WIDTH, height: int = _HEIGHT) -> tuple[Scene, Scene]:
    def mesh(triangles: Triangles, colour: tuple[float, float, float]) -> Mesh:
        return Mesh(*triangles, material=Material("diffuse", {"reflectance": colour}, two_sided=True))

    far = 1e3 * (1 + block.top - block.base)
    ground = (
        np.array([[-far, -far, block.base], [far, -far, block.base], [far, far, block.base], [-far, far, block.base]]),
        np.array([[0, 1, 2], [0, 2, 3]]),
    )
    shapes = [mesh(top, (_CLAY, _PLANE)[label]) for label, top in block.tops.items()]
    shapes += [mesh(block.sides, _CUT), mesh(ground, _GROUND)]
    sun = _toward(_SUN_AZIMUTH, sun_elevation)
    irradiance = np.pi * _SUN / sun[2]
    scene = Scene(_camera(block, width, height), tuple(shapes), max_depth=4)
    return (
        replace(scene, lights=(DirectionalLight(tuple(-sun), tuple(irradiance)),)),
        replace(scene, environment=Environment(_SKY.reshape(1, 1, 3))),
    )


def _camera(block: Block, width: int, height: int) -> Camera:
    """From afar, so near that the block just fills the picture."""
    toward = _toward(_CAMERA_AZIMUTH, _CAMERA_ELEVATION)
    middle = np.array([block.size[0] / 2, block.size[1] / 2, (block.base + block.top) / 2])
    corners = np.array(
        [[x, y, z] for x in (0, block.size[0]) for y in (0, block.size[1]) for z in (block.base, block.top)]
    )
    frame = look_at(middle + toward, middle, (0, 0, 1))
    local = (corners - middle) @ frame[:3, :3]
    tangent = 0.94 * math.tan(math.radians(_FOV_DEG) / 2)
    tangents = np.array([tangent, tangent * height / width])
    distance = float(np.max(np.abs(local[:, :2]) / tangents - local[:, 2:]))
    return Camera(look_at(middle + distance * toward, middle, (0, 0, 1)), _FOV_DEG, width=width, height=height)


def surface_picture(tile: Tile) -> Image:
    block = cut_block(tile)
    alpha = tile.statistics().alpha
    elevation = float(np.clip(math.atan(2.0 * alpha), math.radians(3.0), math.radians(40.0)))
    sun, sky = block_scenes(block, elevation)
    a = render(sun, spp=_SPP)
    b = render(sky, spp=_SPP, strategy="material", seed=1)
    return Image(a.pixels + b.pixels, np.hypot(a.std_error, b.std_error), {"seconds": (a.provenance["seconds"], b.provenance["seconds"])})
