"""From a specimen's layers to what the layered transport traces: zones, gaps, facets and media.

A stack is cut along its height into *zones*, which hold geometry, and *gaps* between them, which hold none:

    gap 0 (vacuum) | zone 0 | gap 1 | zone 1 | ... | gap Z (what lies below, if light gets there)

A zone has its own unit, its own period and its own Embree scene, so a millimetre of paint over a micrometre
of roughness costs no precision, and layers of different periods stand over one another. A path crosses a gap
in one step, however thick. A flat layer alone is a zone without a scene: a plane, in closed form. Layers
whose heights overlap share a zone, and need the same period.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio import formats
from gonio.core.embree import Handle
from gonio.core.phase import HG, ISOTROPIC, RAYLEIGH, TABULATED, tabulated_cdf
from gonio.table.pool import Pool, pool_tables
from gonio.table.table import Table
from gonio.trace.scene import MARGIN, TraceScene
from microgeometry.errors import InputError
from microgeometry.materials import (
    Black,
    Coated,
    Conductor,
    Dielectric,
    Lambert,
    Material,
    Mirror,
    NoInterface,
    TableMaterial,
)
from microgeometry.media import HenyeyGreenstein, Isotropic, Medium, Rayleigh, TabulatedPhase
from microgeometry.specimen import Layer, Specimen
from microgeometry.surfaces.flat import Flat
from microgeometry.tile import HeightField, Tile

Array = NDArray[np.float64]

# Columns of Zones.box: periods, top and bottom in units of the zone; step off a facet; metres in a unit.
WIDTH_X, WIDTH_Y, TOP, BOTTOM, LIFT, UNIT = range(6)
PLANE = 0
"""Zones.scene of a zone without one: a flat layer at z = 0."""

# Facets.kind
NONE, MIRROR, BLACK, LAMBERT, OPAQUE, CLEAR, TABLE = range(7)

# Columns of Media.phase
SCATTERS, ABSORBS, PHASE_KIND, CURVE_FIRST, CURVE_COUNT = range(5)


class Zones(NamedTuple):
    """Geometry of Z zones."""

    embree: Handle
    """Addresses of Embree's functions; its `scene` is not used."""
    scene: NDArray[np.int64]
    """(Z,) Embree scene, or PLANE."""
    first_layer: NDArray[np.int64]
    """(Z + 1,) first layer of each zone; geometry g of a scene is layer first_layer + g."""
    box: Array
    """(Z, 6), columns as above."""
    gap: Array
    """(Z + 1,) thickness in metres of the gap above each zone, and of that below the last."""


class Facets(NamedTuple):
    """What the facets of L layers do to light, at S wavelengths or channels."""

    material: NDArray[np.int64]
    """(L, 2) material of the facets of label 0 and 1."""
    label_first: NDArray[np.int64]
    """(L,) where the labels of a layer's facets begin in `labels`, or -1: all 0."""
    labels: NDArray[np.uint8]
    kind: NDArray[np.int64]
    """(M,) NONE, ... TABLE of each material; OPAQUE and CLEAR have Fresnel interfaces, with or without films."""
    eta_k: Array
    """(M, S, 2) complex index below OPAQUE and CLEAR facets."""
    albedo: Array
    """(M, S) of LAMBERT facets."""
    film: NDArray[np.int64]
    """(M, 2) first film and how many; their mirror image, for light from below, follows them."""
    film_eta_k: Array
    """(S, F, 2)"""
    film_thickness: Array
    """(F,) metres"""
    wavelength: Array
    """(S,) metres; 1 where there are no films to need it."""
    table: NDArray[np.int64]
    """(M,) index into the tables."""


class Media(NamedTuple):
    """What lies between: medium l above layer l, medium L below all; lengths in metres."""

    eta: Array
    """(L + 1, S)"""
    sigma_a: Array
    sigma_s: Array
    """(L + 1, S) each, 1/m"""
    phase: NDArray[np.int64]
    """(L + 1, 5), columns as above."""
    g: Array
    """(L + 1,)"""
    curve: Array
    """(3, N) tabulated phase functions: cosine, value, cumulative."""


