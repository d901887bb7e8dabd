"""From a specimen's tile to what the kernels trace: an Embree scene of a unit tile, and packed optics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.core.embree import Handle, Scene
from gonio.trace.horizon import NO_HORIZON, Horizon, find_horizon
from microgeometry.materials import Conductor, Lambert, Mirror
from microgeometry.specimen import Layer
from microgeometry.tile import HeightField, Tile, TriangleMesh

# Free space above and below the surface, in tiles: far above float32's resolution, too thin to cost anything.
MARGIN = 1e-4


class Box(NamedTuple):
    """Space of a periodic tile: x in [0, width_x], y in [0, width_y], the longer side 1.

    Rays enter on the plane z = top and have left once above it; below `bottom` there is nothing.
    """

    width_x: np.float32
    width_y: np.float32
    top: np.float32
    bottom: np.float32
    lift: np.float32
    """How far a path steps off the surface along the normal: four units in the last place."""


class TraceScene:
    """Tiles of one period, ready to trace. Keep it alive while its `embree` handle is in use.

    Parameters
    ----------
    tiles : sequence of HeightField or TriangleMesh
        In metres, of any size and anywhere: they are centred in height and scaled to a unit tile in double
        precision before Embree's single precision sees them. Tile g is geometry g.
    shifts : sequence of float, optional
        How far each is lifted first, metres.
    horizon : bool
        Whether to find the horizon, where a height field stands alone.

    Attributes
    ----------
    embree : Handle
    box : Box
    unit : float
        Metres in the unit tile's unit of length.
    centre : float
        Height, in metres, that the unit tile has as z = 0.
    facets : int
        Number of triangles.
    horizon : Horizon
        `NO_HORIZON`, where it was not asked for or is not known.
    """

    def __init__(
        self, tiles: Sequence[Tile], shifts: Sequence[float] | None = None, *, horizon: bool = False
    ) -> None:
        heights = [_heights(tile) for tile in tiles]
        lifts = [0.0] * len(tiles) if shifts is None else shifts
        low = min(float(z.min()) + lift for z, lift in zip(heights, lifts, strict=True))
        high = max(float(z.max()) + lift for z, lift in zip(heights, lifts, strict=True))
        width, depth = tiles[0].size
        self.unit = max(width, depth)
        self.centre = 0.5 * (low + high)
        self.facets = 0
        scale = 1.0 / self.unit
        self._scene = Scene()
        for tile, z, lift in zip(tiles, heights, lifts, strict=True):
            z = (z - (self.centre - lift)) * scale
            if isinstance(tile, HeightField):
                self._scene.add_grid(periodic_vertices(z, width * scale, depth * scale))
                self.facets += 2 * z.size
            else:
                xy = (tile.vertices[:, :2] - tile.origin) * scale
                self._scene.add_triangles(np.column_stack([xy, z]), tile.faces)
                self.facets += len(tile.faces)
        self._scene.commit()
        self.embree: Handle = self._scene.handle
        self.horizon: Horizon = NO_HORIZON
        if horizon and len(tiles) == 1 and isinstance(tiles[0], HeightField):
            self.horizon = find_horizon(z, width * scale, depth * scale)
        half = 0.5 * (high - low) * scale
        self.box = Box(
            np.float32(width * scale),
            np.float32(depth * scale),
            np.float32(half + MARGIN),
            np.float32(-half - MARGIN),
            np.float32(4 * np.finfo(np.float32).eps * max(1.0, 2.0 * half)),
        )


def _heights(tile: Tile) -> NDArray[np.float64]:
    if isinstance(tile, HeightField):
        return tile.heights
    if isinstance(tile, TriangleMesh):
        return tile.vertices[:, 2]
    raise TypeError(f"tile: {type(tile).__name__}; a HeightField or a TriangleMesh is expected")


class Optics(NamedTuple):
    """What happens at a facet; a field that is None costs nothing (its branches are not compiled).

    Both None is a lossless mirror.
    """

    eta_k: NDArray[np.float64] | None
    """Complex index of a conductor, shape (S, 2)."""
    albedo: NDArray[np.float64] | None
    """Albedo of a Lambertian facet, shape (S,)."""


def pack_optics(layer: Layer) -> Optics | None:
    """Pack a layer's material, if it is one that `gonio.trace.transport` traces over all of its surface."""
    material = layer.material
    if layer.plane is not None:
        return None
    if isinstance(material, Mirror):
        return Optics(None, None)
    if isinstance(material, Conductor):
        return Optics(np.stack([material.eta, material.k], axis=1).astype(float), None)
    if isinstance(material, Lambert):
        return Optics(None, np.array(material.albedo, float))
    return None


def periodic_vertices(z: NDArray[np.float64], width_x: float, width_y: float) -> NDArray[np.float64]:
    """Vertices of a height field with its first row and column again at the far side."""
    z = np.pad(z, ((0, 1), (0, 1)), mode="wrap")
    x = np.linspace(0.0, width_x, z.shape[0])
    y = np.linspace(0.0, width_y, z.shape[1])
    return np.stack([*np.meshgrid(x, y, indexing="ij"), z], axis=-1)
