"""What one realisation of a rough mirror tells: its facets by tilt, and how many of them see two directions.

The measurement behind `gonio.trace.half_vector`, batch by batch; the kernels are in `gonio.trace.visibility`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.core.parallel import for_each
from gonio.trace.scene import TraceScene
from gonio.trace.visibility import Nodes, Relief, measure_tilts, see_both
from microgeometry.tile import HeightField

Array = NDArray[np.float64]

BINS = 1800  # of tilt, 0.05 degrees each
STEP = 0.5 * math.pi / BINS
_ROUNDS = 64, 1024  # of picks, at least and at most: the looks at a node and batch near the horizon
_PARTS = 16  # in which tilts are measured
_PATHS_PER_ROUND = 512  # looking then takes about as long as tracing (measured)
# tilts in units of alpha; beyond the last, at exp(-9) of the peak, visibility is taken as there
_TILTS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.35, 2.7, 3.0)
_WINDOW = 0.05
_OPENINGS = (0.0, 0.2, 0.35, 0.5, 0.6, 0.7, 0.78, 0.85, 0.9, 0.94, 0.97, 0.985, 0.995, 0.999)
_EVERY = (128, 128, 128, 64, 64, 32, 32, 16, 16, 8, 4, 2, 1, 1)
_TURNS_DEG = (0.0, 7.5, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0)
SHAPE = len(_TILTS), len(_OPENINGS), len(_TURNS_DEG)
"""Of the nodes of visibility."""


@dataclass
class FacetSums:
    """Sums over realisations; areas are per area of the plane.

    Parameters
    ----------
    counts : ndarray, shape (2,)
        Facets, and occlusion rays cast.
    area : ndarray, shape (BINS,)
        Of facets, by tilt.
    window_area : ndarray, shape (A,)
        Of facets in the window of each tilt of the nodes.
    seen_area : ndarray, shape SHAPE
        The part of it that sees both directions of a node, each look over the visibility it is compared with.
    """

    counts: Array
    area: Array
    window_area: Array
    seen_area: Array

    @classmethod
    def unpack(cls, packed: Array) -> FacetSums:
        """Views into one array, shape (PACKED,)."""
        counts, area, window, seen = np.split(packed, np.cumsum([2, BINS, SHAPE[0]]))
        return cls(counts, area, window, seen.reshape(SHAPE))


PACKED = 2 + BINS + SHAPE[0] + math.prod(SHAPE)
"""Numbers in a `FacetSums`."""


def nodes(alpha: float) -> Nodes:
    """Where visibility is measured on a surface of this roughness."""
    tilt = np.arctan(alpha * np.array(_TILTS))
    window = _WINDOW * alpha * np.cos(tilt) ** 2
    window[0] *= 2
    return Nodes(tilt, window, np.array(_OPENINGS), np.radians(_TURNS_DEG), np.array(_EVERY, np.int64), alpha)


def measure_facets(
    tile: HeightField,
    scene: TraceScene,
    alpha: float,
    paths: int,
    seed: int,
    batch: int,
    threads: int | None = None,
) -> Array:
    """Measure one realisation.

    Parameters
    ----------
    tile : HeightField
    scene : TraceScene
        Of this tile alone.
    alpha : float
        Roughness of the surface; it only places the nodes of visibility and sets the visibility they correct.
    paths : int
        Traced in a batch; the more, the more facets look around.
    seed, batch : int
        Key of the random numbers.
    threads : int, optional
        The result does not depend on it.

    Returns
    -------
    ndarray, shape (PACKED,)
        A `FacetSums`.
    """
    z = (tile.heights - scene.centre) / scene.unit
    nx, ny = z.shape
    relief = Relief(
        z, tile.size[0] / scene.unit / nx, tile.size[1] / scene.unit / ny, float(z.mean()), float(z.std())
    )
    places = nodes(alpha)
    rounds = int(np.clip(paths // _PATHS_PER_ROUND, *_ROUNDS))
    low, high = places.tilt - places.window, places.tilt + places.window
    tilts = np.empty((z.size, 2), np.float32)
    edges = np.linspace(0, nx, min(nx, _PARTS) + 1).astype(int).tolist()
    parts = len(edges) - 1
    area, window_area = np.zeros((parts, BINS)), np.zeros((parts, len(low)))
    found = np.zeros((parts, len(low)), np.int64)

    def tilt(n: int) -> None:
        measure_tilts(
            relief, edges[n], edges[n + 1], STEP, tilts, area[n], low, high, found[n], window_area[n]
        )

    for_each(tilt, parts, threads)
    packed = np.zeros(PACKED)
    sums = FacetSums.unpack(packed)
    sums.area[:], sums.window_area[:], members = area.sum(axis=0), window_area.sum(axis=0), found.sum(axis=0)
    looks = np.zeros(SHAPE, np.int64)

    def look(a: int) -> int:
        if members[a] == 0:
            return 0
        return see_both(
            scene.embree, scene.box, relief, tilts, low[a], high[a], members[a], a, places, rounds,
            seed, batch, looks[a], sums.seen_area[a],
        )  # fmt: skip

    rays = sum(for_each(look, len(low), threads))
    facets = 2 * z.size  # of equal projected areas, which add up to the plane's
    sums.counts[:] = facets, rays
    sums.area /= facets
    sums.window_area /= facets
    sums.seen_area *= sums.window_area[:, None, None] / np.maximum(looks, 1)
    return packed
