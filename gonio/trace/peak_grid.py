"""Whether a specimen's highlight needs a grid of its own, and which; see `gonio.table.peak`."""

from __future__ import annotations

from gonio.table.peak import PeakGrid, grid_of
from gonio.trace.estimators import LEAST_ALPHA, RANDOM_SURFACES
from gonio.trace.tracer import Tracer
from microgeometry.materials import Coated, Conductor, Dielectric, Mirror
from microgeometry.specimen import Specimen

_SMALLEST_ALPHA = 1e-6  # directions are traced in single precision

WIDEST_ALPHA = 0.45
"""Of a highlight alone on a random surface; see `peak_grid`."""
_MIRRORS = Mirror, Conductor, Dielectric, Coated


def peak_grid(specimen: Specimen, tracer: Tracer) -> PeakGrid | None:
    """The grid that a specimen's highlight needs, by the measured slopes of its facets; None where it needs none.

    A facet of a slope reflects into the half vector of that slope: a layer that is rough, and whose facets
    reflect like mirrors, has a highlight of its alpha. Alone on a random surface it gets a grid below `WIDEST_ALPHA`:
    at theta_i = 85 degrees, where highlights are narrow in delta phi, f between cells of one degree errs by
    7 % at alpha 0.2, 1.5 % at 0.4 and 1.1 % at 0.5, on this grid by 1.1 % at most (`gonio bench peak`). Of other
    surfaces the distribution of slopes may have features of its own, finer than these rings, and of layers the light
    from below is everywhere: these get it below `LEAST_ALPHA`.
    """
    if not any(isinstance(layer.material, _MIRRORS) for layer in specimen.layers):
        return None
    alone = len(specimen.layers) == 1 and isinstance(specimen.layers[0].surface, RANDOM_SURFACES)
    limit = WIDEST_ALPHA if alone else LEAST_ALPHA
    measured = zip(specimen.layers, tracer.statistics(1), strict=True)
    alphas = [
        found["alpha"]
        for layer, found in measured
        if isinstance(layer.material, _MIRRORS) and _SMALLEST_ALPHA < found["alpha"] < limit
    ]
    return grid_of(alphas, specimen.grid.theta_step_deg) if alphas else None
