"""From a specimen's tile to what the kernels trace: an Embree scene of a unit tile, and packed optics."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.core.embree import Handle, Scene
from microgeometry.materials import Conductor, Lambert, Material, Mirror
from microgeometry.tile import HeightField, Tile, TriangleMesh

# Free space above and below the surface, in tiles: far above float32's resolution, too thin to cost anything.
_MARGIN = 1e-4


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
    """A tile ready to trace. Keep it alive while its `embree` handle is in use.

    Parameters
    ----------
    tile : HeightField or TriangleMesh
        In metres, of any size and anywhere: it is centred in height and scaled to a unit tile in double
        precision before Embree's single precision sees it.
    """

    def __init__(self, tile: Tile) -> None:
        scale = 1.0 / max(tile.size)
        self._scene = Scene()
        if isinstance(tile, HeightField):
            z = _centred(tile.heights * scale)
            self._scene.add_grid(periodic_vertices(z, tile.size[0] * scale, tile.size[1] * scale))
            self.facets = 2 * z.size
        elif isinstance(tile, TriangleMesh):
            vertices = (tile.vertices - [*tile.origin, 0.0]) * scale
            vertices[:, 2] = z = _centred(vertices[:, 2])
            self._scene.add_triangles(vertices, tile.faces)
            self.facets = len(tile.faces)
        else:
            raise TypeError(f"tile: {type(tile).__name__}; a HeightField or a TriangleMesh is expected")
        self._scene.commit()
        self.embree: Handle = self._scene.handle
        self.box = Box(
            np.float32(tile.size[0] * scale),
            np.float32(tile.size[1] * scale),
            np.float32(z.max() + _MARGIN),
            np.float32(z.min() - _MARGIN),
            np.float32(4 * np.finfo(np.float32).eps * max(1.0, np.ptp(z))),
        )


class Optics(NamedTuple):
    """What happens at a facet; a field that is None costs nothing (its branches are not compiled).

    Both None is a lossless mirror.
    """

    eta_k: NDArray[np.float64] | None
    """Complex index of a conductor, shape (C, 2)."""
    albedo: NDArray[np.float64] | None
    """Albedo of a Lambertian facet, shape (C,)."""


def pack_optics(material: Material) -> Optics:
    """Pack a specimen's material for the kernels."""
    if isinstance(material, Mirror):
        return Optics(None, None)
    if isinstance(material, Conductor):
        return Optics(np.stack([material.eta, material.k], axis=1).astype(float), None)
    if isinstance(material, Lambert):
        return Optics(None, np.array(material.albedo, float))
    raise TypeError(f"material: {type(material).__name__}; Mirror, Conductor or Lambert is expected")


def _centred(z: NDArray[np.float64]) -> NDArray[np.float64]:
    return z - 0.5 * (z.min() + z.max())


def periodic_vertices(z: NDArray[np.float64], width_x: float, width_y: float) -> NDArray[np.float64]:
    """Vertices of a height field with its first row and column again at the far side."""
    z = np.pad(z, ((0, 1), (0, 1)), mode="wrap")
    x = np.linspace(0.0, width_x, z.shape[0])
    y = np.linspace(0.0, width_y, z.shape[1])
    return np.stack([*np.meshgrid(x, y, indexing="ij"), z], axis=-1)
