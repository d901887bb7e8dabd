"""Scenes in Mitsuba 3's XML: the subset people use for material work, and two materials of our own.

=============  =====================================================================================
element        types
=============  =====================================================================================
sensor         perspective, thinlens (with film hdrfilm and any sampler; the film's filter is a box)
integrator     path (max_depth, -1 for no limit; 16 by default; rr_depth)
shape          sphere, disk, rectangle, cube, obj, ply
emitter        area (in a shape), envmap, constant, point, directional
bsdf           diffuse, conductor, roughconductor, dielectric, plastic, twosided, and ours:
               tabulated (string filename: a BRDF table), analytic (string filename: a fit)
=============  =====================================================================================

The x axis of an anisotropic table lies where u grows: along a sphere's parallels, away from a disk's centre, along a
rectangle's x, by the texture coordinates of an obj or ply. A cube, or a mesh without them, takes its own x axis,
projected onto the surface.

Whatever would change the picture and is not supported is an `InputError` that names the element.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, ParseError

import defusedxml
import defusedxml.ElementTree
import numpy as np

from gonio.table.anisotropic import AnisotropicTable
from gonio.table.table import Table
from microgeometry.errors import InputError
from renderer.image import read_exr
from renderer.meshes import cube, load_mesh, rectangle, transformed
from renderer.scene import (
    Camera,
    DirectionalLight,
    Disk,
    Environment,
    Material,
    Mesh,
    PointLight,
    Scene,
    Shape,
    Sphere,
)
from renderer.xml_materials import (
    analytic,
    check_channels,
    conductor,
    dielectric,
    diffuse,
    plastic,
    rough_conductor,
)
from renderer.xml_properties import Node


def load_scene(path: str | os.PathLike[str], parameters: Mapping[str, str] | None = None) -> Scene:
    """Read a scene.

    Parameters
    ----------
    path : path
        File names in it are relative to its folder.
    parameters : mapping of str to str, optional
        Values of the scene's ``$name`` parameters; they go before its ``<default>``.

    Raises
    ------
    InputError
        The file is missing or no XML, or an element in it cannot be used; one line says which and what
        is allowed.
    """
    path = Path(path)
    try:
        root = defusedxml.ElementTree.parse(path).getroot()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except (ParseError, defusedxml.DefusedXmlException, UnicodeDecodeError, ValueError) as error:
        raise InputError(f"{path}: is not a valid XML file: {error}") from None
    if root.tag != "scene":
        raise InputError(f"{path}: the outermost element is <{root.tag}>; <scene> is needed")
    return _Loader(path, root, dict(parameters or {})).scene()


class _Loader:
    def __init__(self, path: Path, root: Element, parameters: dict[str, str]) -> None:
        self.path = path
        values: dict[str, str] = {}
        for element in root.findall("default"):
            name, value = element.get("name"), element.get("value")
            if name is None or value is None:
                raise InputError(f"{path}: <default> needs the attributes name and value")
            values[name] = value
        unknown = sorted(set(parameters) - set(values) - _used(root))
        if unknown:
            known = ", ".join(sorted(set(values) | _used(root))) or "none"
            raise InputError(f"{path}: has no parameter {unknown[0]!r}; its parameters are {known}")
        self.root = Node(root, {**values, **parameters}, path)
        self.shared: dict[str, Material] = {}
        self.environment: Environment | None = None
        self.lights: list[PointLight | DirectionalLight] = []
        self.tables: dict[Path, Table | AnisotropicTable] = {}

    def scene(self) -> Scene:
        root = self.root
        root.nested("default")
        sensors = root.nested("sensor")
        if len(sensors) != 1:
            raise root.error(f"has {len(sensors)} sensors; exactly one is needed")
        camera, spp = _sensor(sensors[0])
        longest, roulette = 16, 5
        for node in root.nested("integrator"):
            longest, roulette = _integrator(node)
        for node in root.nested("bsdf"):
            self.shared[node.attribute("id")] = self.material(node)
        shapes = [self.shape(node) for node in root.nested("shape")]
        for node in root.nested("emitter"):
            self.emitter(node)
        root.finish()
        try:
            return Scene(
                camera, tuple(shapes), self.environment, tuple(self.lights), longest, roulette, spp, self.path
            )
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from None

    def material(self, node: Node) -> Material:
        makers: dict[str, Callable[[Node], Material]] = {
            "diffuse": diffuse,
            "conductor": conductor,
            "roughconductor": rough_conductor,
            "dielectric": dielectric,
            "plastic": plastic,
            "tabulated": self.tabulated,
            "analytic": analytic,
            "twosided": self.two_sided,
        }
        material = _choose(node, makers)(node)
        node.finish()
        return material

    def tabulated(self, node: Node) -> Material:
        path = node.file()
        if path not in self.tables:
            self.tables[path] = Table.load(path)
        table = self.tables[path]
        check_channels(node, path, table)
        return Material("tabulated", {"table": table, "filename": str(path)})

    def two_sided(self, node: Node) -> Material:
        inner = self.inner_material(node)
        if inner is None:
            raise node.error("has no material inside; one <bsdf> or <ref> is needed")
        return inner if inner.kind == "dielectric" else replace(inner, two_sided=True)

    def inner_material(self, node: Node) -> Material | None:
        inner = [*node.nested("bsdf"), *node.nested("ref")]
        if len(inner) > 1:
            raise node.error(f"has {len(inner)} materials; one is allowed")
        for child in inner:
            if child.tag == "bsdf":
                return self.material(child)
            name = child.attribute("id")
            if name not in self.shared:
                known = ", ".join(sorted(self.shared)) or "none"
                raise child.error(f"no <bsdf> of this id stands in the scene; those that do: {known}")
            return self.shared[name]
        return None

    def shape(self, node: Node) -> Shape:
        makers: dict[str, Callable[[Node], Shape]] = {
            "sphere": _sphere,
            "disk": lambda n: Disk(n.matrix(), n.flag("flip_normals")),
            "rectangle": lambda n: _mesh(n, rectangle()),
            "cube": lambda n: _mesh(n, cube()),
            "obj": _mesh_file,
            "ply": _mesh_file,
        }
        material = self.inner_material(node)
        emission = None
        for child in node.nested("emitter"):
            if child.type != "area":
                raise child.error("cannot stand in a shape; area can")
            emission = child.rgb("radiance")
            child.finish()
        shape = _choose(node, makers)(node)
        node.finish()
        return replace(shape, material=material or Material(), emission=emission)

    def emitter(self, node: Node) -> None:
        if node.type in ("envmap", "constant") and self.environment is not None:
            raise node.error("is a second environment; one envmap or constant is allowed")
        if node.type == "constant":
            self.environment = Environment(np.reshape(node.rgb("radiance"), (1, 1, 3)))
        elif node.type == "envmap":
            image = read_exr(node.file())
            self.environment = Environment(image, node.matrix(), float(node.number("scale", 1.0)))
        elif node.type == "point":
            default = tuple(node.matrix()[:3, 3])
            self.lights.append(PointLight(node.take("position", default, ("point",)), node.rgb("intensity")))
        elif node.type == "directional":
            default = tuple(node.matrix()[:3, 2])
            direction = node.take("direction", default, ("vector",))
            self.lights.append(DirectionalLight(direction, node.rgb("irradiance")))
        else:
            raise node.error("is not supported here; allowed are envmap, constant, point, directional")
        node.finish()


def _used(root: Element) -> set[str]:
    """Names that may be parameters: words after a $ anywhere."""
    texts = [value for element in root.iter() for value in element.attrib.values()]
    return {name for text in texts for name in re.findall(r"\$(\w+)", text)}


def _choose(node: Node, makers: Mapping[str, Any]) -> Any:
    if node.type not in makers:
        raise node.error(f"type {node.type!r} is not supported; allowed are {', '.join(makers)}")
    return makers[node.type]


def _sensor(node: Node) -> tuple[Camera, int]:
    if node.type not in ("perspective", "thinlens"):
        raise node.error(f"type {node.type!r} is not supported; allowed are perspective, thinlens")
    node.ignore("near_clip", "far_clip", "shutter_open", "shutter_close")
    axis = node.string("fov_axis", "x")
    axes = ("x", "y", "diagonal", "smaller", "larger")
    if axis not in axes:
        raise node.error(f"fov_axis is {axis!r}; allowed are {', '.join(axes)}")
    lens = node.type == "thinlens"
    focus = float(node.number("focus_distance", 1.0))
    if lens and not focus > 0:
        raise node.error(f"focus_distance is {focus}; a positive length is needed")
    width, height = 768, 576
    for film in node.nested("film"):
        if film.type != "hdrfilm":
            raise film.error(f"type {film.type!r} is not supported; hdrfilm is")
        film.ignore("pixel_format", "component_format", "file_format", "compensate")
        film.nested("rfilter")
        width, height = film.take("width", 768, ("integer",)), film.take("height", 576, ("integer",))
        film.finish()
    spp = 16
    for sampler in node.nested("sampler"):
        spp = sampler.take("sample_count", 16, ("integer",))
    camera = Camera(
        node.matrix(),
        float(node.number("fov")),
        axis,
        width,
        height,
        float(node.number("aperture_radius")) if lens else 0.0,
        focus,
    )
    node.finish()
    return camera, spp


def _integrator(node: Node) -> tuple[int, int]:
    if node.type != "path":
        raise node.error(f"type {node.type!r} is not supported; path is")
    if node.flag("hide_emitters"):
        raise node.error("hide_emitters is not supported; lights are visible")
    depth, roulette = node.take("max_depth", 16, ("integer",)), node.take("rr_depth", 5, ("integer",))
    node.finish()
    return depth, max(1, roulette)


def _sphere(node: Node) -> Sphere:
    center = np.array(node.take("center", (0.0, 0.0, 0.0), ("point",)))
    radius = float(node.number("radius", 1.0))
    matrix = node.matrix()
    linear = matrix[:3, :3]
    scale = abs(np.linalg.det(linear)) ** (1 / 3)
    if not np.allclose(linear.T @ linear, scale**2 * np.eye(3), atol=1e-6 * scale**2):
        raise node.error("to_world stretches the sphere; uniform scaling, or a mesh, is needed")
    if not radius * scale > 0:
        raise node.error(f"radius is {radius * scale}; a positive length is needed")
    x, y, z = (float(v) for v in linear @ center + matrix[:3, 3])
    a, b, c = (float(v) for v in linear[:, 2] / scale)
    return Sphere((x, y, z), float(radius * scale), node.flag("flip_normals"), axis=(a, b, c))


def _mesh(node: Node, mesh: Mesh) -> Mesh:
    try:
        return transformed(mesh, node.matrix(), flip=node.flag("flip_normals"))
    except InputError as error:
        raise node.error(str(error)) from None


def _mesh_file(node: Node) -> Mesh:
    node.ignore("flip_tex_coords")
    return _mesh(node, load_mesh(node.file(), face_normals=node.flag("face_normals")))
