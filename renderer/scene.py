"""What a scene is: a camera, shapes with materials, and lights, as plain descriptions.

World space is right-handed, in whatever unit the scene uses. Colours are linear RGB (ITU-R BT.709
primaries), radiance and reflectance alike. The meaning of every field is that of Mitsuba 3, so that
the same scene makes the same picture in both. `renderer.pack` turns a description into arrays.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microgeometry.errors import InputError

Array = NDArray[np.float64]
RGB = tuple[float, float, float]


def look_at(origin: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 1.0, 0.0)) -> Array:
    """The transform of a camera (or light) at `origin` whose +z looks at `target`, shape (4, 4).

    Raises
    ------
    InputError
        `up` is parallel to the view, or `origin` is `target`.
    """
    origin, up = np.asarray(origin, np.float64), np.asarray(up, np.float64)
    forward = np.asarray(target, np.float64) - origin
    left = np.cross(up, forward)
    if np.linalg.norm(left) <= 1e-9 * np.linalg.norm(up) * np.linalg.norm(forward):
        raise InputError("look_at: up is parallel to the view, or origin is target; another up is needed")
    forward, left = forward / np.linalg.norm(forward), left / np.linalg.norm(left)
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([left, np.cross(forward, left), forward, origin])
    return matrix


@dataclass(frozen=True, eq=False)
class Camera:
    """A perspective camera, with an aperture if `aperture_radius` > 0.

    Parameters
    ----------
    to_world : ndarray, shape (4, 4)
        The camera looks along its +z, +y is up and +x points to the left of the image.
    fov_deg : float
        Full angle of view along `fov_axis`, degrees.
    fov_axis : {"x", "y", "diagonal", "smaller", "larger"}
        The image axis that `fov_deg` spans.
    width, height : int
        Pixels.
    aperture_radius, focus_distance : float
        World units; objects at `focus_distance` along the view axis are sharp.
    """

    to_world: Array = field(default_factory=lambda: np.eye(4))
    fov_deg: float = 40.0
    fov_axis: str = "x"
    width: int = 256
    height: int = 256
    aperture_radius: float = 0.0
    focus_distance: float = 1.0

    def tangents(self) -> tuple[float, float]:
        """Tangents of half the horizontal and half the vertical angle of view."""
        tangent = float(np.tan(np.radians(self.fov_deg) / 2))
        ratio = self.width / self.height
        axis = self.fov_axis
        if axis in ("smaller", "larger"):
            axis = "x" if (axis == "larger") == (ratio >= 1) else "y"
        if axis == "diagonal":
            tangent, axis = tangent / float(np.hypot(1.0, 1.0 / ratio)), "x"
        return (tangent, tangent / ratio) if axis == "x" else (tangent * ratio, tangent)


@dataclass(frozen=True, eq=False)
class Material:
    """How a surface reflects.

    Parameters
    ----------
    kind : str
        "diffuse", "conductor", "rough_conductor", "dielectric", "plastic", "tabulated", "analytic"
        or "none" (absorbs everything).
    values : mapping of str to value
        What the kind needs, e.g. ``reflectance`` (RGB), ``eta`` and ``k`` (RGB), ``alpha``.
    two_sided : bool
        Whether the back reflects like the front; otherwise the back is black (not for "dielectric").
    """

    kind: str = "diffuse"
    values: dict[str, Any] = field(default_factory=lambda: {"reflectance": (0.5, 0.5, 0.5)})
    two_sided: bool = False


@dataclass(frozen=True, eq=False)
class Sphere:
    """A sphere, traced exactly. Normals point outwards, inwards if `flip_normals`.

    `axis` goes through the poles; the x axis of an anisotropic material runs along the parallels about it,
    eastwards.
    """

    center: RGB = (0.0, 0.0, 0.0)
    radius: float = 1.0
    flip_normals: bool = False
    material: Material = field(default_factory=Material)
    emission: RGB | None = None
    axis: RGB = (0.0, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Disk:
    """The unit disk in the plane z = 0 with normal +z, traced exactly, under a similarity transform.

    The x axis of an anisotropic material points away from the centre.
    """

    to_world: Array = field(default_factory=lambda: np.eye(4))
    flip_normals: bool = False
    material: Material = field(default_factory=Material)
    emission: RGB | None = None


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
        World space.
    faces : ndarray of int, shape (F, 3)
        Counter-clockwise about the outward normal.
    normals : ndarray, shape (V, 3), optional
        Vertex normals to interpolate for shading; None shades flat.
    uv : ndarray, shape (V, 2), optional
        The x axis of an anisotropic material points where u grows.
    x_axis : tuple of float
        What stands in for it, projected onto the surface, where there is no uv.
    """

    vertices: Array
    faces: NDArray[np.int64]
    normals: Array | None = None
    material: Material = field(default_factory=Material)
    emission: RGB | None = None
    uv: Array | None = None
    x_axis: RGB = (1.0, 0.0, 0.0)


