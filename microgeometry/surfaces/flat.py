"""A flat surface."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from microgeometry.keys import Keys
from microgeometry.tile import HeightField


@dataclass(frozen=True)
class Flat:
    """The plane z = 0.

    Keys of [surface]: ``size`` (1) of the tile in ``units`` ("um"). It changes no result: a plane has no
    scale.

    Attributes
    ----------
    size : float
        Period, metres.
    """

    kind: ClassVar[str] = "flat"
    is_random: ClassVar[bool] = False

    size: float = 1e-6

    @classmethod
    def from_keys(cls, keys: Keys, folder: Path) -> Flat:
        """Build from the [surface] table."""
        keys.allow("kind", "size", "units")
        return cls(keys.number("size", 1.0, above=0) * keys.metres_per_unit())

    def realise(self, seed: int) -> HeightField:
        """Return a tile of 2 x 2 zeros."""
        return HeightField(np.zeros((2, 2)), (self.size, self.size))
