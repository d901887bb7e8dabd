"""Parallel and woven fibres."""

from __future__ import annotations

from dataclasses import dataclass
from math import asin, atan2, hypot, pi
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from microgeometry.keys import Keys
from microgeometry.surfaces.periodic import cut_to_tile
from microgeometry.tile import TriangleMesh

# What touches stands this part of the radius apart: at a point of contact facets would cross.
_GAP = 1e-3
# A plain weave of round fibres can be no closer (Peirce 1937): there the fibres turn by 60 degrees and have
# no straight part left. A little above, for the gap.
MIN_PITCH = {"parallel": 1.0, "plain": 1.75}


@dataclass(frozen=True)
class Fibres:
    """Round fibres, side by side along y, or woven: warp along y, weft along x.

    Keys of [surface]:

    - ``weave``: "parallel" (default), or "plain": each fibre goes over one and under the next, and its
      neighbour the other way round.
    - ``pitch``, from one fibre to the next in diameters: 1 to 10 (1), woven 1.75 to 10 (2). Where fibres do
      not touch, light passes between them to a plane on which they lie. Parallel ones that touch (1) are
      built as their upper halves, which are all that light meets.
    - ``radius`` (1) in ``units`` ("um"), which changes no result in geometric optics.
    - ``segments`` (64) around half a fibre.

    The fibres of a weave follow Peirce's geometry (Journal of the Textile Institute 28, T45, 1937), both sets
    alike: where one crosses another its axis is an arc about that one's, of a diameter as its radius, and
    between the arcs straight.

    A fibre is a polyhedron with its vertices on the cylinder. They are turned anew for each seed, so that over
    the seeds facets take every inclination.

    Attributes
    ----------
    radius : float
        Metres; a parallel fibre's period is 2 radius pitch, a weave's twice that.
    segments : int
    weave : str
    pitch : float
        Diameters.
    """

    kind: ClassVar[str] = "fibres"
    is_random: ClassVar[bool] = True

    radius: float
    segments: int
    weave: str = "parallel"
    pitch: float = 1.0

    @classmethod
    def from_keys(cls, keys: Keys, folder: Path) -> Fibres:
        """Build from the [surface] table."""
        keys.allow("kind", "weave", "pitch", "radius", "segments", "units")
        weave = keys.choice("weave", "parallel", MIN_PITCH)
        return cls(
            radius=keys.number("radius", 1.0, above=0) * keys.metres_per_unit(),
            segments=keys.integer("segments", 64, at_least=8 if weave == "parallel" else 16, at_most=1024),
            weave=weave,
            pitch=keys.number(
                "pitch", 1.0 if weave == "parallel" else 2.0, at_least=MIN_PITCH[weave], at_most=10
            ),
        )

    def realise(self, seed: int) -> TriangleMesh:
        """Return one parallel fibre, or two by two woven ones."""
        rng = np.random.Generator(np.random.PCG64(seed))
        # In units of the radius.
        if self.weave == "plain":
            tile = self._woven(rng)
        elif self.pitch > 1:
            tile = self._apart(rng)
        else:
            tile = self._touching(rng)
        periods = (tile.size[0] * self.radius, tile.size[1] * self.radius)
        return TriangleMesh(tile.vertices * self.radius, tile.faces, (0.0, 0.0), periods, tile.labels)

    def _touching(self, rng: np.random.Generator) -> TriangleMesh:
        """Return the upper half of a fibre with its axis at x = 1, z = 0."""
        inner = (np.arange(self.segments) + rng.uniform()) * (pi / self.segments)
        inner = inner[inner > 0]
        # The fibre's sides, where it touches its neighbours, are edges of every realisation.
        x = np.concatenate(([0.0], 1.0 - np.cos(inner), [2.0]))
        z = np.concatenate(([0.0], np.sin(inner), [0.0]))
        n = len(x)
        near, far = (np.column_stack((x, np.full(n, y), z)) for y in (0.0, 2.0))
        a = np.arange(n - 1)
        faces = np.concatenate(
            (np.column_stack((a, a + 1, a + n)), np.column_stack((a + n + 1, a + n, a + 1)))
        )
        return TriangleMesh(np.concatenate((near, far)), faces.astype(np.int32), (0.0, 0.0), (2.0, 2.0))

    def _apart(self, rng: np.random.Generator) -> TriangleMesh:
        """Return a whole fibre above the plane z = 0."""
        size = (2.0 * self.pitch, 2.0)
        tube = self._tube(rng, np.array((0.0, 2.0)), np.full(2, 1.0 + _GAP), np.zeros(2))
        fibre, faces = _turned(*tube)
        fibre[:, 0] += self.pitch
        return _over_plane([fibre], [faces], size, 0.0)

    def _woven(self, rng: np.random.Generator) -> TriangleMesh:
        """Return two warp and two weft fibres; where axes cross, they are `bend` apart."""
        pitch = 2.0 * self.pitch
        step = pi / self.segments
        # A chord stands out over the inside of a bend, of radius 1, by step^2 / 8.
        bend = 2.0 * (1.0 + _GAP + step**2 / 8.0)
        # Turn of a fibre from its top to the straight part: pitch sin + bend cos = 2 bend (so that it falls by
        # `bend` in a pitch).
        turn = asin(2.0 * bend / hypot(pitch, bend)) - atan2(bend, pitch)
        vertices, faces = [], []
        for k in range(4):
            # Rings of one arc, from its middle out; the straight part needs none.
            arc = (np.arange(self.segments) + rng.uniform()) * step
            arc = np.concatenate(([0.0], arc[(arc > 0) & (arc < turn)], [turn]))
            slope = np.concatenate((-arc, -arc[::-1], arc[1:], arc[:0:-1], [0.0]))
            middle = np.repeat((0.0, pitch, 2.0 * pitch), (len(arc), 2 * len(arc) - 1, len(arc)))
            top = np.repeat((1.0, -1.0, 1.0), (len(arc), 2 * len(arc) - 1, len(arc)))
            x = middle - top * bend * np.sin(slope)
            z = top * bend * (np.cos(slope) - 0.5)
            x[-1] = 2.0 * pitch
            if k in (1, 2):  # the second weft and the first warp are below where the first weft is above
                slope, z = -slope, -z
            fibre, triangles = self._tube(rng, x, z, slope)
            fibre[:, 1] += (k % 2) * pitch
            if k >= 2:
                fibre, triangles = _turned(fibre, triangles)
            vertices.append(fibre)
            faces.append(triangles)
        return _over_plane(vertices, faces, (2.0 * pitch, 2.0 * pitch), -0.5 * bend - 1.0 - _GAP)

    def _tube(
        self,
        rng: np.random.Generator,
        x: NDArray[np.float64],
        z: NDArray[np.float64],
        slope: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Vertices and faces of a fibre of radius 1 along x, given its axis and that one's slope (radians)."""
        n = 2 * self.segments
        phi = (np.arange(n) + rng.uniform()) * (pi / self.segments)
        y, up = np.cos(phi), np.sin(phi)
        vertices = np.stack(
            (
                x[:, None] - np.sin(slope)[:, None] * up,
                np.broadcast_to(y, (len(x), n)),
                z[:, None] + np.cos(slope)[:, None] * up,
            ),
            axis=-1,
        )
        ring, around = np.indices((len(x) - 1, n))
        a, b = ring * n + around, ring * n + (around + 1) % n
        faces = np.concatenate(
            (np.stack((a, b, a + n), -1).reshape(-1, 3), np.stack((b, b + n, a + n), -1).reshape(-1, 3))
        )
        return vertices.reshape(-1, 3), faces


def _turned(
    vertices: NDArray[np.float64], faces: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Mirror a mesh so that x and y change places; its faces still look out."""
    return vertices[:, [1, 0, 2]], faces[:, ::-1]


def _over_plane(
    vertices: list[NDArray[np.float64]], faces: list[NDArray[np.int64]], size: tuple[float, float], z: float
) -> TriangleMesh:
    """Return the tile of closed fibres over a plane at height z, which is labelled 1."""
    plane = np.array([(0, 0, z), (size[0], 0, z), (size[0], size[1], z), (0, size[1], z)])
    first = np.cumsum([0, *map(len, vertices)])
    together = np.concatenate(
        [*(f + n for f, n in zip(faces, first, strict=False)), first[-1] + np.array([(0, 1, 2), (0, 2, 3)])]
    )
    labels = np.zeros(len(together), np.uint8)
    labels[-2:] = 1
    return cut_to_tile(np.concatenate((*vertices, plane)), together, size, labels)
