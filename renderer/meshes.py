"""Triangle meshes: the built-in ones, and files through trimesh."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from trimesh.exchange.obj import load_obj
from trimesh.exchange.ply import load_ply

from microgeometry.errors import InputError
from renderer.scene import Array, Mesh

_CUBE_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
# Counter-clockwise seen from outside; corner number is 4 x + 2 y + z with 0 for -1
_CUBE_QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
_SQUARE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)


def rectangle() -> Mesh:
    """The square [-1, 1]^2 in the plane z = 0 with normal +z."""
    return Mesh(_SQUARE, np.array([[0, 1, 2], [0, 2, 3]]))


def cube() -> Mesh:
    """The cube [-1, 1]^3 with normals outwards."""
    return Mesh(_CUBE_CORNERS, np.concatenate([_CUBE_QUADS[:, [0, 1, 2]], _CUBE_QUADS[:, [0, 2, 3]]]))


def load_mesh(path: Path, *, face_normals: bool = False) -> Mesh:
    """Read an OBJ or PLY file.

    Parameters
    ----------
    path : Path
        Told apart by suffix.
    face_normals : bool
        Shade flat even where the file has vertex normals.

    Raises
    ------
    InputError
        The file is missing, not a mesh, or has no triangles.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such mesh file")
    try:
        parts = _parts(path)
    except Exception as error:  # trimesh's readers raise whatever the bytes make them stumble over
        raise InputError(f"{path}: cannot be read as a mesh: {' '.join(str(error).split())}") from None
    parts = [part for part in parts if len(part.get("faces", ())) > 0]
    if not parts:
        raise InputError(f"{path}: has no triangles; a mesh with at least one is needed")
    counts = np.cumsum([0, *(len(part["vertices"]) for part in parts)])
    vertices = np.concatenate([np.asarray(part["vertices"], np.float64) for part in parts])
    faces = np.concatenate(
        [
            trimesh.geometry.triangulate_quads(part["faces"]).astype(np.int64) + first
            for part, first in zip(parts, counts, strict=False)
        ]
    )
    if not np.all(np.isfinite(vertices)) or faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(f"{path}: has vertices that are not finite, or faces of vertices that do not exist")
    normals: list[Any] = [part.get("vertex_normals") for part in parts]
    uv = _uv(parts)
    if face_normals or any(
        n is None or len(n) != len(p["vertices"]) for n, p in zip(normals, parts, strict=True)
    ):
        return Mesh(vertices, faces, uv=uv)
    return Mesh(vertices, faces, np.concatenate(normals).astype(np.float64), uv=uv)


def _uv(parts: list[dict[str, Any]]) -> Array | None:
    """Texture coordinates, where every vertex of every part has finite ones."""
    found: list[Any] = [getattr(part.get("visual"), "uv", None) for part in parts]
    for part, uv in zip(parts, found, strict=True):
        if uv is None or np.shape(uv) != (len(part["vertices"]), 2) or not np.all(np.isfinite(uv)):
            return None
    return np.concatenate(found).astype(np.float64)


def _parts(path: Path) -> list[dict[str, Any]]:
    """Vertices, faces and perhaps vertex normals of a file's parts.

    From trimesh's readers directly: a Trimesh object forgets whether its normals were the file's.
    """
    with open(path, "rb") as file:
        if path.suffix.lower() == ".ply":
            return [load_ply(file)]
        content = load_obj(file, maintain_order=True, skip_materials=True)
    return list(content["geometry"].values()) if "geometry" in content else [content]


def transformed(mesh: Mesh, to_world: Array, *, flip: bool = False) -> Mesh:
    """The mesh in world space; normals stay outside under mirroring, and turn inside if `flip`.

    Raises
    ------
    InputError
        The transform flattens the mesh or is not finite.
    """
    linear = to_world[:3, :3]
    determinant = np.linalg.det(linear)
    if not np.isfinite(determinant) or determinant == 0 or not np.allclose(to_world[3], [0, 0, 0, 1]):
        raise InputError("to_world is not an invertible affine transform")
    vertices = mesh.vertices @ linear.T + to_world[:3, 3]
    inside_out = (determinant < 0) != flip
    faces = mesh.faces[:, ::-1] if inside_out else mesh.faces
    normals = mesh.normals
    if normals is not None:
        normals = normals @ np.linalg.inv(linear)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        normals = -normals if flip else normals
    x, y, z = (float(c) for c in linear @ np.array(mesh.x_axis))
    return Mesh(vertices, faces, normals, mesh.material, mesh.emission, mesh.uv, (x, y, z))
