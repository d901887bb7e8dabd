"""A specimen's realisations, and the kernel that traces each: the fast one where it will do."""

from __future__ import annotations

from dataclasses import asdict
from typing import Protocol

import numpy as np

from gonio.trace.analog import Beam, Part, trace_stack, trace_surface
from gonio.trace.binning import Bins, Sums
from gonio.trace.few_facets import net, trace_on_net
from gonio.trace.scene import Optics, TraceScene, pack_optics
from gonio.trace.stack import Stack, StackScene, pack_stack
from gonio.trace.stack_looks import clear_zones
from gonio.trace.transport import MAX_SEGMENTS
from microgeometry.specimen import Specimen
from microgeometry.tile import HeightField, SurfaceStatistics, Tile

MAX_BOUNCES = 10_000
# In a medium that hardly absorbs, light scatters thousands of times before it is out; most of these take one
# segment of the path, some two or three, and the cap on segments would call it lost.
MAX_SCATTERINGS = MAX_SEGMENTS // 4
_STATISTICS_TILES = 8  # realisations whose facets are measured
_HORIZON_PATHS = (
    2  # of a realisation, a sample of it, from which on the horizon saves more time than it takes (measured)
)
_COHERENT_FACETS = 8  # facets per path of a row below which coherent packets are faster (measured)


class Realisation(Protocol):
    """One realisation of a specimen, ready to trace."""

    def trace(self, bins: Bins, beam: Beam, part: Part, batch: int, sums: Sums) -> None:
        """Trace a part of one row's paths and add them to `sums`."""
        ...


class Tracer:
    """Chooses how a specimen is traced, and realises it batch by batch.

    Parameters
    ----------
    specimen : Specimen
    seed : int
    paths_per_row : int
        Of a batch.
    rows : int
    looks : int, optional
        Detectors that a stack's light is joined to at every facet that scatters; default: none.
    on_net : bool
        Whether paths over a surface of mirrors start on the net of `gonio.trace.few_facets`.

    Attributes
    ----------
    stack : Stack
    optics : Optics or None
        Where one opaque surface is all there is.
    to_channels : ndarray or None, shape (C, S)
        From the samples traced to the table's channels; None where they are the same.
    hemispheres : int
        1, or 2 where light can leave below.
    ledger_names : tuple of str
        Further columns of the ledger: energy absorbed, for each layer at its surface and in its medium.
    empty_columns : set of str
        Those of media that do not exist.

    Raises
    ------
    InputError
        The specimen's facets cannot be packed; see `gonio.trace.stack.pack_stack`.
    """

    def __init__(
        self,
        specimen: Specimen,
        seed: int,
        paths_per_row: int,
        rows: int = 1,
        looks: int | None = None,
        on_net: bool = False,
    ) -> None:
        self.stack: Stack = pack_stack(specimen)
        self.hemispheres = 2 if self.stack.transmits else 1
        self._specimen = specimen
        self._seed = seed
        self._paths_per_row = paths_per_row
        self._paths = paths_per_row * rows
        self._looks = looks
        self._net = net(paths_per_row) if on_net else None
        layers = specimen.layers
        self.optics = pack_optics(layers[0]) if len(layers) == 1 else None
        self.ledger_names: tuple[str, ...] = ()
        if self.optics is None:
            self.ledger_names = tuple(
                f"absorbed: layer {number} {what}"
                for number in range(1, len(layers) + 1)
                for what in ("surface", "medium")
            )
        self.empty_columns = {
            name for name, layer in zip(self.ledger_names[1::2], layers, strict=False) if layer.medium is None
        }
        grid = specimen.grid
        self.to_channels = None if grid.to_channels is None else np.array(grid.to_channels)
        self._statistics: list[list[SurfaceStatistics]] = []
        self._fixed: Realisation | None = None

    def realise(self, batch: int) -> Realisation:
        """The realisation of a batch; a specimen without anything random has one for all."""
        if self._fixed is not None:
            return self._fixed
        tiles = self.tiles(batch)
        if batch == len(self._statistics) < _STATISTICS_TILES:
            self._statistics.append([tile.statistics() for tile in tiles])
        realisation: Realisation
        if self.optics is not None:
            realisation = Surface(self, self.optics, tiles[0])
        else:
            realisation = Layers(self, tiles)
        if not self._specimen.is_random:
            self._fixed = realisation
        return realisation

    def statistics(self, batches: int) -> list[dict[str, float]]:
        """What is measured on the facets of each layer, the mean over the first of so many batches."""
        for batch in range(len(self._statistics), min(batches, _STATISTICS_TILES)):
            if batch > 0 and not self._specimen.is_random:
                break
            # traced by others, or before a measurement was resumed
            self._statistics.append([tile.statistics() for tile in self.tiles(batch)])
        return [
            {name: float(np.mean([asdict(tile)[name] for tile in tiles])) for name in asdict(tiles[0])}
            for tiles in zip(*self._statistics, strict=True)
        ]

    def _finds_horizon(self, tile: Tile) -> bool:
        """Whether so many paths meet a realisation that the rays saved are worth the horizon."""
        if not isinstance(tile, HeightField):
            return False
        return not self._specimen.is_random or self._paths >= _HORIZON_PATHS * tile.heights.size

    def tiles(self, batch: int) -> list[Tile]:
        """One period of each layer's surface, in the realisation of a batch."""
        return [
            layer.surface.realise(_realisation_seed(self._seed, batch, number))
            for number, layer in enumerate(self._specimen.layers)
        ]


