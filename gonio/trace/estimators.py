"""Which estimator traces a specimen."""

from __future__ import annotations

from gonio.trace.tracer import Tracer
from microgeometry.errors import InputError
from microgeometry.materials import Conductor, Mirror
from microgeometry.specimen import Specimen
from microgeometry.surfaces.exponential import Exponential
from microgeometry.surfaces.gaussian import Gaussian
from microgeometry.surfaces.self_affine import SelfAffine

ANALOG = "analog"
"""Every path is binned in the cell it leaves through: assumes nothing, does for all specimens."""
HALF_VECTOR = "half-vector"
"""Single bounces off a rough metal by `gonio.trace.half_vector`; what bounces more is binned in coarse cells."""
ESTIMATORS = ANALOG, HALF_VECTOR

LEAST_ALPHA = 0.03
"""Below, the distribution of tilts is too steep for the bins of tilt and the points of a 1-degree cell."""

_SURFACES = Gaussian, Exponential, SelfAffine


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
    reason = _against_half_vector(specimen, seed)
    if reason is None:
        return HALF_VECTOR
    if name == HALF_VECTOR:
        raise InputError(
            f"estimator: half-vector does not do here: {reason}; use analog, or leave the choice"
        )
    return ANALOG


def _against_half_vector(specimen: Specimen, seed: int) -> str | None:
    """Why single bounces cannot be measured by their half vectors; None where they can."""
    layer = specimen.layers[0]
    if len(specimen.layers) > 1 or not isinstance(layer.material, Mirror | Conductor):
        return "it knows one surface of mirror or conductor facets only"
    if not isinstance(layer.surface, _SURFACES):
        return f"it needs a random surface ({', '.join(kind.kind for kind in _SURFACES)}), with slopes of all sizes"
    alpha = roughness(Tracer(specimen, seed, 1))
    if not alpha >= LEAST_ALPHA:
        return f"the surface's alpha is {alpha:.3g}, and it needs {LEAST_ALPHA:g}"
    return None


def roughness(tracer: Tracer) -> float:
    """Beckmann alpha of the first realisation of the first layer."""
    return tracer.statistics(1)[0]["alpha"]
