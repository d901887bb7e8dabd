"""From a scene's description to the arrays and the Embree scene its kernels take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.core import embree
from microgeometry.errors import InputError
from renderer.alias import alias_table
from renderer.camera import View
from renderer.environment import pack_environment
from renderer.geometry import Geometry
from renderer.integrator import World
from renderer.lights import AREA, DIRECTIONAL, DISK, ENVIRONMENT, POINT, SPHERE, TRIANGLE, Lights
from renderer.pack_materials import pack_materials
from renderer.scene import Array, Camera, DirectionalLight, Disk, Mesh, PointLight, Scene, Shape

STRATEGIES = {"mis": 0, "material": 1, "light": 2}
"""How paths find light: both ways combined, by the materials' samples alone, by the lights' alone."""


@dataclass(frozen=True, eq=False)
class Packed:
    """A scene ready to trace; `world` is valid as long as this object lives."""

    world: World
    embree_scene: embree.Scene


def pack(scene: Scene, strategy: str = "mis") -> Packed:
    """Build everything the kernels need.

    Parameters
    ----------
    scene : Scene
    strategy : {"mis", "material", "light"}
        For tests: pictures must agree, only their noise differs.

    Raises
    ------
    InputError
        A shape, material or light that cannot be used.
    """
    shapes: list[Shape] = [s for s in scene.shapes if isinstance(s, Mesh)]
    shapes += [s for s in scene.shapes if not isinstance(s, Mesh)]
    unique = list({id(s.material): s.material for s in shapes}.values())
    index = {id(material): i for i, material in enumerate(unique)}
    lights, light_of = _pack_lights(scene, shapes)
    embree_scene, geometry = _pack_geometry(shapes, [index[id(s.material)] for s in shapes], light_of)
    longest = scene.max_depth if scene.max_depth > 0 else 2**31 - 1
    limits = np.array([longest, scene.russian_roulette_depth, STRATEGIES[strategy]], np.int64)
    world = World(_pack_camera(scene.camera), geometry, pack_materials(unique), lights, limits)
    return Packed(world, embree_scene)


def _pack_camera(camera: Camera) -> View:
    to_world = np.array(camera.to_world, np.float64)
    axes = to_world[:3, :3]
    if to_world.shape != (4, 4) or not np.all(np.isfinite(to_world)) or abs(np.linalg.det(axes)) < 1e-12:
        raise InputError("camera: to_world is not an invertible 4 x 4 matrix of finite numbers")
    to_world[:3, :3] = axes / np.linalg.norm(axes, axis=0)
    return View(
        to_world,
        np.array(camera.tangents()),
        np.array([camera.aperture_radius, camera.focus_distance], np.float64),
        np.array([camera.width, camera.height], np.int64),
    )


def _disk_frame(disk: Disk) -> tuple[Array, Array, Array, Array]:
    """Centre, the two radii as vectors, and the unit normal of a disk."""
    m = np.asarray(disk.to_world, np.float64)
    s, t = m[:3, 0], m[:3, 1]
    size = np.linalg.norm(s)
    if size == 0 or abs(np.linalg.norm(t) - size) > 1e-6 * size or abs(s @ t) > 1e-6 * size**2:
        raise InputError("disk: to_world stretches the disk to an ellipse; uniform scaling is needed")
    normal = np.cross(s, t) / size**2
    normal *= np.sign(normal @ m[:3, 2]) or 1.0
    return m[:3, 3], s, t, -normal if disk.flip_normals else normal


def _pack_geometry(
    shapes: Sequence[Shape], material: list[int], light: list[int]
) -> tuple[embree.Scene, Geometry]:
    scene = embree.Scene()
    faces: list[NDArray[np.int32]] = [np.zeros((0, 3), np.int32)]
    normals: list[NDArray[np.float32]] = [np.zeros((0, 3), np.float32)]
    along: list[NDArray[np.float32]] = [np.zeros((0, 3), np.float32)]
    first_face, smooth, is_disk, quadric, extent = [], [], [], [], []
    n_faces, n_normals = 0, 0
    for shape in shapes:
        if isinstance(shape, Mesh):
            scene.add_triangles(shape.vertices, shape.faces)
            first_face.append(n_faces)
            smooth.append(shape.normals is not None)
            faces.append(np.asarray(shape.faces, np.int32) + (n_normals if shape.normals is not None else 0))
            n_faces += len(shape.faces)
            along.append(_face_tangents(shape))
            if shape.normals is not None:
                normals.append(np.asarray(shape.normals, np.float32))
                n_normals += len(shape.normals)
            extent.append(np.abs(shape.vertices).max())
        elif isinstance(shape, Disk):
            centre, s, _, normal = _disk_frame(shape)
            is_disk.append(1)
            quadric.append([*centre, np.linalg.norm(s), 1.0, *normal])
            extent.append(np.abs(centre).max() + np.linalg.norm(s))
        else:
            if not shape.radius > 0:
                raise InputError(f"sphere: radius is {shape.radius}; a positive length is needed")
            is_disk.append(0)
            quadric.append([*shape.center, shape.radius, -1.0 if shape.flip_normals else 1.0, *shape.axis])
            extent.append(np.abs(shape.center).max() + shape.radius)
    scene.commit()
    return scene, Geometry(
        scene.handle,
        np.array(material, np.int64),
        np.array(light, np.int64),
        np.array(extent, np.float64),
        np.array(first_face, np.int64),
        np.array(smooth, np.int64),
        np.ascontiguousarray(np.concatenate(faces), np.int32),
        np.ascontiguousarray(np.concatenate(normals), np.float32),
        np.ascontiguousarray(np.concatenate(along), np.float32),
        np.array(is_disk, np.int64),
        np.array(quadric, np.float64).reshape(-1, 8),
    )


def _face_tangents(mesh: Mesh) -> NDArray[np.float32]:
    """Unit direction in which u grows on each face, shape (F, 3); the mesh's x axis where there is no uv."""
    found = np.broadcast_to(np.asarray(mesh.x_axis, np.float64), (len(mesh.faces), 3)).copy()
    if mesh.uv is not None:
        vertices, uv = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.uv, np.float64)
        a, b, c = (mesh.faces[:, corner] for corner in range(3))
        (du1, dv1), (du2, dv2) = (uv[b] - uv[a]).T, (uv[c] - uv[a]).T
        area = du1 * dv2 - dv1 * du2
        grows = dv2[:, None] * (vertices[b] - vertices[a]) - dv1[:, None] * (vertices[c] - vertices[a])
        grows *= np.sign(area)[:, None]
        known = np.linalg.norm(grows, axis=1) > 0
        found[known] = grows[known]
    return (found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-30)).astype(np.float32)


