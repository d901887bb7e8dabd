"""Which estimator traces a specimen."""

from __future__ import annotations

import math

import numpy as np

from gonio.core.phase import hg, rayleigh
from gonio.table.table import Table
from gonio.trace.few_facets import MOST_DIRECTIONS, directions
from gonio.trace.stack import LAMBERT, SCATTERS, TABLE
from gonio.trace.tracer import Layers, Tracer
from microgeometry.errors import InputError
from microgeometry.materials import Conductor, Mirror, TableMaterial
from microgeometry.media import HenyeyGreenstein, Medium, TabulatedPhase
from microgeometry.specimen import Specimen
from microgeometry.surfaces.exponential import Exponential
from microgeometry.surfaces.gaussian import Gaussian
from microgeometry.surfaces.self_affine import SelfAffine

ANALOG = "analog"
"""Every path is binned in the cell it leaves through: assumes nothing, does for all specimens."""
HALF_VECTOR = "half-vector"
"""Single bounces off a rough metal by `gonio.trace.half_vector`; what bounces more is binned in coarse cells."""
NEXT_EVENT = "next-event"
"""Light is joined to detectors wherever it meets a facet or medium that scatters: `gonio.trace.next_event`."""
FEW_FACETS = "few-facets"
"""As analog, but paths over facets that look in few directions start on a net: `gonio.trace.few_facets`."""
ESTIMATORS = ANALOG, HALF_VECTOR, NEXT_EVENT, FEW_FACETS

LEAST_ALPHA = 0.04
"""Of half vectors. Below, a highlight is narrow for cells of one degree: see `gonio.trace.peak_grid`."""

_MOST_PEAKED = 4.0
"""In the direction in which most light is scattered, against the mean: what joins it to detectors drawn evenly
varies as much. Merit over analog's of half-spaces: 5 where they scatter evenly, 3.7 and 2.2 by Henyey and Greenstein's
law with g = 0.3 and 0.5 (peaks of 2.7 and 6), 0.35 with g = 0.8 (45)."""

RANDOM_SURFACES = Gaussian, Exponential, SelfAffine


def choose(specimen: Specimen, seed: int, name: str | None = None) -> str:
    """The estimator asked for, or where none is, the best that applies.

    Raises
    ------
    InputError
        There is none of that name, or it does not do for the specimen.
    """
    if name is not None and name not in ESTIMATORS:
        raise InputError(f"estimator: {name!r}; one of {', '.join(ESTIMATORS)} is allowed")
    if name == ANALOG:
        return ANALOG
    if specimen.grid.anisotropic:
        if name is not None:
            raise InputError(
                f"estimator: {name} does not do for anisotropic tables; use {ANALOG}, or leave the choice"
            )
        return ANALOG
    against = {
        HALF_VECTOR: _against_half_vector,
        NEXT_EVENT: _against_next_event,
        FEW_FACETS: _against_few_facets,
    }
    for estimator in against if name is None else (name,):
        reason = against[estimator](specimen, seed)
        if reason is None:
            return estimator
        if name is not None:
            raise InputError(f"estimator: {name} does not do here: {reason}; use analog, or leave the choice")
    return ANALOG


def _against_half_vector(specimen: Specimen, seed: int) -> str | None:
    """Why single bounces cannot be measured by their half vectors; None where they can."""
    layer = specimen.layers[0]
    if len(specimen.layers) > 1 or not isinstance(layer.material, Mirror | Conductor):
        return "it knows one surface of mirror or conductor facets only"
    if not isinstance(layer.surface, RANDOM_SURFACES):
        kinds = ", ".join(kind.kind for kind in RANDOM_SURFACES)
        return f"it needs a random surface ({kinds}), with slopes of all sizes"
    alpha = roughness(Tracer(specimen, seed, 1))
    if not alpha >= LEAST_ALPHA:
        return f"the surface's alpha is {alpha:.3g}, and it needs {LEAST_ALPHA:g}"
    return None


def _against_next_event(specimen: Specimen, seed: int) -> str | None:
    """Why light cannot be joined to detectors where it scatters; None where it can."""
    tracer = Tracer(specimen, seed, 1)
    if tracer.optics is not None:
        return None if tracer.optics.albedo is not None else "mirror and metal facets do not scatter"
    realisation = tracer.realise(0)
    assert isinstance(realisation, Layers)
    facets, media = tracer.stack.facets, tracer.stack.media
    layers = realisation.clear_layers
    scatters = np.isin(facets.kind[facets.material[:layers]], (LAMBERT, TABLE)).any()
    if not scatters and not media.phase[: layers + 1, SCATTERS].any():
        return "nothing scatters that detectors see past mirrors and through flat interfaces only"
    for number, layer in enumerate(specimen.layers[:layers], 1):
        if layer.medium is not None and any(layer.medium.sigma_s):
            peak = 4.0 * math.pi * _phase_peak(layer.medium)
            if peak > _MOST_PEAKED:
                return f"the medium of layer {number} scatters {peak:.3g} times as much ahead as on average"
        for material in (layer.material, layer.plane):
            if isinstance(material, TableMaterial):
                peak = _table_peak(Table.load(material.file))
                if peak > _MOST_PEAKED:
                    return f"{material.file} has values up to {peak:.3g} times its albedo / pi: it shines"
    return None


def _against_few_facets(specimen: Specimen, seed: int) -> str | None:
    """Why paths need not start on a net; None where they had better."""
    tracer = Tracer(specimen, seed, 1)
    if tracer.optics is None or tracer.optics.albedo is not None:
        return "it knows one surface of mirror or conductor facets only"
    count = directions(tracer.tiles(0)[0])
    if not 0 < count <= MOST_DIRECTIONS:
        return f"facets look in {count} directions but up, and it needs 1 to {MOST_DIRECTIONS}"
    alpha = roughness(tracer)
    if not alpha >= LEAST_ALPHA:
        return f"the surface's alpha is {alpha:.3g}, and it needs {LEAST_ALPHA:g}"
    return None


def _phase_peak(medium: Medium) -> float:
    """Largest density of a medium's phase function, 1/sr."""
    phase = medium.phase
    if isinstance(phase, TabulatedPhase):
        return max(phase.values)
    if isinstance(phase, HenyeyGreenstein):
        return hg(phase.g, math.copysign(1.0, phase.g))
    return rayleigh(1.0)


def _table_peak(table: Table) -> float:
    """Largest value in units of albedo / pi, over rows and channels; the delta term is none."""
    albedo = np.maximum(table.row_albedo - table.specular, 1e-300)
    return float(np.max(math.pi * table.values.max(axis=(1, 2)) / albedo, initial=0.0))


def roughness(tracer: Tracer) -> float:
    """Beckmann alpha of the first realisation of the first layer."""
    return tracer.statistics(1)[0]["alpha"]