Shape = Sphere | Disk | Mesh


@dataclass(frozen=True, eq=False)
class Environment:
    """Light from infinitely far away, all around.

    Parameters
    ----------
    radiance : ndarray, shape (H, W, 3)
        Latitude-longitude map in Mitsuba's convention, in the map's own frame: the first row looks to +y
        and the last to -y; the left and right edges look to -z, the middle to +z, a quarter from the left
        to +x. One pixel is a constant environment.
    to_world : ndarray, shape (4, 4)
        Rotation of the map's frame into the world.
    scale : float
        Factor on every pixel.
    """

    radiance: Array
    to_world: Array = field(default_factory=lambda: np.eye(4))
    scale: float = 1.0


@dataclass(frozen=True)
class PointLight:
    """A point that sends `intensity` (power per solid angle) in every direction."""

    position: RGB
    intensity: RGB


@dataclass(frozen=True)
class DirectionalLight:
    """Parallel light along `direction` of `irradiance` on a surface that faces it."""

    direction: RGB
    irradiance: RGB


@dataclass(frozen=True, eq=False)
class Scene:
    """A picture waiting to be taken.

    Parameters
    ----------
    camera : Camera
    shapes : sequence of Sphere, Disk or Mesh
    environment : Environment, optional
    lights : sequence of PointLight or DirectionalLight
        Area lights are shapes with an `emission`.
    max_depth : int
        Longest path in segments: 1 shows lights only, 2 direct light. -1 leaves it to Russian roulette.
    russian_roulette_depth : int
        Segments from which paths may be ended at random.
    spp : int
        Samples a pixel unless the caller says otherwise.
    source : Path, optional
        File the scene came from, for messages.
    """

    camera: Camera
    shapes: tuple[Shape, ...] = ()
    environment: Environment | None = None
    lights: tuple[PointLight | DirectionalLight, ...] = ()
    max_depth: int = 16
    russian_roulette_depth: int = 5
    spp: int = 16
    source: Path | None = None

    def __post_init__(self) -> None:
        camera = self.camera
        if not (0 < camera.fov_deg < 180):
            raise InputError(f"camera: fov is {camera.fov_deg}; an angle between 0 and 180 degrees is needed")
        for name in ("width", "height"):
            value = getattr(camera, name)
            if not 1 <= value <= 65536:
                raise InputError(f"camera: {name} is {value}; 1 to 65536 pixels are allowed")
        if self.max_depth == 0 or self.max_depth < -1:
            raise InputError(f"max_depth is {self.max_depth}; at least 1, or -1 for no limit, is needed")
        if self.spp < 1:
            raise InputError(f"sample count is {self.spp}; at least 1 is needed")
        object.__setattr__(self, "shapes", tuple(self.shapes))
        object.__setattr__(self, "lights", tuple(self.lights))