def _primitives(shape: Shape) -> tuple[int, Array, Array]:
    """Kind, data (P, 12) and areas (P,) of the primitives an emitting shape consists of."""
    if isinstance(shape, Mesh):
        a, b, c = (np.asarray(shape.vertices, np.float64)[shape.faces[:, i]] for i in range(3))
        normal = np.cross(b - a, c - a)
        size = np.linalg.norm(normal, axis=1, keepdims=True)
        if not size.sum() > 0:
            raise InputError("area light: its shape has no area")
        return TRIANGLE, np.hstack([a, b - a, c - a, normal / np.where(size > 0, size, 1)]), size[:, 0] / 2
    if isinstance(shape, Disk):
        centre, s, t, normal = _disk_frame(shape)
        return DISK, np.concatenate([centre, s, t, normal])[None], np.array([np.pi * (s @ s)])
    data = np.array([[*shape.center, shape.radius, -1.0 if shape.flip_normals else 1.0] + [0.0] * 7])
    return SPHERE, data, np.array([4 * np.pi * shape.radius**2])


def _pack_lights(scene: Scene, shapes: Sequence[Shape]) -> tuple[Lights, list[int]]:
    kind, colour, vector, area, first, count = [], [], [], [], [], []
    primitive: list[int] = []
    data: list[Array] = [np.zeros((0, 12))]
    tables = [(np.zeros(0, np.float32), np.zeros(0, np.int32))]

    def add(what: int, rgb: Sequence[float], where: Sequence[float] = (0, 0, 0), size: float = 0.0) -> None:
        if not (np.all(np.isfinite(rgb)) and min(rgb) >= 0):
            raise InputError(f"light: colour {tuple(rgb)} has negative or non-finite numbers; >= 0 is needed")
        kind.append(what)
        colour.append(list(rgb))
        vector.append(list(where))
        area.append(size)
        first.append(len(primitive))
        count.append(0)

    if scene.environment is not None:
        add(ENVIRONMENT, (0, 0, 0))
    for light in scene.lights:
        if isinstance(light, PointLight):
            add(POINT, light.intensity, light.position)
        elif isinstance(light, DirectionalLight):
            length = float(np.linalg.norm(light.direction))
            if not length > 0:
                raise InputError("directional light: direction is zero; any other vector is allowed")
            add(DIRECTIONAL, light.irradiance, [float(x) / length for x in light.direction])
    light_of = []
    for shape in shapes:
        if shape.emission is None:
            light_of.append(-1)
            continue
        light_of.append(len(kind))
        what, rows, areas = _primitives(shape)
        add(AREA, shape.emission, size=float(areas.sum()))
        count[-1] = len(rows)
        primitive += [what] * len(rows)
        data.append(rows)
        tables.append(alias_table(areas))
    lights = Lights(
        np.array(kind, np.int64),
        np.array(colour, np.float64).reshape(-1, 3),
        np.array(vector, np.float64).reshape(-1, 3),
        np.array(area, np.float64),
        np.array(first, np.int64),
        np.array(count, np.int64),
        np.array(primitive, np.int64),
        np.concatenate(data),
        np.concatenate([table[0] for table in tables]),
        np.concatenate([table[1] for table in tables]),
        pack_environment(scene.environment),
    )
    return lights, light_of
