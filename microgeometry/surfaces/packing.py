"""Random packings of spheres."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from microgeometry.errors import InputError

_ROUNDS = 5000


def pack(
    rng: np.random.Generator, fraction: float, height: float, side: float, gap: float
) -> tuple[float, NDArray[np.float64]]:
    """Pack spheres of radius 1 at random into a slab that is periodic in x and y.

    Points drawn uniformly are pushed apart, all pairs that overlap at once, each by half of what it lacks,
    until none does: the energy minimisation of O'Hern et al., Physical Review E 68, 011306 (2003), which
    ends below the density at which random packings jam (0.64 in bulk, less between walls).

    Parameters
    ----------
    rng : numpy.random.Generator
    fraction : float
        Volume of the spheres / volume of the slab.
    height : float
        Of the slab, at least 2 + gap; the spheres stay `gap` above its floor.
    side : float
        About that of the slab's square.
    gap : float
        Spheres stay that far apart.

    Returns
    -------
    side : float
        Such that a whole number of spheres makes up the fraction.
    centres : ndarray, shape (n, 3)

    Raises
    ------
    InputError
        So many find no room.
    """
    number = max(1, round(fraction * height * side**2 / (4.0 / 3.0 * pi)))
    side = sqrt(number * (4.0 / 3.0 * pi) / (fraction * height))
    low, high = 1.0 + gap, max(1.0 + gap, height - 1.0)
    centres = rng.uniform((0.0, 0.0, low), (side, side, high), (number, 3))
    for _ in range(_ROUNDS):
        tree = cKDTree(centres, boxsize=(side, side, 3.0 * height))
        pairs = tree.query_pairs(2.0 + gap, output_type="ndarray")
        if len(pairs) == 0:
            return side, centres
        apart = centres[pairs[:, 0]] - centres[pairs[:, 1]]
        apart[:, :2] -= side * np.round(apart[:, :2] / side)
        distance = np.linalg.norm(apart, axis=1)
        # A little too far, so that the last pairs come free in few rounds.
        push = (0.5 * (2.0 + 2.0 * gap - distance) / distance)[:, None] * apart
        np.add.at(centres, pairs[:, 0], push)
        np.add.at(centres, pairs[:, 1], -push)
        centres[:, :2] %= side
        centres[:, :2][centres[:, :2] >= side] = 0.0  # what the remainder of a tiny negative is rounded to
        centres[:, 2] = np.clip(centres[:, 2], low, high)
    raise InputError("fraction: no room for the spheres at random; lower it")