class Stack(NamedTuple):
    """A specimen's optics; the geometry of a realisation comes apart from it, as Zones."""

    facets: Facets
    tables: Pool | None
    """Tables of TABLE facets; None, and nothing about tables is compiled, where there are none."""
    media: Media
    share: Array
    """(S,) weights that turn the energies of the samples into the mean over the table's channels."""
    polarised: bool
    """Whether polarisation can matter: a facet that polarises, or Rayleigh scattering."""
    transmits: bool
    """Whether light can leave below."""
    scatters: bool
    """Whether any medium scatters."""


def pack_stack(specimen: Specimen) -> Stack:
    """Pack facets and media of a specimen for the kernels.

    Raises
    ------
    InputError
        A table that is the material of facets cannot be read or does not fit the channels.
    """
    layers, samples = specimen.layers, specimen.grid.n_samples
    eta = _indices(layers, samples)
    facets, tables = _pack_facets(specimen, eta)
    polarising = bool(np.isin(facets.kind, (OPAQUE, CLEAR)).any())
    below: list[Medium | None] = [None, *(layer.medium for layer in layers)]
    media, rayleigh = _pack_media(below, eta)
    to_channels = specimen.grid.to_channels
    share = np.full(samples, 1.0 / samples) if to_channels is None else np.mean(to_channels, axis=0)
    return Stack(
        facets, pool_tables(tables) if tables else None, media, share,
        polarised=polarising or rayleigh,
        transmits=layers[-1].material.transmits and bool(np.any(media.sigma_s[-1] + media.sigma_a[-1] == 0)),
        scatters=bool(media.phase[:, SCATTERS].any()),
    )  # fmt: skip


def _indices(layers: Sequence[Layer], samples: int) -> Array:
    """Index of each medium at each sample, shape (L + 1, S)."""
    eta = [(1.0,) * samples]
    for layer in layers:
        eta.append(layer.material.index_below(eta[-1]) if layer.material.transmits else (1.0,) * samples)
    return np.array(eta, float)


def _pack_facets(specimen: Specimen, eta: Array) -> tuple[Facets, list[Table]]:
    """Facets, and the tables some of them are made of."""
    layers, grid, samples = specimen.layers, specimen.grid, specimen.grid.n_samples
    materials: list[tuple[Material, int]] = []
    index = np.zeros((len(layers), 2), np.int64)
    for number, layer in enumerate(layers):
        index[number] = len(materials)
        materials.append((layer.material, number))
        if layer.plane is not None:
            index[number, 1] = len(materials)
            materials.append((layer.plane, number))
    kind = np.zeros(len(materials), np.int64)
    eta_k = np.ones((len(materials), samples, 2))
    albedo = np.zeros((len(materials), samples))
    film = np.zeros((len(materials), 2), np.int64)
    table = np.zeros(len(materials), np.int64)
    films: list = []
    tables: list[Table] = []
    for m, (material, number) in enumerate(materials):
        substrate = material.over if isinstance(material, Coated) else material
        if isinstance(substrate, Conductor):
            kind[m] = OPAQUE
            eta_k[m] = np.stack([substrate.eta, substrate.k], axis=1)
        elif isinstance(substrate, Dielectric):
            eta_k[m] = np.stack([substrate.eta, np.zeros(samples)], axis=1)
            matched = material is substrate and np.array_equal(substrate.eta, eta[number])
            kind[m] = NONE if matched else CLEAR
        elif isinstance(material, Lambert):
            kind[m], albedo[m] = LAMBERT, material.albedo
        elif isinstance(material, TableMaterial):
            kind[m], table[m] = TABLE, len(tables)
            tables.append(_table_of_facets(material, specimen))
        else:
            kind[m] = {Mirror: MIRROR, Black: BLACK, NoInterface: NONE}[type(material)]
        if isinstance(material, Coated):
            film[m] = len(films), len(material.films)
            films += [*material.films, *reversed(material.films)]
    facets = Facets(
        material=index,
        label_first=np.full(len(layers), -1, np.int64),
        labels=np.zeros(0, np.uint8),
        kind=kind,
        eta_k=eta_k,
        albedo=albedo,
        film=film,
        film_eta_k=np.ascontiguousarray(
            np.array([[f.eta, f.k] for f in films], float).reshape(len(films), 2, samples).transpose(2, 0, 1)
        ),
        film_thickness=np.array([f.thickness for f in films], float),
        wavelength=np.ones(samples) if grid.samples_nm is None else np.array(grid.samples_nm) * 1e-9,
        table=table,
    )
    return facets, tables


