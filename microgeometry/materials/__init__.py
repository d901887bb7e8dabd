"""What facets are made of: one frozen dataclass a material, registered by the name a specimen calls it.

Every optical quantity is a tuple of S floats, one per spectral sample of the specimen's grid
(`Grid.n_samples`). Refractive indices are absolute, of what lies below the surface.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Protocol

from microgeometry.grid import Grid
from microgeometry.keys import Keys
from microgeometry.materials.coated import Coated, Film
from microgeometry.materials.fresnel import Conductor, Dielectric
from microgeometry.materials.simple import Black, Lambert, Mirror, NoInterface, TableMaterial

__all__ = [
    "MATERIALS",
    "Black",
    "Coated",
    "Conductor",
    "Dielectric",
    "Film",
    "Lambert",
    "Material",
    "Mirror",
    "NoInterface",
    "TableMaterial",
    "read_material",
]


class Material(Protocol):
    """The contract of every material.

    Attributes
    ----------
    kind : str
        Its name in a specimen.
    """

    kind: ClassVar[str]

    @property
    def transmits(self) -> bool:
        """Light crosses it, into a medium below."""
        ...

    def index_below(self, above: tuple[float, ...]) -> tuple[float, ...]:
        """Refractive index (S,) of the medium below, given that above. Only of a material that transmits."""
        ...

    @classmethod
    def from_keys(cls, keys: Keys, grid: Grid, folder: Path) -> Material:
        """Build from the table of a material; files are relative to `folder`. Raises `InputError`."""
        ...


_ALL: tuple[type[Material], ...] = (
    Mirror,
    Black,
    NoInterface,
    Lambert,
    Conductor,
    Dielectric,
    Coated,
    TableMaterial,
)

MATERIALS: dict[str, type[Material]] = {material.kind: material for material in _ALL}


def read_material(keys: Keys, grid: Grid, folder: Path) -> Material:
    """Build the material of a table by its key ``kind``. Raises `InputError`."""
    return MATERIALS[keys.choice("kind", None, MATERIALS)].from_keys(keys, grid, folder)
