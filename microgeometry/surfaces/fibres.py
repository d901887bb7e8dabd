"""Parallel fibres."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import ClassVar

import numpy as np

from microgeometry.keys import Keys
from microgeometry.tile import TriangleMesh


@dataclass(frozen=True)
class Fibres:
    """Round fibres along y, side by side and touching: their upper halves, which are all that light meets.

    Keys of [surface]: ``radius`` (1) in ``units`` ("um"), which changes no result in geometric optics, and
    ``segments`` (64) around the half that is seen.

    A fibre is a prism with its edges on the cylinder; they are turned anew for each seed, so that over the
    seeds facets take every inclination.

    Attributes
    ----------
    radius : float
        Metres; the fibre's axis is at x = radius, z = 0, and the period is 2 radius.
    segments : int
    """

    kind: ClassVar[str] = "fibres"
    is_random: ClassVar[bool] = True

    radius: float
    segments: int

    @classmethod
    def from_keys(cls, keys: Keys, folder: Path) -> Fibres:
        """Build from the [surface] table."""
        keys.allow("kind", "radius", "segments", "units")
        radius = keys.number("radius", 1.0, above=0) * keys.metres_per_unit()
        return cls(radius, keys.integer("segments", 64, at_least=8, at_most=8192))

    def realise(self, seed: int) -> TriangleMesh:
        """Return one fibre, of 2 (segments + 1) triangles."""
        turn = np.random.Generator(np.random.PCG64(seed)).uniform()
        inner = (np.arange(self.segments) + turn) * (pi / self.segments)
        inner = inner[inner > 0]
        # The fibre's sides, where it touches its neighbours, are edges of every realisation.
        x = np.concatenate(([0.0], self.radius * (1.0 - np.cos(inner)), [2.0 * self.radius]))
        z = np.concatenate(([0.0], self.radius * np.sin(inner), [0.0]))
        n = len(x)
        near = np.column_stack((x, np.zeros(n), z))
        far = np.column_stack((x, np.full(n, 2.0 * self.radius), z))
        a = np.arange(n - 1)
        faces = np.concatenate(
            (np.column_stack((a, a + 1, a + n)), np.column_stack((a + n + 1, a + n, a + 1)))
        )
        size = (2.0 * self.radius, 2.0 * self.radius)
        return TriangleMesh(np.concatenate((near, far)), faces.astype(np.int32), (0.0, 0.0), size)
