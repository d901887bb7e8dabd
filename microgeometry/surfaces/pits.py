"""Spherical pits in a plane."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from microgeometry.keys import Keys
from microgeometry.surfaces.caps import Caps
from microgeometry.tile import TriangleMesh


@dataclass(frozen=True)
class Pits(Caps):
    """Equal spherical pits in the plane z = 0; keys and attributes: see `Caps`."""

    kind: ClassVar[str] = "pits"
    is_random: ClassVar[bool] = True

    @classmethod
    def from_keys(cls, keys: Keys, folder: Path) -> Pits:
        """Build from the [surface] table."""
        return cls.read(keys)

    def realise(self, seed: int) -> TriangleMesh:
        """Return the realisation of a seed."""
        return self.mesh(seed, -1)
