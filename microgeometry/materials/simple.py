"""Materials without optical constants: mirror, black, no interface, Lambert, and a table of a BRDF."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from microgeometry.grid import Grid
from microgeometry.keys import Keys
from microgeometry.materials.reading import per_sample


class Opaque:
    """What materials have in common through which no light passes."""

    transmits: ClassVar[bool] = False

    def index_below(self, above: tuple[float, ...]) -> tuple[float, ...]:
        """Not to be asked."""
        raise TypeError(f"{type(self).__name__} is opaque: there is no medium below it")


@dataclass(frozen=True)
class Mirror(Opaque):
    """Lossless mirror: reflects everything, at every wavelength and angle. No keys."""

    kind: ClassVar[str] = "mirror"

    @classmethod
    def from_keys(cls, keys: Keys, grid: Grid, folder: Path) -> Mirror:
        """Build from the [material] table."""
        keys.allow("kind")
        return cls()


@dataclass(frozen=True)
class Black(Opaque):
    """Absorbs everything. No keys."""

    kind: ClassVar[str] = "black"

    @classmethod
    def from_keys(cls, keys: Keys, grid: Grid, folder: Path) -> Black:
        """Build from the [material] table."""
        keys.allow("kind")
        return cls()


@dataclass(frozen=True)
class NoInterface:
    """No change of index: light passes as if nothing were there. No keys.

    It gives a medium a surface: the top of a cloud of pigment, or the boundary of two media.
    """

    kind: ClassVar[str] = "none"
    transmits: ClassVar[bool] = True

    @classmethod
    def from_keys(cls, keys: Keys, grid: Grid, folder: Path) -> NoInterface:
        """Build from the [material] table."""
        keys.allow("kind")
        return cls()

    def index_below(self, above: tuple[float, ...]) -> tuple[float, ...]:
        """Return the index above."""
        return above


@dataclass(frozen=True)
class Lambert(Opaque):
    """Diffuse facets: every facet reflects by Lambert's law.

    Keys of [material]: ``albedo``, one number or one per channel.

    Attributes
    ----------
    albedo : tuple of float
        Per sample, 0 to 1.
    """

    kind: ClassVar[str] = "lambert"

    albedo: tuple[float, ...]

    @classmethod
    def from_keys(cls, keys: Keys, grid: Grid, folder: Path) -> Lambert:
        """Build from the [material] table."""
        keys.allow("kind", "albedo")
        return cls(per_sample(keys, "albedo", keys.numbers("albedo", at_least=0, at_most=1), grid))


@dataclass(frozen=True)
class TableMaterial(Opaque):
    """Facets that reflect by a BRDF table, traced or tabulated from a model: the next smaller scale.

    Keys of [material]: ``file``, relative to the specimen's folder. The table is read when it is traced.

    Attributes
    ----------
    file : Path
        Absolute.
    """

    kind: ClassVar[str] = "table"

    file: Path

    @classmethod
    def from_keys(cls, keys: Keys, grid: Grid, folder: Path) -> TableMaterial:
        """Build from the [material] table; the file must exist."""
        keys.allow("kind", "file")
        return cls(keys.file("file", folder))