def _table_of_facets(material: TableMaterial, specimen: Specimen) -> Table:
    """A table with the specimen's samples for channels."""
    table, grid = formats.read(material.file), specimen.grid
    samples = grid.n_samples
    if len(table.channels) == samples and table.wavelengths_nm in (None, grid.samples_nm):
        return table
    if len(table.channels) == 1:
        matrix = np.ones((samples, 1))
    elif table.wavelengths_nm is not None and grid.samples_nm is not None:
        order = np.argsort(table.wavelengths_nm)
        known = np.array(table.wavelengths_nm)[order]
        wanted = np.array(grid.samples_nm)
        if wanted.min() < known[0] - 1e-6 or wanted.max() > known[-1] + 1e-6:
            raise InputError(
                f"{material.file}: has wavelengths from {known[0]:g} to {known[-1]:g} nm; the specimen's go from "
                f"{wanted.min():g} to {wanted.max():g} nm. Change wavelengths_nm under [grid]"
            )
        matrix = np.stack([np.interp(wanted, known, row) for row in np.eye(len(known))[order]], axis=1)
    else:
        raise InputError(
            f"{material.file}: has {len(table.channels)} channels ({', '.join(table.channels[:4])}); facets here "
            f"need {samples} ({', '.join(grid.channels[:4])}), one channel, or wavelengths on both sides"
        )
    return table.replace(
        values=table.values @ matrix.T,
        row_albedo=table.row_albedo @ matrix.T,
        specular=table.specular @ matrix.T,
        std_error=None, albedo_std_error=np.zeros(()), specular_std_error=np.zeros(()),
        channels=tuple(map(str, range(samples))), wavelengths_nm=None, parts={},
    )  # fmt: skip


def _pack_media(below: Sequence[Medium | None], eta: Array) -> tuple[Media, bool]:
    """Media, and whether any scatters by Rayleigh's law."""
    sigma_a, sigma_s = np.zeros_like(eta), np.zeros_like(eta)
    phase = np.zeros((len(eta), 5), np.int64)
    g = np.zeros(len(eta))
    curves: list[Array] = []
    for m, medium in enumerate(below):
        if medium is None:
            continue
        sigma_a[m], sigma_s[m] = medium.sigma_a, medium.sigma_s
        phase[m, SCATTERS], phase[m, ABSORBS] = any(medium.sigma_s), any(medium.sigma_a)
        law = medium.phase
        if isinstance(law, HenyeyGreenstein):
            phase[m, PHASE_KIND], g[m] = HG, law.g
        elif isinstance(law, TabulatedPhase):
            phase[m, PHASE_KIND:] = TABULATED, sum(c.shape[1] for c in curves), len(law.cosines)
            curves.append(np.stack([law.cosines, law.values, tabulated_cdf(law.cosines, law.values)]))
        else:
            phase[m, PHASE_KIND] = {Isotropic: ISOTROPIC, Rayleigh: RAYLEIGH}[type(law)]
    rayleigh = bool(np.any((phase[:, PHASE_KIND] == RAYLEIGH) & (phase[:, SCATTERS] == 1)))
    return Media(
        eta, sigma_a, sigma_s, phase, g, np.concatenate([*curves, np.zeros((3, 0))], axis=1)
    ), rayleigh


