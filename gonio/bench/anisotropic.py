"""`gonio bench anisotropic`: what a table of brushed metal costs, and how far it is from what it stands for.

The closed form of a brushed mirror (Beckmann slopes of widths 0.28 and 0.01, Smith's masking) is tabulated on the
default rows and cells, and the table evaluated at incidences between its rows. Errors are compression's: relative,
cosine-weighted RMS over the outgoing hemisphere. Speed is compared with an isotropic table of one degree.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from gonio.core.directions import direction
from gonio.table.anisotropic import tabulate_brdf
from gonio.table.table import Table
from gonio.table.tilts import tilt_edges, tilt_measures
from microgeometry.grid import ANISOTROPIC_THETA_I_DEG, Grid

Array = NDArray[np.float64]

_ALPHA = 0.28, 0.01
_ANGLES_DEG = (5, 15, 25, 35, 45, 55, 65, 70, 75, 80, 83, 85)
_INCIDENCES = 6  # azimuths an angle
_SAMPLES = 400_000
_REPEATS = 3


def beckmann(wi: Array, wo: Array, alpha_x: float, alpha_y: float, correlated: bool = True) -> Array:
    """Single bounces off a brushed mirror: f = D G2 / (4 cos_i cos_o), directions (N, 3), result (N, 1), 1/sr.

    Beckmann's D, Smith's height-correlated G2 (Heitz 2014, equations 72, 85, 99); not correlated: G2 = G1 G1, as
    Mitsuba has it.
    """
    slopes = (wi + wo)[:, :2] / (wi + wo)[:, 2:]
    p22 = np.exp(-((slopes[:, 0] / alpha_x) ** 2) - (slopes[:, 1] / alpha_y) ** 2)
    d = p22 / (np.pi * alpha_x * alpha_y) * (1 + (slopes**2).sum(axis=1)) ** 2
    a, b = (_smith(w, alpha_x, alpha_y) for w in (wi, wo))
    g2 = 1 / (1 + a + b if correlated else (1 + a) * (1 + b))
    return (d * g2 / (4 * wi[:, 2] * wo[:, 2]))[:, None]


def _smith(w: Array, alpha_x: float, alpha_y: float) -> Array:
    a = w[:, 2] / np.maximum(np.hypot(alpha_x * w[:, 0], alpha_y * w[:, 1]), 1e-9)
    return 0.5 * (special.erf(a) - 1) + np.exp(-a * a) / (2 * a * np.sqrt(np.pi))


def run(say: Callable[[str], None]) -> dict[str, Any]:
    """Measure; returns megabytes, the error at each theta_i, and the times of a sample and of a value."""
    grid = Grid(None, ("R", "G", "B"), ANISOTROPIC_THETA_I_DEG, anisotropic=True)

    def brdf(wi: Array, wo: Array) -> Array:
        return beckmann(wi, wo, *_ALPHA) * np.array([1.0, 0.8, 0.6])

    edges = [tilt_edges(width, grid.tilt_cells) for width in _ALPHA]
    theta = np.radians(ANISOTROPIC_THETA_I_DEG)
    table = tabulate_brdf(brdf, theta, round(360 / grid.phi_i_step_deg), edges[0], edges[1], grid.channels)
    cells, pool = table.energy.nbytes / 1e6, table.pool.nbytes / 1e6
    say(
        f"{table.energy[..., 0].size} cells x 3 channels: {cells:.1f} MB, laid out for rendering {pool:.1f} MB"
    )
    rng = np.random.default_rng(0)
    fine = [tilt_edges(width, 200) for width in _ALPHA]
    errors = []
    for angle in _ANGLES_DEG:
        sums = np.zeros(2)
        for _ in range(_INCIDENCES):
            wi = direction(np.radians(angle + rng.uniform(-2, 2)), rng.uniform(0, 2 * np.pi))
            wo, areas = tilt_measures(wi, fine[0], fine[1])
            wo = wo.reshape(-1, 3)
            exact = brdf(np.broadcast_to(wi, wo.shape), wo)
            sums += [
                np.sum(areas.ravel() @ (table.eval(wi, wo) - exact) ** 2),
                np.sum(areas.ravel() @ exact**2),
            ]
        errors.append(float(np.sqrt(sums[0] / sums[1])))
    say("theta_i  " + "".join(f"{angle:8g}" for angle in _ANGLES_DEG))
    say("error    " + "".join(f"{error:8.2%}" for error in errors))
    own, plain = _times(table, rng), _times(_isotropic(), rng)
    say(
        f"a sample takes {own[0] / plain[0]:.2f} times as long as an isotropic table's, a value {own[1] / plain[1]:.2f}"
    )
    return {
        "megabytes": cells,
        "megabytes_rendered": pool,
        "theta_i_deg": _ANGLES_DEG,
        "error": errors,
        "sample_time": own[0] / plain[0],
        "eval_time": own[1] / plain[1],
    }


def _times(table: Any, rng: np.random.Generator) -> tuple[float, float]:
    wi = np.broadcast_to(direction(0.7, 0.4), (_SAMPLES, 3))
    u = rng.random((_SAMPLES, 3))
    table.eval(wi[:1], table.sample(wi[:1], u[:1])[0])  # compiles
    best = np.full(2, np.inf)
    for _ in range(_REPEATS):
        begun = time.perf_counter()
        wo, _ = table.sample(wi, u)
        middle = time.perf_counter()
        table.eval(wi, wo)
        best = np.minimum(best, (middle - begun, time.perf_counter() - middle))
    return float(best[0]), float(best[1])


def _isotropic() -> Table:
    """Of one degree, as narrow as its cells allow."""
    edges, sectors = np.radians(np.arange(91.0)), np.radians(np.arange(181.0))
    middle, phi = 0.5 * (edges[1:] + edges[:-1]), 0.5 * (sectors[1:] + sectors[:-1])
    wi = direction(middle)[:, None, None, :]
    wo = direction(middle[:, None], phi)[None]
    half = wi + wo
    slopes = (half[..., 0] ** 2 + half[..., 1] ** 2) / half[..., 2] ** 2
    values = np.repeat(np.exp(-slopes / 0.1**2)[..., None], 3, axis=3)
    return Table(values, middle, edges, sectors, ("R", "G", "B"), np.ones((90, 3)), theta_i_edges=edges)
