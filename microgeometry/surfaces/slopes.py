"""Distributions of slope that grooves are drawn from: of one angle, over the projected area.

Each gives the slopes below which lie shares u of the tile, so uniform u draw from it. A slope is the angle
of a facet against the plane; the projected area of facets with normals in d omega about an angle theta is
D(theta) cos(theta) d omega, so over all azimuths p(theta) = 2 pi D(theta) cos(theta) sin(theta).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, radians
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from microgeometry.keys import Keys, suggest

MAX_SLOPE_DEG = 89.9
# So fine that no facet's direction can tell the sum from the integral: 0.02 degrees over a right angle.
_STEPS = 4500


class SlopeDistribution(Protocol):
    """The contract of every distribution."""

    def slopes(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the slopes, radians, below which lie the shares u in [0, 1), shape (n,), of the tile."""
        ...


@dataclass(frozen=True)
class Beckmann:
    """D of Beckmann and Spizzichino (1963): tan^2 is exponential of mean alpha^2."""

    alpha: float

    def slopes(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """See `SlopeDistribution`."""
        return np.arctan(self.alpha * np.sqrt(-np.log1p(-u)))


@dataclass(frozen=True)
class Ggx:
    """D of Walter et al. (2007), of Trowbridge and Reitz (1975)."""

    alpha: float

    def slopes(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """See `SlopeDistribution`."""
        return np.arctan(self.alpha * np.sqrt(u / (1.0 - u)))


@dataclass(frozen=True)
class Normal:
    """A normal distribution of the slope itself, cut off at 0 and `MAX_SLOPE_DEG`; radians."""

    mean: float
    std: float

    def slopes(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """See `SlopeDistribution`."""
        low, high = ndtr((np.array((0.0, radians(MAX_SLOPE_DEG))) - self.mean) / self.std)
        return np.maximum(self.mean + self.std * ndtri(low + u * (high - low)), 0.0)


@dataclass(frozen=True)
class OrenNayar:
    """The slope-area distribution of Oren and Nayar (1994), exp(-theta^2 / (2 std^2)) per solid angle; radians.

    The area in it is the projected one, so p(theta) has a factor sin(theta), and for small std the mean of
    theta^2 is 2 std^2.
    """

    std: float

    def slopes(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """See `SlopeDistribution`."""
        if self.std == 0:
            return np.zeros_like(u)
        edges = np.linspace(0.0, min(0.5 * pi, 9.0 * self.std), _STEPS + 1)
        middle = 0.5 * (edges[1:] + edges[:-1])
        return _inverse_cdf(edges, np.exp(-0.5 * (middle / self.std) ** 2) * np.sin(middle), u)


@dataclass(frozen=True)
class Tabulated:
    """D of any scale as rows (theta in radians, D), linear between them and zero outside."""

    rows: tuple[tuple[float, float], ...]

    def slopes(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """See `SlopeDistribution`."""
        theta, density = np.transpose(self.rows)
        edges = np.union1d(np.linspace(theta[0], theta[-1], _STEPS + 1), theta)
        middle = 0.5 * (edges[1:] + edges[:-1])
        return _inverse_cdf(edges, np.interp(middle, theta, density) * np.sin(2.0 * middle), u)


def read_distribution(
    keys: Keys, folder: Path, allowed: tuple[str, ...] = ("beckmann", "ggx")
) -> SlopeDistribution:
    """Read ``distribution``, and the key that its kind needs; raises `InputError`.

    Parameters
    ----------
    keys : Keys
        The [surface] table.
    folder : Path
        What the name of a CSV file is relative to.
    allowed : tuple of str
        Names allowed, of "beckmann", "ggx" and "oren_nayar"; a file always is.
    """
    name = keys.text("distribution")
    known = name in allowed
    if not known and not (folder / name).is_file():
        raise keys.error(
            "distribution",
            f"must be {', '.join(map(repr, allowed))} or a CSV file of theta_deg, D{suggest(name, allowed)}; "
            f"there is no file {folder / name}",
        )
    needs = {"beckmann": "alpha", "ggx": "alpha", "oren_nayar": "slope_std_deg"}.get(name if known else "")
    for key in ("alpha", "slope_std_deg"):
        if key in keys and key != needs:
            raise keys.error(key, f"the distribution {name!r} has none; leave it out")
    if not known:
        return Tabulated(_read(keys, folder / name))
    if name == "oren_nayar":
        return OrenNayar(radians(keys.number("slope_std_deg", at_least=0, at_most=60)))
    alpha = keys.number("alpha", above=0, at_most=5)
    return Beckmann(alpha) if name == "beckmann" else Ggx(alpha)


def _read(keys: Keys, file: Path) -> tuple[tuple[float, float], ...]:
    try:
        lines = file.read_text(encoding="utf-8-sig").splitlines()
        lines = [line for line in lines if line.strip() and not line.lstrip().startswith("#")]
        if lines and [name.strip() for name in lines[0].split(",")] == ["theta_deg", "D"]:
            del lines[0]
        rows = np.loadtxt(lines, delimiter=",", ndmin=2) if lines else np.empty((0, 2))
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


def _inverse_cdf(
    edges: NDArray[np.float64], density: NDArray[np.float64], u: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Values below which lie the shares u (n,) of a density (m - 1,), constant between its edges (m,)."""
    cdf = np.concatenate(([0.0], np.cumsum(density * np.diff(edges))))
    # Where the density is zero the sum stands still; the interval's upper end is then skipped by the strict
    # search.
    interval = np.clip(np.searchsorted(cdf, u * cdf[-1], side="right") - 1, 0, len(density) - 1)
    share = (u * cdf[-1] - cdf[interval]) / np.diff(cdf)[interval]
    return edges[interval] + share * np.diff(edges)[interval]
