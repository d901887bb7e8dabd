"""Parallel V-grooves."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians, tan
from pathlib import Path
from typing import ClassVar

import numpy as np

from microgeometry.keys import Keys
from microgeometry.tile import HeightField


@dataclass(frozen=True)
class VGroove:
    """Symmetric V-grooves along y; the cross-plane is xz.

    The cavity of Torrance and Sparrow (1967) and of Oren and Nayar (1994), in the open.

    Keys of [surface]: ``slope_deg``, the angle of both walls against the plane, 0 to 89.9 degrees;
    ``size`` (1), the period in ``units`` ("um"). The period changes no result in geometric optics.

    Attributes
    ----------
    slope : float
        Angle of the walls against the plane, radians.
    size : float
        Period, metres: ridge at x = 0, valley at x = size / 2.
    """

    kind: ClassVar[str] = "v_groove"
    is_random: ClassVar[bool] = False

    slope: float
    size: float = 1e-6

    @classmethod
    def from_keys(cls, keys: Keys, folder: Path) -> VGroove:
        """Build from the [surface] table."""
        keys.allow("kind", "slope_deg", "size", "units")
        slope_deg = keys.number("slope_deg", at_least=0, at_most=89.9)
        return cls(radians(slope_deg), keys.number("size", 1.0, above=0) * keys.metres_per_unit())

    def realise(self, seed: int) -> HeightField:
        """Return one groove of 2 x 1 samples: the ridge at height 0, the valley below."""
        depth = 0.5 * self.size * tan(self.slope)
        return HeightField(np.array([[0.0], [-depth]]), (self.size, self.size))
