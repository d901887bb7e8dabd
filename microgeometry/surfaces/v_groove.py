"""V-grooves."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from microgeometry.keys import Keys
from microgeometry.surfaces.slopes import MAX_SLOPE_DEG, Normal, SlopeDistribution, read_distribution
from microgeometry.tile import HeightField

N_RANDOM = 64
"""Grooves in a tile of random ones. More would be less random for the same number of tiles, but narrower in a
unit tile, where the tracer's single precision loses light in their valleys: 256 lose 4 paths in a million."""


@dataclass(frozen=True)
class VGroove:
    """Symmetric V-grooves along y, ridges at one height; the cross-plane is xz.

    Keys of [surface]: the slope, which is the angle of both walls against the plane (a groove opens by
    180 degrees less twice the slope), as one of

    - ``slope_deg``: the same for all grooves, 0 to 89.9 degrees.
    - ``slope_deg`` and ``slope_std_deg``: each groove has a slope of its own, drawn from a normal distribution
      of this mean and standard deviation. What falls outside 0 to 89.9 is left out, so close to those limits
      the mean and the spread are not quite these.
    - ``distribution`` = "beckmann" or "ggx", with ``alpha``, or a CSV file of theta_deg, D: each groove has a
      slope drawn from a distribution of normals (see `Ndf`, which is the same surface).
    - ``distribution`` = "oren_nayar", with ``slope_std_deg``: drawn from a Gaussian of this standard deviation
      per solid angle (see `OrenNayar`), the sigma of their model.

    and

    - ``orientation``: "fixed" (default) or "random". An isotropic measurement turns the specimen about z and
      averages, so both give the same table: the tile is the same. A measurement with phi_i is of "fixed".
    - ``size`` (1): width of a groove in ``units`` ("um"). It changes no result in geometric optics.

    The cavity of Torrance and Sparrow (1967), with the distribution that Cook and Torrance (1982) gave it, is
    ``distribution = "beckmann"`` on a mirror or a conductor; that of Oren and Nayar (1994) is
    ``distribution = "oren_nayar"`` on "lambert". Both take a groove to be infinitely long and of any
    orientation, as here; their formulas approximate what is traced here.

    Attributes
    ----------
    slope : float or SlopeDistribution
        Angle of the walls against the plane, radians, or what it is drawn from.
    size : float
        Width of a groove, metres: ridge at x = 0, valley at x = size / 2. The period, if all are the same.
    orientation : str
    """

    kind: ClassVar[str] = "v_groove"

    slope: float | SlopeDistribution
    size: float = 1e-6
    orientation: str = "fixed"

    @property
    def is_random(self) -> bool:
        """Whether slopes are drawn."""
        return not isinstance(self.slope, float)

    @classmethod
    def from_keys(cls, keys: Keys, folder: Path) -> VGroove:
        """Build from the [surface] table."""
        keys.allow(
            "kind", "slope_deg", "slope_std_deg", "distribution", "alpha", "orientation", "size", "units"
        )
        return cls(
            slope=_read_slope(keys, folder),
            size=keys.number("size", 1.0, above=0) * keys.metres_per_unit(),
            orientation=keys.choice("orientation", "fixed", ("fixed", "random")),
        )

    def realise(self, seed: int) -> HeightField:
        """Return one groove, or `N_RANDOM` with slopes drawn, each of 2 x 1 samples."""
        if isinstance(self.slope, float):
            return grooves(np.array([self.slope]), self.size)
        return draw_grooves(self.slope, self.size, seed)


def _read_slope(keys: Keys, folder: Path) -> float | SlopeDistribution:
    if "distribution" in keys:
        if "slope_deg" in keys:
            raise keys.error("slope_deg", "give slope_deg or distribution, not both")
        return read_distribution(keys, folder, ("beckmann", "ggx", "oren_nayar"))
    if "slope_deg" not in keys and "slope_std_deg" in keys:
        raise keys.error(
            "slope_deg", 'missing: give the mean slope beside slope_std_deg, or distribution = "oren_nayar"'
        )
    slope = radians(keys.number("slope_deg", at_least=0, at_most=MAX_SLOPE_DEG))
    if "alpha" in keys:
        raise keys.error("alpha", 'is of a distribution; add distribution = "beckmann" in place of slope_deg')
    std = radians(keys.number("slope_std_deg", 0.0, at_least=0, at_most=30))
    return Normal(slope, std) if std > 0 else slope


def draw_grooves(distribution: SlopeDistribution, width: float, seed: int) -> HeightField:
    """Return `N_RANDOM` grooves, each `width` metres wide, of slopes drawn from a distribution.

    One is drawn from each N-th part of the tile, in random order. Light in a groove meets no other, all
    ridges being at one height, so this alters no result but its noise: half the variance, measured.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    u = (rng.permutation(N_RANDOM) + rng.uniform(size=N_RANDOM)) / N_RANDOM
    return grooves(np.minimum(distribution.slopes(u), radians(MAX_SLOPE_DEG)), width)


def grooves(slopes: NDArray[np.float64], width: float) -> HeightField:
    """Return grooves of these slopes (radians, shape (n,)) side by side, each `width` metres wide.

    The ridges are at height 0, the valleys below; shape (2 n, 1), period (n width, width).
    """
    heights = np.zeros((2 * len(slopes), 1))
    heights[1::2, 0] = -0.5 * width * np.tan(slopes)
    return HeightField(heights, (len(slopes) * width, width))
