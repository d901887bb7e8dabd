"""`gonio bench sample`: how many samples the table's own distribution saves against cosine sampling.

A gold table of alpha 0.2 is lit in turn by a white sky, one that darkens to the horizon, a window of 20 by
20 degrees in the mirror direction, and the window 30 degrees aside. What light of the sky the table sends
back is estimated by samples of the directions in proportion to f cos(theta), and by cosine sampling. At equal
error the numbers of samples are as the variances of a single one; time counts as well: variance x seconds.
The weight of a sample, f cos/pdf averaged over the channels, is 1 x albedo for every sample of a table; of one whose
highlight has cells of its own (`gonio.table.highlight`), but near the horizon.

Whoever knows the table but not the light can do no better than draw in proportion to f cos(theta), which leaves
the variance A int f cos L^2 - (int f cos L)^2; it is given as well, from the samples of cosine sampling. Against
these a window that stands where f is f_w saves pi f_w / A at most, 6 at normal incidence of alpha 0.2.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import direction
from gonio.table.table import Table
from gonio.trace.measure import measure
from microgeometry.specimen import parse_specimen

Array = NDArray[np.float64]
Light = Callable[[Array, float], Array]

_PATHS = 20_000_000
_ALPHA = 0.2
_ANGLES_DEG = (5.0, 30.0, 60.0, 75.0)
_SAMPLES = 400_000


def _white(wo: Array, theta_i: float) -> Array:
    return np.ones(len(wo))


def _sky(wo: Array, theta_i: float) -> Array:
    return 0.2 + 0.8 * wo[:, 2]


def _window_at(offset_deg: float) -> Light:
    def window(wo: Array, theta_i: float) -> Array:
        offset = np.radians(offset_deg)
        centre = direction(theta_i - offset if theta_i > offset else theta_i + offset, np.pi)
        across = np.cross([0.0, 1.0, 0.0], centre)
        ahead = wo @ centre > 0
        inside = np.maximum(np.abs(wo[:, 1]), np.abs(wo @ across)) < np.sin(np.radians(10.0))
        return (ahead & inside).astype(float)

    return window


LIGHTS: dict[str, Light] = {
    "white": _white,
    "sky": _sky,
    "window": _window_at(0.0),
    "window aside": _window_at(30.0),
}


def run(say: Callable[[str], None]) -> dict[str, Any]:
    """Measure; returns by light the ratio of variances, and the speeds."""
    table = _gold()
    rng = np.random.default_rng(0)
    ratios: dict[str, list[float]] = {name: [] for name in LIGHTS}
    limits: dict[str, list[float]] = {name: [] for name in LIGHTS}
    weights, seconds = [], np.zeros(2)
    for angle in _ANGLES_DEG:
        theta_i = float(np.radians(angle))
        wi = np.broadcast_to(direction(theta_i), (_SAMPLES, 3))
        u = rng.random((_SAMPLES, 3))
        table.sample(wi[:1], u[:1])  # compiles
        begun = time.perf_counter()
        wo, pdf = table.sample(wi, u)
        own = table.eval(wi, wo).mean(axis=-1) * wo[:, 2] / np.maximum(pdf, 1e-300)
        middle = time.perf_counter()
        even = _cosine(rng.random((_SAMPLES, 2)))
        lambert = table.eval(wi, even).mean(axis=-1) * np.pi
        seconds += (middle - begun, time.perf_counter() - middle)
        kept = pdf > 0
        weights.append(float(own[kept].max() / own[kept].mean()))
        for name, light in LIGHTS.items():
            seen = light(even, theta_i)
            before, after = lambert * seen, np.where(kept, own, 0.0) * light(wo, theta_i)
            least = lambert.mean() * (lambert * seen**2).mean() - before.mean() ** 2
            limits[name].append(float(before.var() / max(least, 1e-6 * before.var())))
            # a constant light has no variance at all; 1e6 stands for that
            ratios[name].append(float(before.var() / max(after.var(), 1e-6 * before.var())))
    say(f"{'light':14}" + "".join(f"{f'theta_i {a:g}':>14}" for a in _ANGLES_DEG) + f"{'median':>10}")
    for name, found in ratios.items():
        say(f"{name:14}" + "".join(f"{r:14.3g}" for r in found) + f"{np.median(found):10.3g}")
        say(f"{'  at best':14}" + "".join(f"{r:14.3g}" for r in limits[name]))
    cost = float(seconds[0] / seconds[1])
    say(
        f"samples of cosine sampling per sample of the table's own at equal error; one of these takes {cost:.2f} "
        f"times as long; largest weight {max(weights):.6f} of the mean"
    )
    return {
        "variance_ratio": ratios,
        "variance_ratio_at_best": limits,
        "theta_i_deg": _ANGLES_DEG,
        "cost": cost,
        "largest_weight": max(weights),
    }


def _gold() -> Table:
    gold = {
        "surface": {"kind": "gaussian", "alpha": _ALPHA},
        "material": {"kind": "conductor", "name": "Au"},
        "grid": {"channels": "rgb"},
    }
    return measure(parse_specimen(gold), rays=_PATHS)


def _cosine(u: Array) -> Array:
    """Directions of density cos(theta)/pi."""
    return direction(np.arcsin(np.sqrt(u[:, 0])), 2 * np.pi * u[:, 1])
