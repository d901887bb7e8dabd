"""Smooth interfaces by Fresnel's equations: conductor and dielectric."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import ClassVar

from microgeometry.grid import Grid
from microgeometry.keys import Keys
from microgeometry.materials.reading import optical_constants
from microgeometry.materials.simple import Opaque

MAX_CLEAR_K = 1e-4
"""Largest extinction coefficient of what is still called a dielectric.

Light falls to 1/e over lambda / (4 pi k), at this limit 800 wavelengths (0.4 mm in the visible): hundreds
of times the relief of a rough surface. The reflectance is off by less than 1e-8. What a thick layer absorbs
all the same belongs into its medium, as sigma_a = 4 pi k / lambda.
"""


@dataclass(frozen=True)
class Conductor(Opaque):
    """Opaque medium with refractive index eta + ik: Fresnel reflection, the rest absorbed.

    Keys of [material], one of three: ``name``, an element or a page of refractiveindex.info; ``file``, a CSV
    of wavelength_nm (or wavelength_um), n, k (see `microgeometry.indices`); or ``eta`` and ``k``, each one
    number or one per channel.

    Attributes
    ----------
    eta, k : tuple of float
        Per sample; eta > 0, k >= 0, absolute.
    name : str or None
        As given.
    """

    kind: ClassVar[str] = "conductor"

    eta: tuple[float, ...]
    k: tuple[float, ...]
    name: str | None = None

    @classmethod
    def from_keys(cls, keys: Keys, grid: Grid, folder: Path) -> Conductor:
        """Build from the [material] table."""
        keys.allow("kind", "name", "file", "eta", "k")
        return cls(*optical_constants(keys, grid, folder, k_required=True))


@dataclass(frozen=True)
class Dielectric:
    """Clear medium with refractive index eta: Fresnel reflection, the rest refracted.

    Keys of [material], one of three: ``name``, a glass or a page of refractiveindex.info; ``file``, a CSV of
    wavelength_nm (or wavelength_um), n (see `microgeometry.indices`); or ``eta``, one number or one per
    channel. A name or file with k above 1e-4 is refused: absorption belongs into the medium below.

    Attributes
    ----------
    eta : tuple of float
        Per sample, above 0 (below 1 too), the absolute index of what lies below the surface.
    name : str or None
        As given.
    """

    kind: ClassVar[str] = "dielectric"
    transmits: ClassVar[bool] = True

    eta: tuple[float, ...]
    name: str | None = None

    @classmethod
    def from_keys(cls, keys: Keys, grid: Grid, folder: Path) -> Dielectric:
        """Build from the [material] table."""
        if "k" in keys:
            raise keys.error(
                "k",
                'a dielectric is clear; use kind = "conductor", or give its medium sigma_a = 4 pi k / lambda',
            )
        keys.allow("kind", "name", "file", "eta")
        eta, k, name = optical_constants(keys, grid, folder, k_required=False)
        if max(k) > MAX_CLEAR_K:
            assert grid.samples_nm is not None
            worst = k.index(max(k))
            nm = grid.samples_nm[worst]
            raise keys.error(
                "name" if name else "file",
                f"k = {k[worst]:.3g} at {nm:g} nm, but a dielectric is clear (k up to {MAX_CLEAR_K:g}); use "
                'kind = "conductor", or give eta and put the absorption into the medium '
                f"(sigma_a = 4 pi k / lambda = {4e3 * pi * k[worst] / nm:.3g} per um)",
            )
        return cls(eta, name)

    def index_below(self, above: tuple[float, ...]) -> tuple[float, ...]:
        """Return eta."""
        return self.eta
