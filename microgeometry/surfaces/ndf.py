"""A surface with a prescribed distribution of normals."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from microgeometry.keys import Keys
from microgeometry.surfaces.v_groove import MAX_SLOPE_DEG, N_RANDOM, grooves
from microgeometry.tile import HeightField


@dataclass(frozen=True)
class Ndf:
    r"""V-grooves whose slopes follow a distribution of normals D.

    Side by side lie 256 symmetric grooves of equal width along y. The slope of each is drawn from the
    projected area of D, :math:`p(\theta) = 2 \pi D(\theta) \cos\theta \sin\theta`, so that the facets of the
    specimen, turned about z as an isotropic measurement turns it, have the normals asked for, exactly in
    expectation. This is the surface behind Torrance and Sparrow (1967) and Cook and Torrance (1982): its
    shadowing is that of V-cavities, not Smith's. A distribution of normals does not fix a surface; this is
    one of those that have it.

    Keys of [surface]:

    - ``distribution``: "beckmann", "ggx", or a CSV file of theta_deg, D: at least two rows, angles that
      increase within 0 to 90 degrees, D not negative and of any scale, linear between rows, zero outside
      them; a line that starts with # is a comment. Relative to the specimen's folder.
    - ``alpha``, above 0 and at most 5: of "beckmann" and "ggx". For Beckmann it is the expected alpha of the
      mesh; GGX has no finite one, and that of a realisation says how far into its tail the draw came.
    - ``size`` (1): width of a groove in ``units`` ("um"). It changes no result in geometric optics.

    Slopes stop at 89.9 degrees (3e-6 alpha^2 of GGX's area is beyond).

    Attributes
    ----------
    distribution : str
        "beckmann", "ggx", or "file".
    alpha : float or None
        None for a file.
    table : tuple of (float, float)
        Rows theta, D of the file, theta in radians; else empty.
    size : float
        Width of a groove, metres.
    """

    kind: ClassVar[str] = "ndf"
    is_random: ClassVar[bool] = True

    distribution: str
    alpha: float | None
    table: tuple[tuple[float, float], ...]
    size: float

    @classmethod
    def from_keys(cls, keys: Keys, folder: Path) -> Ndf:
        """Build from the [surface] table; a file is read at once."""
        keys.allow("kind", "distribution", "alpha", "size", "units")
        size = keys.number("size", 1.0, above=0) * keys.metres_per_unit()
        name = keys.text("distribution")
        if name in ("beckmann", "ggx"):
            return cls(name, keys.number("alpha", above=0, at_most=5), (), size)
        if not (folder / name).is_file():
            raise keys.error(
                "distribution",
                f"must be 'beckmann', 'ggx' or a CSV file of theta_deg, D; there is no file {folder / name}",
            )
        if "alpha" in keys:
            raise keys.error("alpha", "a distribution from a file has none; leave it out")
        return cls("file", None, _read(keys, folder / name), size)

    def realise(self, seed: int) -> HeightField:
        """Return the realisation of a seed, shape (512, 1)."""
        u = np.random.Generator(np.random.PCG64(seed)).uniform(size=N_RANDOM)
        if self.distribution == "beckmann":
            assert self.alpha is not None
            slopes = np.arctan(self.alpha * np.sqrt(-np.log1p(-u)))
        elif self.distribution == "ggx":
            assert self.alpha is not None
            slopes = np.arctan(self.alpha * np.sqrt(u / (1.0 - u)))
        else:
            slopes = _inverse_cdf(np.array(self.table), u)
        return grooves(np.minimum(slopes, radians(MAX_SLOPE_DEG)), self.size)


def _read(keys: Keys, file: Path) -> tuple[tuple[float, float], ...]:
    try:
        rows = np.loadtxt(file, delimiter=",", ndmin=2)
    except (ValueError, OSError) as error:
        reason = " ".join(str(error).split())[:150]
        raise keys.error("distribution", f"cannot be read as rows of theta_deg, D ({reason})") from error
    if rows.ndim != 2 or rows.shape[1] != 2 or len(rows) < 2 or not np.isfinite(rows).all():
        raise keys.error("distribution", "must be at least two rows of two finite numbers, theta_deg, D")
    theta, density = rows.T
    if theta[0] < 0 or theta[-1] > 90 or (np.diff(theta) <= 0).any():
        raise keys.error("distribution", "theta_deg must increase from row to row, within 0 to 90")
    if (density < 0).any() or not (density[theta < MAX_SLOPE_DEG] > 0).any():
        raise keys.error("distribution", "D must not be negative, and above 0 somewhere below 89.9 degrees")
    return tuple(
        (float(t), float(d)) for t, d in zip(np.deg2rad(theta), density / density.max(), strict=True)
    )


def _inverse_cdf(table: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles below which lies the share u (n,) of D cos sin, D linear between the rows of `table` (m, 2)."""
    # Midpoint rule on steps of at most 0.02 degrees, which no facet's direction can tell from the integral.
    edges = np.union1d(np.linspace(table[0, 0], table[-1, 0], 4501), table[:, 0])
    middle = 0.5 * (edges[1:] + edges[:-1])
    density = np.interp(middle, table[:, 0], table[:, 1]) * np.sin(2.0 * middle)
    cdf = np.concatenate(([0.0], np.cumsum(density * np.diff(edges))))
    # Where D is zero the sum stands still; the interval's upper end is then skipped by the strict search.
    interval = np.clip(np.searchsorted(cdf, u * cdf[-1], side="right") - 1, 0, len(middle) - 1)
    share = (u * cdf[-1] - cdf[interval]) / np.diff(cdf)[interval]
    return edges[interval] + share * np.diff(edges)[interval]