class Surface:
    """One opaque surface of one material: 16 paths at a time; a `Realisation`.

    Attributes
    ----------
    tile : Tile
    scene : TraceScene
        Of this tile.
    """

    def __init__(self, tracer: Tracer, optics: Optics, tile: Tile) -> None:
        self.tile = tile
        self.scene = TraceScene([tile], horizon=tracer._finds_horizon(tile))
        self._tracer = tracer
        self._optics = optics
        self._coherent = tracer._paths_per_row * _COHERENT_FACETS >= self.scene.facets

    def trace(self, bins: Bins, beam: Beam, part: Part, batch: int, sums: Sums) -> None:
        """As `Realisation.trace`."""
        tracer, scene = self._tracer, self.scene
        if tracer._net is not None:
            trace_on_net(
                scene.embree, scene.box, scene.horizon, self._optics.eta_k, tracer.to_channels, bins, beam,
                tracer._net, part.first, part.last, tracer._seed, batch, MAX_BOUNCES, sums,
            )  # fmt: skip
            return
        trace_surface(
            scene.embree, scene.box, scene.horizon, self._coherent, *self._optics, tracer.to_channels, bins,
            beam, part, tracer._seed, batch, MAX_BOUNCES, sums,
        )  # fmt: skip


class Layers:
    """A stack of layers, or one surface that needs more than `Surface` knows: one path at a time; a `Realisation`.

    Attributes
    ----------
    clear_layers : int
        Layers, from the top, whose light detectors may be joined to; see `gonio.trace.stack_looks.clear_zones`.
    """

    def __init__(self, tracer: Tracer, tiles: list[Tile]) -> None:
        self._tracer = tracer
        self._scene = StackScene(tracer._specimen.layers, tiles)
        self._facets = self._scene.label(tracer.stack.facets)
        self._clear = clear_zones(self._scene.zones, self._facets)
        self.clear_layers = int(self._scene.zones.first_layer[self._clear])

    def trace(self, bins: Bins, beam: Beam, part: Part, batch: int, sums: Sums) -> None:
        """As `Realisation.trace`."""
        tracer, stack = self._tracer, self._tracer.stack
        max_bounces = MAX_SCATTERINGS if stack.scatters else MAX_BOUNCES
        trace_stack(
            self._scene.zones, self._facets, stack.tables, stack.media, stack.polarised, tracer.to_channels,
            tracer._looks, self._clear, bins, beam, part, tracer._seed, batch, max_bounces, sums,
        )  # fmt: skip


def _realisation_seed(seed: int, batch: int, layer: int) -> int:
    entropy = (seed, batch, layer) if layer else (seed, batch)
    return int(np.random.SeedSequence(entropy).generate_state(1, np.uint64)[0])
