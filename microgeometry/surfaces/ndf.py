"""A surface with a prescribed distribution of normals."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from microgeometry.keys import Keys
from microgeometry.surfaces.slopes import SlopeDistribution, read_distribution
from microgeometry.surfaces.v_groove import draw_grooves
from microgeometry.tile import HeightField


@dataclass(frozen=True)
class Ndf:
    r"""V-grooves whose slopes follow a distribution of normals D.

    Side by side lie 64 symmetric grooves of equal width along y. Their slopes are drawn from the projected
    area of D, :math:`p(\theta) = 2 \pi D(\theta) \cos\theta \sin\theta`, one from each 64th part of it.

    What is prescribed, exactly in expectation and at each realisation to within 1/64: the inclination of the
    facets, by projected area; and with it all of D, once the specimen is turned about z as an isotropic
    measurement turns it. The facets of the tile itself look to +x and -x only.

    What is not: D does not fix a surface. Where facets stand to one another, and so shadowing, masking and
    multiple reflection, is that of V-cavities, the surface behind Torrance and Sparrow (1967) and Cook and
    Torrance (1982): not Smith's, whose facets are independent of their neighbours. Nor are there heights or
    a correlation length to speak of.

    Keys of [surface]:

    - ``distribution``: "beckmann", "ggx", or a CSV file of theta_deg, D, relative to the specimen's folder: at
      least two rows, angles that increase within 0 to 90 degrees, D not negative and of any scale, linear
      between rows, zero outside them; a header line that says theta_deg,D may lead it, and lines that start
      with # are comments.
    - ``alpha``, above 0 and at most 5: of "beckmann" and "ggx". For Beckmann it is the expected alpha of the
      mesh; GGX has no finite one, and that of a realisation says how far into its tail the draw came.
    - ``size`` (1): width of a groove in ``units`` ("um"). It changes no result in geometric optics.

    Slopes stop at 89.9 degrees (3e-6 alpha^2 of GGX's area is beyond).

    Attributes
    ----------
    distribution : SlopeDistribution
    size : float
        Width of a groove, metres.
    """

    kind: ClassVar[str] = "ndf"
    is_random: ClassVar[bool] = True

    distribution: SlopeDistribution
    size: float

    @classmethod
    def from_keys(cls, keys: Keys, folder: Path) -> Ndf:
        """Build from the [surface] table; a file is read at once."""
        keys.allow("kind", "distribution", "alpha", "size", "units")
        size = keys.number("size", 1.0, above=0) * keys.metres_per_unit()
        return cls(read_distribution(keys, folder), size)

    def realise(self, seed: int) -> HeightField:
        """Return the realisation of a seed, shape (128, 1)."""
        return draw_grooves(self.distribution, self.size, seed)
