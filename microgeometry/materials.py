"""What facets are made of: one frozen dataclass a material, registered by the name a specimen calls it.

Every optical quantity is a tuple with one value per channel of the specimen's grid.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, TypeAlias

from microgeometry.grid import Grid
from microgeometry.indices import refractive_index
from microgeometry.keys import Keys


@dataclass(frozen=True)
class Mirror:
    """Lossless mirror: reflects everything, at every wavelength and angle. No keys."""

    kind: ClassVar[str] = "mirror"

    @classmethod
    def from_keys(cls, keys: Keys, grid: Grid) -> Mirror:
        """Build from the [material] table."""
        keys.allow("kind")
        return cls()


@dataclass(frozen=True)
class Conductor:
    """Opaque medium with refractive index eta + ik: Fresnel reflection, the rest absorbed.

    Keys of [material]: ``name``, an element or a page of refractiveindex.info (see
    `microgeometry.indices.refractive_index`), at the wavelengths of the grid; or ``eta`` and ``k``, each
    one number or one per channel.

    Attributes
    ----------
    eta, k : tuple of float
        Per channel; eta > 0, k >= 0, relative to the vacuum above.
    name : str or None
        As given.
    """

    kind: ClassVar[str] = "conductor"

    eta: tuple[float, ...]
    k: tuple[float, ...]
    name: str | None = None

    @classmethod
    def from_keys(cls, keys: Keys, grid: Grid) -> Conductor:
        """Build from the [material] table."""
        keys.allow("kind", "name", "eta", "k")
        if "name" not in keys:
            if "eta" not in keys and "k" not in keys:
                raise keys.error("name", 'missing; add name = "Au", or eta = ... and k = ...')
            eta = _per_channel(keys, "eta", keys.numbers("eta", above=0), grid)
            return cls(eta, _per_channel(keys, "k", keys.numbers("k", at_least=0), grid))
        if "eta" in keys or "k" in keys:
            raise keys.error("name", "give name, or eta and k, not both")
        name = keys.text("name")
        if grid.wavelengths_nm is None:
            raise keys.error(
                "name",
                "a material by name needs wavelengths; set wavelengths_nm = [...] or "
                'channels = "rgb" under [grid]',
            )
        n, k = refractive_index(name, grid.wavelengths_nm)
        return cls(tuple(n.tolist()), tuple(k.tolist()), name)


@dataclass(frozen=True)
class Lambert:
    """Diffuse facets: every facet reflects by Lambert's law.

    Keys of [material]: ``albedo``, one number or one per channel.

    Attributes
    ----------
    albedo : tuple of float
        Per channel, 0 to 1.
    """

    kind: ClassVar[str] = "lambert"

    albedo: tuple[float, ...]

    @classmethod
    def from_keys(cls, keys: Keys, grid: Grid) -> Lambert:
        """Build from the [material] table."""
        keys.allow("kind", "albedo")
        return cls(_per_channel(keys, "albedo", keys.numbers("albedo", at_least=0, at_most=1), grid))


Material: TypeAlias = Mirror | Conductor | Lambert

MATERIALS: dict[str, type[Material]] = {material.kind: material for material in (Mirror, Conductor, Lambert)}


def _per_channel(keys: Keys, key: str, values: tuple[float, ...], grid: Grid) -> tuple[float, ...]:
    n_channels = len(grid.channels)
    if len(values) == 1:
        return values * n_channels
    if len(values) != n_channels:
        raise keys.error(
            key,
            f"{len(values)} values for {n_channels} channel(s) "
            f"({', '.join(grid.channels)}); give 1 or {n_channels}, or set "
            "wavelengths_nm under [grid]",
        )
    return values
