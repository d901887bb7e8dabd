"""Spheres on a plane: one layer of them, or a bed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from microgeometry.keys import Keys
from microgeometry.surfaces.caps import MAX_COVER, arrange
from microgeometry.surfaces.packing import pack
from microgeometry.surfaces.periodic import cut_to_tile
from microgeometry.tile import TriangleMesh

_N_RANDOM = 16
# A sphere stands off the plane, and in a bed off its neighbours, by this part of its radius: at a point of
# contact facets would cross.
_GAP = 1e-3
_BED = 12.0  # side of a bed's tile in radii, about
MAX_FRACTION = 0.5  # above 0.55 a bed of few layers is jammed, and slow to find room long before


@dataclass(frozen=True)
class Spheres:
    """Equal spheres on the plane z = 0, which light reaches between and under them.

    Keys of [surface]:

    - ``arrangement``: in one layer "hexagonal" (default), "square" or "random": centres drawn one after the
      other, each kept if its sphere overlaps none before (16 to a tile). Or "packed": a bed of spheres at
      random, such as pigment without its binder.
    - ``cover``, of one layer: the fraction of the plane beneath spheres, 0.01 to 0.9 (hexagonal), 0.78 (square)
      or 0.45 (random). At the upper limits the first two all but touch.
    - ``fraction`` (0.4), of a bed: volume of the spheres / volume of the bed, 0.01 to 0.5.
    - ``layers`` (4), of a bed: its thickness in diameters, a whole number up to 20; within it the spheres
      are in no layers.
    - ``radius`` (1) in ``units`` ("um"). It changes no result in geometric optics.
    - ``subdivisions`` (4, in a bed 3): each sphere is an icosahedron subdivided so often, 20 * 4^subdivisions
      triangles with their vertices on the sphere; at 4 it lacks 0.12 % of its area, at 3 0.47 %.

    Each sphere is turned at random, anew for each seed: on mirrors a facet is a delta, and only an average
    over many polyhedra is as smooth as a sphere.

    Attributes
    ----------
    density : float
        The cover, or the fraction of a bed.
    arrangement : str
    layers : int
        1 if not "packed".
    radius : float
        Metres.
    subdivisions : int
    """

    kind: ClassVar[str] = "spheres"
    is_random: ClassVar[bool] = True

    density: float
    arrangement: str
    layers: int
    radius: float
    subdivisions: int

    @classmethod
    def from_keys(cls, keys: Keys, folder: Path) -> Spheres:
        """Build from the [surface] table."""
        arrangement = keys.choice("arrangement", "hexagonal", (*MAX_COVER, "packed"))
        packed = arrangement == "packed"
        density = ("fraction", "layers") if packed else ("cover",)
        keys.allow("kind", *density, "arrangement", "radius", "subdivisions", "units")
        return cls(
            density=keys.number("fraction", 0.4, at_least=0.01, at_most=MAX_FRACTION)
            if packed
            else keys.number("cover", at_least=0.01, at_most=MAX_COVER[arrangement]),
            arrangement=arrangement,
            layers=keys.integer("layers", 4, at_least=1, at_most=20) if packed else 1,
            radius=keys.number("radius", 1.0, above=0) * keys.metres_per_unit(),
            subdivisions=keys.integer("subdivisions", 3 if packed else 4, at_least=1, at_most=6),
        )

    def realise(self, seed: int) -> TriangleMesh:
        """Return the realisation of a seed."""
        rng = np.random.Generator(np.random.PCG64(seed))
        if self.arrangement == "packed":
            side, centres = pack(rng, self.density, 2.0 * self.layers, _BED, _GAP)
            size = (side, side)
        else:
            size, plan = arrange(rng, self.arrangement, self.density, 1.0, _N_RANDOM)
            centres = np.column_stack((plan, np.full(len(plan), 1.0 + _GAP)))
        sphere, triangles = _icosphere(self.subdivisions)
        corners = np.array([(0, 0, 0), (size[0], 0, 0), (size[0], size[1], 0), (0, size[1], 0)])
        vertices, faces = [corners], [np.array([(0, 1, 2), (0, 2, 3)])]
        for k, centre in enumerate(centres):
            vertices.append(sphere @ _rotation(rng) + centre)
            faces.append(triangles + (4 + k * len(sphere)))
        together = np.concatenate(faces)
        labels = np.zeros(len(together), np.uint8)
        labels[:2] = 1
        tile = cut_to_tile(np.concatenate(vertices), together, size, labels)
        periods = (size[0] * self.radius, size[1] * self.radius)
        return TriangleMesh(tile.vertices * self.radius, tile.faces, (0.0, 0.0), periods, tile.labels)


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
