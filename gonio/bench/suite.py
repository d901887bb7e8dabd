"""`gonio bench suite`: for every example specimen, the estimator that is picked, and its merit over analog's.

The merit is 1 / (relative variance x seconds), the variance the median over the cells that hold 99 % of the light, the
seconds those of all processors together, so that other programs do not count. The two estimators take
turns, batch by batch, after a first one each that compiles. Tables of 1 degree have few rows, or
their cells would hold too few paths for the analog estimator to know its own error.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from gonio.resources import data_folder
from gonio.table.checks import relative_noise
from gonio.trace.estimators import ANALOG, NEXT_EVENT, choose
from gonio.trace.measurement import Measurement
from microgeometry.specimen import Specimen, load_specimen

_GRIDS: dict[str, dict[str, Any]] = {
    "10 x 20 degrees, all rows": {"theta_step_deg": 10, "phi_step_deg": 20, "theta_i_deg": None},
    "1 degree, rows 10 40 70": {"theta_step_deg": 1, "phi_step_deg": 1, "theta_i_deg": (10.0, 40.0, 70.0)},
}
_SECONDS = 4.0  # for each estimator and grid
_MIN_BATCHES = 8
_RAYS = 4_000_000  # sets the size of a batch
_FEWER_RAYS = 400_000  # of next-event estimates, whose paths take longer


def run(say: Callable[[str], None]) -> list[dict[str, Any]]:
    """Trace every example for some seconds; returns merits."""
    say(
        f"{'specimen':<24} {'estimator':<12} {'grid':<26} {'median error':>13} {'merit':>9} {'of analog':>10}"
    )
    results: list[dict[str, Any]] = []
    for file in sorted((data_folder() / "specimens").glob("*.toml")):
        specimen = load_specimen(file)
        picked = choose(specimen, 0)
        if picked == ANALOG:
            say(f"{file.stem:<24} {picked:<12}")
            continue
        for name, keys in _GRIDS.items():
            error, merit, ratio = _compare(replace(specimen, grid=replace(specimen.grid, **keys)), picked)
            say(f"{file.stem:<24} {picked:<12} {name:<26} {error:13.4f} {merit:9.3g} {ratio:10.1f}")
            results.append(
                {
                    "specimen": file.stem,
                    "estimator": picked,
                    "grid": name,
                    "median_error": error,
                    "merit": merit,
                    "ratio": ratio,
                }
            )
    say(f"smallest ratio {min(r['ratio'] for r in results):.2f}")
    return results


def _compare(specimen: Specimen, picked: str) -> tuple[float, float, float]:
    """Median relative error and merit by the estimator picked, and that over analog's."""
    runs = []
    for estimator in (picked, ANALOG):
        rays = _FEWER_RAYS if estimator == NEXT_EVENT else _RAYS
        for _ in range(2):  # the first compiles
            measurement = Measurement(specimen, rays=rays, estimator=estimator)
            measurement.add_batch()
        runs.append(measurement)
    spent = [0.0, 0.0]
    while min(spent) < _SECONDS or min(m.tally.batches for m in runs) < _MIN_BATCHES:
        which = int(np.argmin(spent))
        started = time.process_time()
        runs[which].add_batch()
        spent[which] += time.process_time() - started
    errors = []
    for which, measurement in enumerate(runs):
        started = time.process_time()
        table = measurement.table()
        spent[which] *= measurement.tally.batches / (measurement.tally.batches - 1)  # the batch not timed
        spent[which] += time.process_time() - started
        errors.append(float(np.median(relative_noise(table))))
    merits = [1.0 / (error**2 * seconds) for error, seconds in zip(errors, spent, strict=True)]
    return errors[0], merits[0], merits[0] / merits[1]
