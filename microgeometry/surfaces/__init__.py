"""Surfaces: one file each, registered here by the name a specimen calls them.

A surface is a frozen dataclass in metres. It is built by ``from_keys`` from the [surface] table of a
specimen and turned into a tile by ``realise``. To add one: a file with such a class, and its name in the
tuple below.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Protocol

from microgeometry.keys import Keys
from microgeometry.surfaces.bosses import Bosses
from microgeometry.surfaces.exponential import Exponential
from microgeometry.surfaces.fibres import Fibres
from microgeometry.surfaces.flat import Flat
from microgeometry.surfaces.gaussian import Gaussian
from microgeometry.surfaces.heightmap import HeightMap
from microgeometry.surfaces.mesh import Mesh
from microgeometry.surfaces.ndf import Ndf
from microgeometry.surfaces.pits import Pits
from microgeometry.surfaces.pyramids import Pyramids
from microgeometry.surfaces.self_affine import SelfAffine
from microgeometry.surfaces.spheres import Spheres
from microgeometry.surfaces.v_groove import VGroove
from microgeometry.tile import Tile


class Surface(Protocol):
    """The contract of every surface.

    Attributes
    ----------
    kind : str
        Its name in a specimen.
    """

    kind: ClassVar[str]

    @property
    def is_random(self) -> bool:
        """A new seed gives a new realisation. If False, `realise` gives the same tile for every seed."""
        ...

    @classmethod
    def from_keys(cls, keys: Keys, folder: Path) -> Surface:
        """Build from the [surface] table; files are relative to `folder`. Raises `InputError`."""
        ...

    def realise(self, seed: int) -> Tile:
        """Return the tile, in metres: the same bits for the same surface and seed (an int >= 0)."""
        ...


_ALL: tuple[type[Surface], ...] = (
    Flat,
    Gaussian,
    Exponential,
    SelfAffine,
    Ndf,
    VGroove,
    Pits,
    Bosses,
    Pyramids,
    Fibres,
    Spheres,
    HeightMap,
    Mesh,
)

SURFACES: dict[str, type[Surface]] = {surface.kind: surface for surface in _ALL}
