"""Klems' patches of the hemisphere, as WINDOW's matrices use them: full, half and quarter.

A ring of polar angles has patches of equal width in azimuth, the first centred on azimuth 0. Patches are
numbered from the normal outwards. An incident patch is that of the direction in which light travels, so
that a matrix's diagonal is the mirror direction, or straight through.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BASES = {
    "LBNL/Klems Full": ((0, 5, 15, 25, 35, 45, 55, 65, 75, 90), (1, 8, 16, 20, 24, 24, 24, 16, 12)),
    "LBNL/Klems Half": ((0, 6.5, 19.5, 32.5, 46.5, 61.5, 76.5, 90), (1, 8, 12, 16, 20, 12, 4)),
    "LBNL/Klems Quarter": ((0, 9, 27, 46, 66, 90), (1, 8, 12, 12, 8)),
}
"""Name to bounds of the rings in degrees and patches per ring."""


class Klems:
    """One of the bases.

    Parameters
    ----------
    name : str
        A key of `BASES`.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        degrees, counts = BASES[name]
        self.edges = np.radians(degrees)
        self.counts = np.array(counts)
        self.first = np.concatenate([[0], np.cumsum(self.counts)])

    @property
    def size(self) -> int:
        """Number of patches."""
        return int(self.first[-1])

    def azimuths(self, ring: int) -> Array:
        """Middles of a ring's patches."""
        return np.linspace(0.0, 2 * np.pi, int(self.counts[ring]), endpoint=False)

    def index(self, theta: Array, phi: Array) -> NDArray[np.int64]:
        """The patch of each direction; radians, any azimuth."""
        ring = np.clip(np.searchsorted(self.edges, theta, "right") - 1, 0, len(self.counts) - 1)
        n = self.counts[ring]
        return self.first[ring] + np.floor(phi / (2 * np.pi) * n + 0.5).astype(np.int64) % n

    def points(self, patch: int, n_theta: int, n_phi: int) -> tuple[Array, Array]:
        """Polar angles and azimuths of points of equal projected solid angle in a patch, flat."""
        ring = int(np.searchsorted(self.first, patch, "right")) - 1
        u = np.sin(self.edges[ring : ring + 2]) ** 2
        theta = np.arcsin(np.sqrt(u[0] + (np.arange(n_theta) + 0.5) / n_theta * (u[1] - u[0])))
        place = (patch - self.first[ring]) - 0.5 + (np.arange(n_phi) + 0.5) / n_phi
        theta, phi = np.meshgrid(theta, place * 2 * np.pi / self.counts[ring], indexing="ij")
        return theta.ravel(), phi.ravel()
