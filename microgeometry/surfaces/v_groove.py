"""Parallel V-grooves."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from microgeometry.keys import Keys
from microgeometry.tile import HeightField

MAX_SLOPE_DEG = 89.9
N_RANDOM = 256
"""Grooves in a tile of random ones: one specimen's worth of facets, and few enough to build at once."""


@dataclass(frozen=True)
class VGroove:
    """Symmetric V-grooves along y, ridges at one height; the cross-plane is xz.

    The cavity of Torrance and Sparrow (1967) and of Oren and Nayar (1994), in the open.

    Keys of [surface]:

    - ``slope_deg``: the angle of both walls against the plane, 0 to 89.9 degrees.
    - ``slope_std_deg`` (0): if above 0, each groove has a slope of its own, drawn from a normal
      distribution of mean ``slope_deg`` and this standard deviation. What falls outside 0 to 89.9 is drawn
      again, so close to those limits the mean and the spread are not quite these.
    - ``orientation``: "fixed" (default) or "random". An isotropic measurement turns the specimen about z and
      averages, so both give the same table: the tile is the same. A measurement with phi_i is of "fixed".
    - ``size`` (1): width of a groove in ``units`` ("um"). It changes no result in geometric optics.

    Attributes
    ----------
    slope : float
        Angle of the walls against the plane, radians.
    size : float
        Width of a groove, metres: ridge at x = 0, valley at x = size / 2. The period, if all are the same.
    slope_std : float
        Radians.
    orientation : str
    """

    kind: ClassVar[str] = "v_groove"

    slope: float
    size: float = 1e-6
    slope_std: float = 0.0
    orientation: str = "fixed"

    @property
    def is_random(self) -> bool:
        """Whether slopes are drawn."""
        return self.slope_std > 0

    @classmethod
    def from_keys(cls, keys: Keys, folder: Path) -> VGroove:
        """Build from the [surface] table."""
        keys.allow("kind", "slope_deg", "slope_std_deg", "orientation", "size", "units")
        return cls(
            slope=radians(keys.number("slope_deg", at_least=0, at_most=MAX_SLOPE_DEG)),
            size=keys.number("size", 1.0, above=0) * keys.metres_per_unit(),
            slope_std=radians(keys.number("slope_std_deg", 0.0, at_least=0, at_most=30)),
            orientation=keys.choice("orientation", "fixed", ("fixed", "random")),
        )

    def realise(self, seed: int) -> HeightField:
        """Return one groove, or 256 with slopes drawn, each of 2 x 1 samples."""
        if not self.is_random:
            return grooves(np.array([self.slope]), self.size)
        rng = np.random.Generator(np.random.PCG64(seed))
        slopes = rng.normal(self.slope, self.slope_std, N_RANDOM)
        while (outside := (slopes < 0) | (slopes > radians(MAX_SLOPE_DEG))).any():
            slopes[outside] = rng.normal(self.slope, self.slope_std, np.count_nonzero(outside))
        return grooves(slopes, self.size)


def grooves(slopes: NDArray[np.float64], width: float) -> HeightField:
    """Return grooves of these slopes (radians, shape (n,)) side by side, each `width` metres wide.

    The ridges are at height 0, the valleys below; shape (2 n, 1), period (n width, width).
    """
    heights = np.zeros((2 * len(slopes), 1))
    heights[1::2, 0] = -0.5 * width * np.tan(slopes)
    return HeightField(heights, (len(slopes) * width, width))
