"""A layer of spheres on a plane."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from microgeometry.keys import Keys
from microgeometry.surfaces.caps import MAX_COVER, arrange
from microgeometry.surfaces.periodic import cut_to_tile
from microgeometry.tile import TriangleMesh

_N_RANDOM = 16
# A sphere stands off the plane by this part of its radius: at a point of contact facets would cross.
_GAP = 1e-3


@dataclass(frozen=True)
class Spheres:
    """One layer of equal spheres on the plane z = 0, which light reaches between and under them.

    Keys of [surface]:

    - ``cover``: the fraction of the plane beneath spheres, 0.01 to 0.9 (hexagonal), 0.78 (square) or 0.45
      (random). At the upper limits the first two all but touch.
    - ``arrangement``: "hexagonal" (default), "square", or "random": centres drawn one after the other, each
      kept if its sphere overlaps none before (16 to a tile).
    - ``radius`` (1) in ``units`` ("um"). It changes no result in geometric optics.
    - ``subdivisions`` (4): each sphere is an icosahedron subdivided so often, 20 * 4^subdivisions triangles
      with their vertices on the sphere; at 4 it lacks 0.12 % of its area.

    Each sphere is turned at random, anew for each seed: on mirrors a facet is a delta, and only an average
    over many polyhedra is as smooth as a sphere.

    Attributes
    ----------
    cover : float
    arrangement : str
    radius : float
        Metres.
    subdivisions : int
    """

    kind: ClassVar[str] = "spheres"
    is_random: ClassVar[bool] = True

    cover: float
    arrangement: str
    radius: float
    subdivisions: int

    @classmethod
    def from_keys(cls, keys: Keys, folder: Path) -> Spheres:
        """Build from the [surface] table."""
        keys.allow("kind", "cover", "arrangement", "radius", "subdivisions", "units")
        arrangement = keys.choice("arrangement", "hexagonal", MAX_COVER)
        return cls(
            cover=keys.number("cover", at_least=0.01, at_most=MAX_COVER[arrangement]),
            arrangement=arrangement,
            radius=keys.number("radius", 1.0, above=0) * keys.metres_per_unit(),
            subdivisions=keys.integer("subdivisions", 4, at_least=1, at_most=6),
        )

    def realise(self, seed: int) -> TriangleMesh:
        """Return the realisation of a seed."""
        rng = np.random.Generator(np.random.PCG64(seed))
        size, centres = arrange(rng, self.arrangement, self.cover, 1.0, _N_RANDOM)
        sphere, triangles = _icosphere(self.subdivisions)
        corners = np.array([(0, 0, 0), (size[0], 0, 0), (size[0], size[1], 0), (0, size[1], 0)])
        vertices, faces = [corners], [np.array([(0, 1, 2), (0, 2, 3)])]
        for k, centre in enumerate(centres):
            vertices.append(sphere @ _rotation(rng) + (*centre, 1.0 + _GAP))
            faces.append(triangles + (4 + k * len(sphere)))
        tile = cut_to_tile(np.concatenate(vertices), np.concatenate(faces), size)
        periods = (size[0] * self.radius, size[1] * self.radius)
        return TriangleMesh(tile.vertices * self.radius, tile.faces, (0.0, 0.0), periods)


def _rotation(rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw a rotation, uniformly: that of a quaternion uniform on its sphere."""
    w, x, y, z = (q := rng.normal(size=4)) / np.linalg.norm(q)
    return np.array(
        [
            (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
            (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
            (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
        ]
    )


@cache
def _icosphere(subdivisions: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    import trimesh  # here, for the half second it takes

    sphere = trimesh.creation.icosphere(subdivisions, radius=1.0)
    return np.array(sphere.vertices), np.array(sphere.faces, dtype=np.int64)
