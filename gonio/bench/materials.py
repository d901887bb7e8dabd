"""`gonio bench materials`: what a path costs by what the facets are made of, all on one rough surface.

Three questions. What each material costs against a mirror. What polarised light costs: specimens that need
it, traced with and without, and one that does not need it, on which it must cost nothing. And how
wavelengths that refract apart are best traced: on one path until the first refraction (what the instrument
does), or on paths of their own; compared by figure of merit, 1 / (relative variance x seconds).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from gonio.table.checks import relative_noise
from gonio.trace.estimators import ANALOG
from gonio.trace.measurement import Measurement
from microgeometry.specimen import parse_specimen

_PATHS = 1 << 17
_REPEATS = 3  # the fastest counts: whatever else the machine does only slows
_ROUGH = {"kind": "gaussian", "alpha": 0.5, "samples": 256}
_FLAT = {"kind": "flat"}
_GLASS = {"kind": "dielectric", "eta": 1.5}
_WHITE = {"kind": "lambert", "albedo": 0.8}
_GOLD = {"kind": "conductor", "name": "Au"}
_SILICA = {"name": "SiO2", "thickness_nm": 300}
_DEEP = {"kind": "none"}
_MILK = {"sigma_s": 1.0, "sigma_a": 0.1, "thickness": float("inf")}
_COARSE = {"theta_i_deg": [30], "theta_step_deg": 5, "phi_step_deg": 10}

_MATERIALS: dict[str, dict[str, Any]] = {
    "mirror": {"surface": _ROUGH, "material": {"kind": "mirror"}},
    "lambert": {"surface": _ROUGH, "material": _WHITE},
    "conductor": {"surface": _ROUGH, "material": {"kind": "conductor", "eta": 0.2, "k": 3.4}},
    "gold, CIE RGB": {"surface": _ROUGH, "material": _GOLD, "grid": {"channels": "rgb"}},
    "glass": {"surface": _ROUGH, "material": _GLASS},
    "gold under a film, CIE RGB": {
        "surface": _ROUGH,
        "material": {"kind": "coated", "films": [_SILICA], "over": _GOLD},
        "grid": {"channels": "rgb"},
    },
    "glass over white": {"layer": [
        {"surface": _ROUGH, "material": _GLASS, "medium": {"thickness": 100}},
        {"surface": _FLAT, "material": _WHITE},
    ]},
    "half-space of milk": {"layer": [{"surface": _FLAT, "material": _DEEP, "medium": _MILK}]},
}  # fmt: skip

_DISPERSIVE = {"layer": [
    {"surface": {**_ROUGH, "alpha": 0.2}, "material": {"kind": "dielectric", "name": "diamond"},
     "medium": {"thickness": 100}},
    {"surface": _FLAT, "material": _WHITE},
]}  # fmt: skip
_WAVELENGTHS_NM = (450.0, 550.0, 650.0)


def run(say: Callable[[str], None]) -> dict[str, Any]:
    """Measure; returns paths/s and their ratios."""
    say(f"{'material of the facets':30} {'M paths/s':>10} {'of a mirror':>12}")
    costs = {}
    for name, specimen in _MATERIALS.items():
        costs[name] = _rate(_measurement(specimen))
        say(f"{name:30} {costs[name] / 1e6:10.2f} {costs[name] / costs['mirror']:12.2f}")
    say(f"\n{'polarised light':30} {'with':>10} {'without':>10} {'ratio':>6}")
    polarisation = {}
    for name in ("glass", "glass over white", "half-space of milk"):
        rates = [_rate(_measurement(_MATERIALS[name], polarised)) for polarised in (True, False)]
        chosen = _measurement(_MATERIALS[name]).tracer.stack.polarised
        polarisation[name] = {"with": rates[0], "without": rates[1], "chosen": chosen}
        say(
            f"{name:30} {rates[0] / 1e6:10.2f} {rates[1] / 1e6:10.2f} {rates[0] / rates[1]:6.2f}"
            f"  ({'with' if chosen else 'without'}: chosen)"
        )
    merit = _dispersion()
    say(
        f"\nthree wavelengths through diamond: one path until it refracts has {merit['cells']:.2f} times the merit of "
        f"paths of their own in the cells, {merit['albedo']:.2f} times in the albedo"
    )
    return {"paths_per_second": costs, "polarisation": polarisation, "one_path_merit": merit}


def _measurement(specimen: dict[str, Any], polarised: bool | None = None) -> Measurement:
    specimen = {**specimen, "grid": {**_COARSE, **specimen.get("grid", {})}}
    measurement = Measurement(parse_specimen(specimen), rays=32 * _PATHS, estimator=ANALOG)
    if polarised is not None:
        measurement.tracer.stack = measurement.tracer.stack._replace(polarised=polarised)
    return measurement


def _rate(measurement: Measurement) -> float:
    """Paths/s in the kernel, the best of some batches."""
    measurement.add_batch()  # compiles
    best = 0.0
    for _ in range(_REPEATS):
        before = measurement.trace_seconds
        measurement.add_batch()
        best = max(best, measurement.paths_per_batch / (measurement.trace_seconds - before))
    return best


def _dispersion() -> dict[str, float]:
    """Merit of the wavelengths on one path over that of as many paths shared out between them."""
    together = _merits(_WAVELENGTHS_NM)
    apart = np.array([_merits((wavelength,)) for wavelength in _WAVELENGTHS_NM])
    # to know all three as well as `apart` does takes the sum of the times
    shared = 1.0 / np.sum(1.0 / apart, axis=0)
    return {"cells": float(together[0] / shared[0]), "albedo": float(together[1] / shared[1])}


def _merits(wavelengths_nm: tuple[float, ...]) -> tuple[float, float]:
    """1 / (relative variance x seconds in the kernel): of the median cell, and of the albedo."""
    measurement = _measurement({**_DISPERSIVE, "grid": {"wavelengths_nm": list(wavelengths_nm)}})
    measurement.add_batch()  # compiles
    measurement = _measurement({**_DISPERSIVE, "grid": {"wavelengths_nm": list(wavelengths_nm)}})
    for _ in range(64):
        measurement.add_batch()
    table = measurement.table()
    cells = float(np.median(relative_noise(table))) ** 2
    albedo = float(np.mean((table.albedo_std_error / table.row_albedo) ** 2))
    return 1.0 / (cells * measurement.trace_seconds), 1.0 / (albedo * measurement.trace_seconds)