class StackScene:
    """One realisation of a specimen's layers, ready to trace. Keep it alive while `zones` is in use.

    Parameters
    ----------
    layers : sequence of Layer
    tiles : sequence of HeightField or TriangleMesh
        One a layer, in metres.

    Raises
    ------
    InputError
        Layers overlap in height and have different periods.
    """

    def __init__(self, layers: Sequence[Layer], tiles: Sequence[Tile]) -> None:
        planes = [0.0]  # mean plane of each layer, the first at 0
        for layer in layers[:-1]:
            planes.append(planes[-1] - (layer.medium.thickness if layer.medium is not None else 0.0))
        extents = [_extent(tile) for tile in tiles]
        groups: list[list[int]] = []
        floor = 0.0
        for number, (tile, (low, high, mean)) in enumerate(zip(tiles, extents, strict=True)):
            # boxes have margins: what would touch them is kept together
            margin = 0.0 if low == high else 2 * MARGIN * max(tile.size)
            if number > 0 and planes[number] + high - mean + margin >= floor:
                groups[-1].append(number)
                floor = min(floor, planes[number] + low - mean - margin)
            else:
                groups.append([number])
                floor = planes[number] + low - mean - margin
        self._scenes: list[TraceScene | None] = []
        box = np.zeros((len(groups), 6))
        tops, bottoms = np.zeros(len(groups)), np.zeros(len(groups))
        for z, group in enumerate(groups):
            if len(group) == 1 and isinstance(layers[group[0]].surface, Flat):
                self._scenes.append(None)
                box[z] = np.inf, np.inf, 0.0, 0.0, 0.0, 1.0
                tops[z] = bottoms[z] = planes[group[0]]
                continue
            members = _common_period([tiles[n] for n in group], [layers[n] for n in group], group)
            shifts = [planes[n] - extents[n][2] for n in group]
            scene = TraceScene(members, shifts)
            self._scenes.append(scene)
            b = scene.box
            box[z] = b.width_x, b.width_y, b.top, b.bottom, b.lift, scene.unit
            tops[z] = scene.centre + float(b.top) * scene.unit
            bottoms[z] = scene.centre + float(b.bottom) * scene.unit
        last = layers[-1].medium
        gap = np.full(len(groups) + 1, np.inf)
        gap[1:-1] = bottoms[:-1] - tops[1:]
        gap[-1] = np.inf if last is None else last.thickness
        handles = [scene.embree for scene in self._scenes if scene is not None]
        self.zones = Zones(
            embree=handles[0] if handles else Handle(0, 0, 0, 0, 0, 0, 0),
            scene=np.array([PLANE if s is None else s.embree.scene for s in self._scenes], np.int64),
            first_layer=np.array([group[0] for group in groups] + [len(layers)], np.int64),
            box=box,
            gap=gap,
        )
        self.facets = sum(0 if scene is None else scene.facets for scene in self._scenes)
        self._tiles = tiles

    def label(self, facets: Facets) -> Facets:
        """The facets' optics with the labels of these tiles."""
        first = np.full(len(self._tiles), -1, np.int64)
        labels: list[NDArray[np.uint8]] = []
        for number, tile in enumerate(self._tiles):
            of_tile = getattr(tile, "labels", None)
            if of_tile is not None:
                first[number] = sum(map(len, labels))
                labels.append(of_tile)
        if not labels:
            return facets
        return facets._replace(label_first=first, labels=np.concatenate(labels))


def _extent(tile: Tile) -> tuple[float, float, float]:
    """Lowest, highest and mean height of a tile; the mean of a mesh is that of its upper side."""
    if isinstance(tile, HeightField):
        return float(tile.heights.min()), float(tile.heights.max()), float(tile.heights.mean())
    normals, areas = tile.facets()
    weight = np.maximum(normals[:, 2], 0.0) * areas
    z = tile.vertices[tile.faces, 2]
    return float(z.min()), float(z.max()), float(weight @ z.mean(axis=1) / weight.sum())


def _common_period(tiles: list[Tile], layers: list[Layer], group: list[int]) -> list[Tile]:
    """Tiles of one period: planes take that of the others; the others must agree."""
    rough = [t.size for t, layer in zip(tiles, layers, strict=True) if not isinstance(layer.surface, Flat)]
    size = rough[0] if rough else tiles[0].size
    for other in rough[1:]:
        if not np.allclose(other, size, rtol=1e-9, atol=0):
            raise InputError(
                f"layers {group[0] + 1} to {group[-1] + 1} overlap in height, so they need the same period; theirs "
                f"are {size[0]:.6g} x {size[1]:.6g} m and {other[0]:.6g} x {other[1]:.6g} m. Give both the same "
                "size, or a thicker medium between them"
            )
    return [
        HeightField(np.zeros((2, 2)), size) if isinstance(layer.surface, Flat) else tile
        for tile, layer in zip(tiles, layers, strict=True)
    ]
