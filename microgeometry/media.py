"""What fills the space between two surfaces: absorption and scattering."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from math import pi
from pathlib import Path
from typing import TypeAlias

import numpy as np

from microgeometry.columns import read_columns
from microgeometry.errors import InputError
from microgeometry.grid import Grid
from microgeometry.keys import Keys
from microgeometry.materials.reading import per_sample


@dataclass(frozen=True)
class Isotropic:
    """Scatters alike into all directions. No keys."""


@dataclass(frozen=True)
class HenyeyGreenstein:
    """Phase function of Henyey and Greenstein (1941), Astrophys. J. 93, 70.

    Attributes
    ----------
    g : float
        Mean cosine of the scattering angle, above -1 (backward) and below 1 (forward).
    """

    g: float


@dataclass(frozen=True)
class Rayleigh:
    """Phase function of particles much smaller than the wavelength, of unpolarised light. No keys."""


@dataclass(frozen=True)
class TabulatedPhase:
    """Phase function from a table, linear in the cosine of the scattering angle between its rows.

    Attributes
    ----------
    cosines : tuple of float
        Increasing, from -1 (backward) to 1 (forward).
    values : tuple of float
        1/sr, at least 0; 2 pi times their integral over the cosine is 1.
    """

    cosines: tuple[float, ...]
    values: tuple[float, ...]

    @classmethod
    def read(cls, file: Path) -> TabulatedPhase:
        """Read a CSV with the columns theta_deg, from 0 to 180, and value, of any scale."""
        columns = read_columns(file, ("theta_deg", "value"))
        theta, value = columns["theta_deg"], columns["value"]
        cosines, values = np.cos(np.deg2rad(theta))[::-1], value[::-1]
        if theta[0] != 0 or theta[-1] != 180 or any(b <= a for a, b in pairwise(cosines.tolist())):
            raise InputError(f"{file}: theta_deg must increase from row to row, from 0 to 180")
        if values.min() < 0 or values.max() == 0:
            raise InputError(f"{file}: values must not be negative, and above 0 somewhere")
        values = values / values.max()
        integral = pi * np.sum((values[1:] + values[:-1]) * np.diff(cosines))
        return cls(tuple(cosines.tolist()), tuple((values / integral).tolist()))


Phase: TypeAlias = Isotropic | HenyeyGreenstein | Rayleigh | TabulatedPhase

PHASES: dict[str, Callable[[Keys, Path], Phase]] = {
    "isotropic": lambda keys, folder: Isotropic(),
    "hg": lambda keys, folder: HenyeyGreenstein(keys.number("g", above=-1, below=1)),
    "rayleigh": lambda keys, folder: Rayleigh(),
    "table": lambda keys, folder: TabulatedPhase.read(keys.file("file", folder)),
}
_KEY_OF = {"g": "hg", "file": "table"}


@dataclass(frozen=True)
class Medium:
    """Homogeneous medium below a surface.

    Keys: ``sigma_a`` (0) and ``sigma_s`` (0), absorption and scattering per length, one number or one per
    channel; ``phase``: "isotropic" (default), "hg" with ``g``, "rayleigh", or "table" with ``file``, a CSV
    of theta_deg from 0 to 180, value; ``thickness``, inf for a half-space; ``units`` ("um") of all lengths.
    The thickness is the distance of the mean planes of the surfaces above and below.

    Attributes
    ----------
    sigma_a, sigma_s : tuple of float
        Per sample, 1/m, at least 0.
    phase : Phase
    thickness : float
        Metres, above 0; may be inf.
    """

    sigma_a: tuple[float, ...]
    sigma_s: tuple[float, ...]
    phase: Phase
    thickness: float

    @classmethod
    def from_keys(cls, keys: Keys, grid: Grid, folder: Path) -> Medium:
        """Build from the table of a medium; files are relative to `folder`. Raises `InputError`."""
        keys.allow("sigma_a", "sigma_s", "phase", "g", "file", "thickness", "units")
        metres = keys.metres_per_unit()
        phase = keys.choice("phase", "isotropic", PHASES)
        for key, owner in _KEY_OF.items():
            if key in keys and phase != owner:
                raise keys.error(key, f'only with phase = "{owner}"; leave it out')
        return cls(
            _per_metre(keys, "sigma_a", grid, metres),
            _per_metre(keys, "sigma_s", grid, metres),
            PHASES[phase](keys, folder),
            keys.number("thickness", above=0, or_inf=True) * metres,
        )


def _per_metre(keys: Keys, key: str, grid: Grid, metres: float) -> tuple[float, ...]:
    if key not in keys:
        return (0.0,) * grid.n_samples
    values = per_sample(keys, key, keys.numbers(key, at_least=0, at_most=1e30), grid)
    return tuple(value / metres for value in values)
