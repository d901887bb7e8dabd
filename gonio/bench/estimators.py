"""Part of `gonio bench trace`: how good a table is after a given time, by each estimator that applies.

The merit is 1 / (relative variance x seconds), the variance the median over the cells that hold 99 % of the light;
all else that is done once or per batch (surfaces, Embree, the table) is counted. The first batches, which
compile, are not. A measured height map is traced where GONIO_TEST_DATA names a folder that holds one.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gonio.table.checks import relative_noise
from gonio.table.table import Table
from gonio.trace.estimators import ANALOG, ESTIMATORS, choose
from gonio.trace.measurement import Measurement
from microgeometry.specimen import Specimen, parse_specimen

_SECONDS = 4.0
_RAYS = 20_000_000  # sets the size of a batch
_PIGMENT = (
    "glass over pigment, 45"  # degrees: its paths are slow, so in one row only, or cells would be empty
)
_FEWER_RAYS = {_PIGMENT: 1_000_000}  # else a batch takes seconds, and errors rest on two or three
_MIN_BATCHES = 8
_GOLD = {"kind": "conductor", "name": "Au"}
_GRID = {"wavelengths_nm": [550]}
_MAP = Path("topography", "matrix-2.txt")


def run(say: Callable[[str], None]) -> list[dict[str, Any]]:
    """Trace every specimen for some seconds with every estimator; returns merits and errors."""
    say("")
    say(
        f"{'1-degree tables':<24} {'estimator':<12} {'s':>5} {'median error':>13} {'merit':>9} {'of analog':>10}"
    )
    results = []
    for name, specimen in _specimens(say).items():
        merits: dict[str, float] = {}
        for estimator in ESTIMATORS:
            if estimator not in (ANALOG, choose(specimen, 0)):
                continue
            seconds, error = _measure(specimen, estimator, _FEWER_RAYS.get(name, _RAYS))
            merits[estimator] = 1.0 / (error**2 * seconds)
            ratio = merits[estimator] / merits[ANALOG]
            say(
                f"{name:<24} {estimator:<12} {seconds:5.1f} {error:13.4f} {merits[estimator]:9.3g} {ratio:10.1f}"
            )
            results.append(
                {
                    "specimen": name,
                    "estimator": estimator,
                    "seconds": seconds,
                    "median_error": error,
                    "merit": merits[estimator],
                    "ratio": ratio,
                }
            )
    return results


def _measure(specimen: Specimen, estimator: str, rays: int) -> tuple[float, float]:
    """Seconds taken, and median relative error of the cells that hold the light."""
    _trace(specimen, estimator, rays, 0.0, 2)  # compiles
    started = time.perf_counter()
    table = _trace(specimen, estimator, rays, _SECONDS, _MIN_BATCHES)
    return time.perf_counter() - started, float(np.median(relative_noise(table)))


def _trace(specimen: Specimen, estimator: str, rays: int, seconds: float, batches: int) -> Table:
    measurement = Measurement(specimen, rays=rays, estimator=estimator)
    while measurement.seconds < seconds or measurement.tally.batches < batches:
        measurement.add_batch()
    return measurement.table()


def _specimens(say: Callable[[str], None]) -> dict[str, Specimen]:
    found = {
        f"gold, alpha {alpha:g}": {"surface": {"kind": "gaussian", "alpha": alpha}, "material": _GOLD}
        for alpha in (0.1, 0.5, 1.0)
    }
    lambert = {"kind": "lambert", "albedo": 0.7}
    found["Lambert V-grooves"] = {"surface": {"kind": "v_groove", "slope_deg": 30}, "material": lambert}
    glass = {"surface": {"kind": "flat"}, "material": {"kind": "dielectric", "eta": 1.5}}
    medium = {"thickness": 100.0, "units": "um"}
    found[_PIGMENT] = {
        "layer": [
            {**glass, "medium": medium},
            {"surface": {"kind": "spheres", "cover": 0.6}, "material": lambert},
        ]
    }
    grids = {_PIGMENT: {**_GRID, "theta_i_deg": [45]}}
    specimens = {
        name: parse_specimen({**spec, "grid": grids.get(name, _GRID)}) for name, spec in found.items()
    }
    folder = os.environ.get("GONIO_TEST_DATA")
    if folder and (Path(folder) / _MAP).exists():
        surface = {"kind": "heightmap", "file": str(_MAP), "holes": "fill"}
        specimens["measured height map"] = parse_specimen(
            {"surface": surface, "material": _GOLD, "grid": _GRID}, Path(folder)
        )
    else:
        say("measured height map: left out, GONIO_TEST_DATA names no folder with one")
    return specimens
