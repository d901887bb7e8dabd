"""A triangle mesh from a file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from microgeometry.errors import InputError
from microgeometry.keys import Keys
from microgeometry.tile import TriangleMesh

FORMATS = (".obj", ".ply", ".stl", ".glb", ".gltf")
# A triangle lower than this against its longest edge has no normal in double precision.
_DEGENERATE = 1e-12


@dataclass(frozen=True)
class Mesh:
    """One period of a surface as triangles, through trimesh: OBJ, PLY, STL, GLB; overhangs allowed.

    Keys of [surface]:

    - ``file``, relative to the specimen's folder. All meshes of a scene are merged.
    - ``units`` ("um") of its coordinates, whatever the format says.
    - ``up``: "z" or "y", the file's axis away from the surface. The default is "y" for GLB and glTF, which
      define it so (Blender turns a surface that way when it exports one), and "z" for the others.
      With "y", (x, y, z) becomes (x, -z, y), a rotation.
    - ``tiling``: "repeat" (default) takes the mesh as one period as it stands: right for a modelled unit
      cell, whose opposite edges match. "mirror" puts it beside its mirror images, 2 x 2, so that the edges
      meet whatever they are: right for a scan, which is not periodic; a surface with one-sided slopes
      loses its one-sidedness. Repeating a scan leaves open steps along the seam, through which light is
      lost, and the instrument says so: that is why it is not the default to mirror, which fails silently.

    The period is the mesh's bounding rectangle in x and y, moved so that it starts at (0, 0). Where the mesh
    stands does not matter, but STL and GLB, and often PLY, store single precision: of a mesh of size 1 at a
    distance of 1e6, they keep steps of 0.06. OBJ keeps what digits were written.

    Holes and rims that do not meet are not looked for here: the light that falls through them is counted.

    Attributes
    ----------
    file : Path
    unit : float
        Metres per unit of the file.
    up, tiling : str
    """

    kind: ClassVar[str] = "mesh"
    is_random: ClassVar[bool] = False

    file: Path
    unit: float
    up: str = "z"
    tiling: str = "repeat"

    @classmethod
    def from_keys(cls, keys: Keys, folder: Path) -> Mesh:
        """Build from the [surface] table; the file must exist, but is read at the first `realise`."""
        keys.allow("kind", "file", "units", "up", "tiling")
        file = folder / keys.text("file")
        suffix = file.suffix.lower()
        if suffix not in FORMATS:
            raise keys.error(
                "file",
                f"the format {suffix or 'without suffix'} is not read; allowed are {', '.join(FORMATS)}",
            )
        if not file.is_file():
            raise keys.error("file", f"there is no file {file}; paths are relative to the specimen's folder")
        up = keys.choice("up", "y" if suffix in (".glb", ".gltf") else "z", ("z", "y"))
        return cls(file, keys.metres_per_unit(), up, keys.choice("tiling", "repeat", ("repeat", "mirror")))

    @property
    def n_degenerate(self) -> int:
        """Number of the file's triangles that have no area and were dropped."""
        return self._read[1]

    def realise(self, seed: int) -> TriangleMesh:
        """Return the tile, the same for every seed; the file is read once.

        Raises
        ------
        InputError
            The file cannot be read, holds no triangle with an area, a vertex that is not finite, nothing
            that faces up, or no extent in x or y.
        """
        return self._read[0]

    @cached_property
    def _read(self) -> tuple[TriangleMesh, int]:
        vertices, faces = _load(self.file)
        if self.up == "y":
            vertices = np.column_stack((vertices[:, 0], -vertices[:, 2], vertices[:, 1]))
        good = _has_area(vertices, faces)
        faces = faces[good]
        if len(faces) == 0:
            raise InputError(
                f"{self.file}: all {len(good)} triangles are degenerate (no area); export the mesh again"
            )
        # Vertices no triangle uses must not widen the period.
        used, faces = np.unique(faces, return_inverse=True)
        vertices, faces = vertices[used], faces.reshape(-1, 3)
        low, extent = vertices.min(axis=0), np.ptp(vertices, axis=0)
        if min(extent[:2]) <= _DEGENERATE * extent.max():
            raise InputError(
                f"{self.file}: the mesh measures {extent[0]:g} x {extent[1]:g} in the plane, it "
                'does not lie above one; is z up in the file? set up = "y" or "z"'
            )
        vertices = (vertices - (low[0], low[1], 0.0)) * self.unit
        size = (float(vertices[:, 0].max()), float(vertices[:, 1].max()))
        if self.tiling == "mirror":
            for axis in (0, 1):
                vertices, faces = _with_mirror_image(vertices, faces, axis, size[axis])
            size = (2.0 * size[0], 2.0 * size[1])
        mesh = TriangleMesh(vertices, faces.astype(np.int32), (0.0, 0.0), size)
        if not (mesh.facets()[0][:, 2] > 0).any():
            raise InputError(
                f"{self.file}: no triangle faces up; reverse the faces in the program that made "
                "it, or set `up` under [surface]"
            )
        return mesh, int(np.count_nonzero(~good))


def _load(file: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Read vertices (V, 3), all of them finite, and faces (F, 3), F > 0, as the file has them."""
    import trimesh  # here, for the half second it takes

    try:
        # No processing: it would merge vertices, and silently drop those that are not finite.
        loaded = trimesh.load_mesh(str(file), process=False)
        vertices = np.array(loaded.vertices, dtype=np.float64)
        faces = np.array(loaded.faces, dtype=np.int64)
    except Exception as error:  # each of trimesh's readers has errors of its own
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{file}: the mesh cannot be read ({reason}); is the file complete?") from error
    if len(faces) == 0:
        raise InputError(f"{file}: the mesh is empty: {len(vertices)} vertices, no triangle")
    n_bad = np.count_nonzero(~np.isfinite(vertices).all(axis=1))
    if n_bad:
        raise InputError(f"{file}: {n_bad} of {len(vertices)} vertices are NaN or infinite; repair the mesh")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(f"{file}: a triangle names vertex {faces.max()} of {len(vertices)}; repair the mesh")
    return vertices, faces


def _has_area(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.bool_]:
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    longest = np.max([np.sum((p - q) ** 2, axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) > _DEGENERATE * longest


def _with_mirror_image(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], axis: int, length: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Append the mirror image in the plane x (or y) = length; its edges carry the same bits."""
    image = vertices.copy()
    image[:, axis] = 2.0 * length - image[:, axis]
    # A reflection turns the winding round; reading it backwards turns it back.
    return np.concatenate((vertices, image)), np.concatenate((faces, faces[:, ::-1] + len(vertices)))
