"""Square pyramids."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians, tan
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from microgeometry.keys import Keys
from microgeometry.tile import TriangleMesh

_N_RANDOM = 64  # pyramids drawn for a tile
_LATTICE = 32  # lattice points along its side, on which their tops stand
_LEVELS = 4  # heights of the tops, in steps of what a side rises over half a lattice step


@dataclass(frozen=True)
class Pyramids:
    """Upright square pyramids, all sides of one slope: textured silicon, retroreflecting sheet.

    Keys of [surface]:

    - ``slope_deg``: angle of every side against the plane, 0 to 89.9 degrees (54.74 for etched silicon).
    - ``arrangement``: "regular" (default), one beside the other, or "random": 64 tops of random heights at
      random places, each pyramid as far as it stands out from the others, as etching leaves them.
    - ``size`` (1): the base of a regular pyramid in ``units`` ("um"); random, the root of the plane for each
      top. It changes no result in geometric optics.

    The sides look to +-x and +-y, and nothing is flat. Random tops stand on a lattice and their heights are
    steps of it, so the valleys between them fall on edges of the mesh: every facet has exactly the slope.

    Attributes
    ----------
    slope : float
        Radians.
    arrangement : str
    size : float
        Metres.
    """

    kind: ClassVar[str] = "pyramids"

    slope: float
    arrangement: str
    size: float

    @property
    def is_random(self) -> bool:
        """Whether tops are drawn."""
        return self.arrangement == "random"

    @classmethod
    def from_keys(cls, keys: Keys, folder: Path) -> Pyramids:
        """Build from the [surface] table."""
        keys.allow("kind", "slope_deg", "arrangement", "size", "units")
        return cls(
            radians(keys.number("slope_deg", at_least=0, at_most=89.9)),
            keys.choice("arrangement", "regular", ("regular", "random")),
            keys.number("size", 1.0, above=0) * keys.metres_per_unit(),
        )

    def realise(self, seed: int) -> TriangleMesh:
        """Return one regular pyramid, or a tile of random ones."""
        if not self.is_random:
            return self._envelope(1, np.zeros((1, 3), int), self.size)
        rng = np.random.Generator(np.random.PCG64(seed))
        tops = rng.integers(0, (_LATTICE, _LATTICE, _LEVELS), (_N_RANDOM, 3))
        return self._envelope(_LATTICE, tops, self.size * _N_RANDOM**0.5)

    def _envelope(self, lattice: int, tops: NDArray[np.int64], period: float) -> TriangleMesh:
        """Return the highest of the periodic pyramids with these tops (x, y, level), in lattice steps.

        Over a grid of half lattice steps every valley and ridge runs along a grid line or, where the sum of
        the indices is even, along a diagonal; so in whole numbers the heights are exact.
        """
        n = 2 * lattice
        along = np.abs(np.arange(n)[:, None, None] - 2 * tops[:, :2])  # (n, tops, 2)
        along = np.minimum(along, n - along)
        heights = np.max(2 * tops[:, 2] - np.maximum(along[:, None, :, 0], along[None, :, :, 1]), axis=2)
        heights = np.pad(heights, ((0, 1), (0, 1)), mode="wrap")
        i, j = np.indices((n + 1, n + 1))
        step = period / n
        vertices = np.column_stack(
            (i.ravel() * step, j.ravel() * step, heights.ravel() * (step * tan(self.slope)))
        )
        # The far faces of the tile are at the period, to the bit.
        vertices[:, :2][np.column_stack((i.ravel() == n, j.ravel() == n))] = period
        v0 = (i * (n + 1) + j)[:-1, :-1].ravel()
        v1, v2, v3 = v0 + n + 1, v0 + n + 2, v0 + 1
        even = ((i + j)[:-1, :-1].ravel() % 2 == 0)[:, None]
        first = np.where(even, np.column_stack((v0, v1, v2)), np.column_stack((v0, v1, v3)))
        second = np.where(even, np.column_stack((v0, v2, v3)), np.column_stack((v2, v3, v1)))
        faces = np.concatenate((first, second)).astype(np.int32)
        return TriangleMesh(vertices, faces, (0.0, 0.0), (period, period))
