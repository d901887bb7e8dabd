"""Thin films on a conductor or a dielectric."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from microgeometry.grid import Grid
from microgeometry.keys import Keys
from microgeometry.materials.fresnel import Conductor, Dielectric
from microgeometry.materials.reading import optical_constants, wavelengths

OVER: dict[str, type[Conductor] | type[Dielectric]] = {m.kind: m for m in (Conductor, Dielectric)}


@dataclass(frozen=True)
class Film:
    """One film.

    Keys: ``name``, ``file``, or ``eta`` and ``k`` (0), as for a conductor; ``thickness_nm``, at least 0.

    Attributes
    ----------
    eta, k : tuple of float
        Per sample, absolute.
    thickness : float
        Metres.
    name : str or None
        As given.
    """

    eta: tuple[float, ...]
    k: tuple[float, ...]
    thickness: float
    name: str | None = None

    @classmethod
    def from_keys(cls, keys: Keys, grid: Grid, folder: Path) -> Film:
        """Build from one table of ``films``."""
        keys.allow("name", "file", "eta", "k", "thickness_nm")
        eta, k, name = optical_constants(keys, grid, folder, k_required=False)
        return cls(eta, k, 1e-9 * keys.number("thickness_nm", at_least=0), name)


@dataclass(frozen=True)
class Coated:
    """A stack of thin films, coherent, on a conductor or a dielectric.

    Keys of [material]: ``films``, a list of tables from top to bottom (see `Film`), and ``over``, the table
    of a conductor or a dielectric.

    Attributes
    ----------
    films : tuple of Film
        Top to bottom, at least one.
    over : Conductor or Dielectric
    """

    kind: ClassVar[str] = "coated"

    films: tuple[Film, ...]
    over: Conductor | Dielectric

    @property
    def transmits(self) -> bool:
        """Whether what lies below the films does."""
        return self.over.transmits

    @classmethod
    def from_keys(cls, keys: Keys, grid: Grid, folder: Path) -> Coated:
        """Build from the [material] table."""
        keys.allow("kind", "films", "over")
        wavelengths(keys, "kind", grid, "interference")
        films = tuple(Film.from_keys(film, grid, folder) for film in keys.subtables("films"))
        over = keys.subtable("over")
        return cls(films, OVER[over.choice("kind", None, OVER)].from_keys(over, grid, folder))

    def index_below(self, above: tuple[float, ...]) -> tuple[float, ...]:
        """Return the index of what lies below the films."""
        return self.over.index_below(above)
