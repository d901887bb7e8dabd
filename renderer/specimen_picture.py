"""Pictures of a specimen's surfaces: a block of each, rendered from the triangles that are measured."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from microgeometry.tile import Tile
from renderer.block import Block, Triangles, cut_block
from renderer.image import Image
from renderer.render import render
from renderer.scene import Array, Camera, DirectionalLight, Environment, Material, Mesh, Scene, look_at

_WIDTH, _HEIGHT = 480, 360
_SUN_SPP, _SKY_SPP = 12, 32
_MARGIN = 0.86  # of the picture's half width, up to which the block reaches
_FOV_DEG = 16.0
# Radiance of a white surface that lies flat: under the sun, under the sky.
_SUN, _SKY = np.array([0.66, 0.64, 0.60]), np.array([0.37, 0.39, 0.43])
_CLAY, _PLANE = (0.64, 0.56, 0.47), (0.36, 0.46, 0.53)
_CUT, _GROUND = (0.36, 0.27, 0.22), (1.0, 1.0, 1.0)
# The camera sees the cut at y = 0, where grooves along y show their profile, and the one at the far end
# of x. The sun stands at the upper left of the picture, as on maps: it reaches neither cut, however low.
_CAMERA_AZIMUTH, _CAMERA_ELEVATION = math.radians(-73.0), math.radians(33.0)
_SUN_AZIMUTH = math.radians(165.0)
_SUN_LOWEST_DEG, _SUN_HIGHEST_DEG = 1.0, 40.0


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture of a block of surface.

    Attributes
    ----------
    image : Image
        White is radiance 1.
    block : Block
    sun_deg : float
        Elevation of the sun, degrees.
    edges : ndarray, shape (2, 2, 2)
        Where the lower front edges are in the image, pixels (x, y) of both ends: along x, along y.
    """

    image: Image
    block: Block
    sun_deg: float
    edges: Array


def surface_picture(
    tile: Tile, size: tuple[float, float] | None = None, two_materials: bool = False
) -> Picture:
    """Render a block of a surface in light clay, at its true vertical scale.

    The sun stands as low as shallow relief needs to be seen.

    Parameters
    ----------
    tile : Tile
    size : tuple of float, optional
        Widths of the block, metres; by default what shows some six hills.
    two_materials : bool
        Show facets of label 1, the plane of pits and bosses, in another colour.
    """
    block = cut_block(tile, size)
    alpha = tile.statistics().alpha
    sun_deg = _SUN_HIGHEST_DEG
    if alpha > 0:
        sun_deg = min(max(math.degrees(math.atan(2.0 * alpha)), _SUN_LOWEST_DEG), _SUN_HIGHEST_DEG)
    camera = _camera(block)
    scene = Scene(camera, _shapes(block, two_materials), max_depth=4)
    # Apart, because together a path would have to choose which to look at: the sun's light is without
    # noise, and the sky's where nothing stands before it.
    sun = _toward(_SUN_AZIMUTH, math.radians(sun_deg))
    light = DirectionalLight(tuple(-sun), tuple(math.pi * _SUN / sun[2]))
    sunlit = render(replace(scene, lights=(light,)), spp=_SUN_SPP)
    sky = Environment(_SKY[None, None])
    skylit = render(replace(scene, environment=sky), spp=_SKY_SPP, seed=1, strategy="material")
    image = Image(sunlit.pixels + skylit.pixels, np.hypot(sunlit.std_error, skylit.std_error))
    width, depth = block.size
    edges = np.array(
        [[[0, 0, block.base], [width, 0, block.base]], [[width, 0, block.base], [width, depth, block.base]]]
    )
    return Picture(image, block, sun_deg, _project(camera, edges))


def _toward(azimuth: float, elevation: float) -> Array:
    flat = math.cos(elevation)
    return np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)])


def _shapes(block: Block, two_materials: bool) -> tuple[Mesh, ...]:
    def mesh(triangles: Triangles, colour: tuple[float, float, float]) -> Mesh:
        return Mesh(*triangles, material=Material("diffuse", {"reflectance": colour}, two_sided=True))

    far = 30.0 * (1.0 + block.top - block.base)
    z = block.base
    square = np.array([[-far, -far, z], [far, -far, z], [far, far, z], [-far, far, z]])
    ground = square, np.array([[0, 1, 2], [0, 2, 3]])
    colours = _CLAY, _PLANE if two_materials else _CLAY
    tops = [mesh(top, colours[label]) for label, top in block.tops.items()]
    return (*tops, mesh(block.sides, _CUT), mesh(ground, _GROUND))


def _camera(block: Block) -> Camera:
    """From afar in a fixed direction, so near that the block just fills the picture."""
    toward = _toward(_CAMERA_AZIMUTH, _CAMERA_ELEVATION)
    corners = np.array(
        [[x, y, z] for x in (0, block.size[0]) for y in (0, block.size[1]) for z in (block.base, block.top)]
    )
    middle = corners.mean(axis=0)
    camera = Camera(look_at(middle + toward, middle, (0, 0, 1)), _FOV_DEG, width=_WIDTH, height=_HEIGHT)
    local = (corners - middle) @ camera.to_world[:3, :3]
    reach = np.abs(local[:, :2]) / (_MARGIN * np.array(camera.tangents()))
    distance = float(np.max(reach - local[:, 2:]))
    return replace(camera, to_world=look_at(middle + distance * toward, middle, (0, 0, 1)))


def _project(camera: Camera, points: Array) -> Array:
    """Pixels (x, y) where points (..., 3) are seen."""
    local = (points - camera.to_world[:3, 3]) @ camera.to_world[:3, :3]
    offset = local[..., :2] / (local[..., 2:] * np.array(camera.tangents()))
    return 0.5 * (1.0 - offset) * [camera.width, camera.height]
