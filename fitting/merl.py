"""All models fitted to the measured materials of the MERL database, beside published fits of them.

The measurements are decoded from networks trained on them (Sztrajman et al., Neural BRDF representation and
importance sampling, 2021), which weigh 675 numbers a material.

Pairs of directions are cells of MERL's own grid (`pairs`). Medians over materials depend on where the pairs
lie: a grid even in the angles meets the highlight of a glossy material in its mirror directions only, and
random pairs hardly ever, and what a fit leaves over then says how the highlight was missed, not how it was
fitted. MERL's half angles are spaced by their square roots, finest at the normal, to resolve it.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from multiprocessing.queues import SimpleQueue
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting.account import account
from fitting.compare import fit_models, isotropic_models
from fitting.models import find_model
from fitting.objectives import find_objective
from fitting.problem import Problem
from fitting.samples import THETA_LIMIT_DEG, Samples
from gonio.core.directions import direction
from gonio.core.parallel import processors
from microgeometry.errors import InputError

Array = NDArray[np.float64]
Metrics = dict[str, float]

NETWORKS = "nbrdf_weights.npz"
_PREFIX = "merl/"
_CHANNELS = ("R", "G", "B")
_STEPS = 1, 5, 6
"""Every so many of MERL's 90 half angles, 90 difference angles and 180 azimuths."""
_FACTORS = np.array([1.0, 1.15, 1.66])
"""Of MERL's channels, which Ngan's parameters leave out."""


def _low(a: dict) -> tuple[str, dict, dict]:
    shape = {"alpha": a["roughness"], "eta": a["eta"]}
    return "beckmann_v_cavity_dielectric", shape, {"specular_reflectance": a["albedo"] * 4 / np.pi}


# The specular lobe of each file in our terms: lobe, parameters, and coefficients by channel. Where the paper
# divides D G F by pi, ours divides by 4.
PUBLISHED: dict[str, Callable[[dict], tuple[str, dict, dict]]] = {
    "ngan_ward": lambda a: ("ward", {"alpha": a["roughness"]}, {"rho_s": a["albedo"]}),
    "ngan_wardduer": lambda a: ("ward_duer", {"alpha": a["roughness"]}, {"rho_s": a["albedo"]}),
    "ngan_cooktorrance": lambda a: (
        "beckmann_v_cavity",
        {"alpha": a["roughness"]},
        {"f0": a["albedo"] * a["eta"] * 4 / np.pi, "f90": a["albedo"] * 4 / np.pi},
    ),
    "ngan_ashikhminshirley": lambda a: (
        "ashikhmin_shirley",
        {"exponent": a["sharpness"]},
        {"f0": a["albedo"] * a["fresnelReflectance"], "f90": a["albedo"]},
    ),
    "low_cooktorrance_E1": _low,
    "low_cooktorrance_E2": _low,
}
"""Files of published fits (Ngan et al. 2005, Low et al. 2012), by name."""

OURS = {
    "ngan_ward": "ward",
    "ngan_wardduer": "ward_duer",
    "ngan_cooktorrance": "cook_torrance_1982",
    "ngan_ashikhminshirley": "ashikhmin_shirley",
    "low_cooktorrance_E1": "cook_torrance_1982",
    "low_cooktorrance_E2": "cook_torrance_1982",
}
"""The model to compare with each."""


def materials(networks: Path) -> list[str]:
    """Names of the materials in a file of networks, or in the folder that holds it.

    Raises
    ------
    InputError
        No such file, or none of its networks is of a MERL material.
    """
    with _open(networks) as file:
        names = sorted({key.split("|")[0].removeprefix(_PREFIX) for key in file if key.startswith(_PREFIX)})
    if not names:
        raise InputError(f"{networks}: no array is called {_PREFIX}<material>|<0 to 5>, a network of MERL's")
    return names


def pairs() -> tuple[Array, Array, Array]:
    """theta_i, theta_r and delta phi, radians, of 31 214 pairs: centres of MERL's cells, at most 80 degrees each.

    All half angles, 90 (k/90)^2 degrees, every fifth difference angle and every sixth azimuth about the half
    vector; half of the azimuths do, as MERL stores them: the rest is the same by reciprocity.
    """
    half, difference, azimuth = (
        np.arange(0, n, step) + 0.5 for n, step in zip((90, 90, 180), _STEPS, strict=True)
    )
    th, td, pd = (
        a.ravel()
        for a in np.meshgrid(
            0.5 * np.pi * (half / 90.0) ** 2, np.radians(difference), np.radians(azimuth), indexing="ij"
        )
    )
    # half vector at azimuth 0; wi and wo lie on either side of it
    x, y, z = np.sin(td) * np.cos(pd), np.sin(td) * np.sin(pd), np.cos(td)
    ends = [
        (np.cos(th) * s * x + np.sin(th) * z, s * y, np.cos(th) * z - np.sin(th) * s * x) for s in (1, -1)
    ]
    theta_i, theta_r = (np.arccos(np.clip(c, -1.0, 1.0)) for _, _, c in ends)
    phi_i, phi_r = (np.arctan2(b, a) for a, b, _ in ends)
    inside = (theta_i <= np.radians(THETA_LIMIT_DEG)) & (theta_r <= np.radians(THETA_LIMIT_DEG))
    delta_phi = np.abs((phi_r - phi_i + np.pi) % (2.0 * np.pi) - np.pi)
    return theta_i[inside], theta_r[inside], delta_phi[inside]


def decode(weights: Mapping[str, Array], name: str, wi: Array, wo: Array) -> Array:
    """A MERL material's network at any directions, shape (N, 3): f_r in 1/sr, shape (N, 3)."""
    w = [weights[f"{_PREFIX}{name}|{n}"] for n in range(6)]
    half = wi + wo
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    cos_h, phi_h = np.clip(half[:, 2], -1.0, 1.0), np.arctan2(half[:, 1], half[:, 0])
    sin_h = np.sqrt(1.0 - cos_h**2)
    # wi in the frame of the half vector
    x = np.cos(phi_h) * wi[:, 0] + np.sin(phi_h) * wi[:, 1]
    y = np.cos(phi_h) * wi[:, 1] - np.sin(phi_h) * wi[:, 0]
    turned = cos_h * x - sin_h * wi[:, 2], y, sin_h * x + cos_h * wi[:, 2]
    a = np.stack([sin_h, np.zeros(len(wi)), cos_h, *turned], axis=-1)
    a = np.maximum(a @ w[0] + w[1], 0.0)
    a = np.maximum(a @ w[2] + w[3], 0.0)
    return np.maximum(np.exp(a @ w[4] + w[5]) - 1.0, 0.0)


def measurements(networks: Path, name: str) -> Samples:
    """A material at `pairs`."""
    theta_i, theta_r, delta_phi = pairs()
    with _open(networks) as file:
        values = decode(file, name, direction(theta_i), direction(theta_r, delta_phi))
    return Samples.of_directions(theta_i, theta_r, delta_phi, values, _CHANNELS)


def published(folder: Path, name: str, samples: Samples) -> dict[str, Metrics]:
    """Metrics of the published fits of a material, by file, through the code that judges ours.

    Left out are files that are not in the folder, and fits out of our parameters' ranges: an index below 1,
    a roughness of a mirror.
    """
    out = {}
    for file, lobe_of in PUBLISHED.items():
        path = folder / f"{file}.fit"
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        line = re.search(rf"^{re.escape(name)} = (.*)$", text, re.MULTILINE)
        if line is None:
            continue
        diffuse, glossy = re.findall(r"\((\s*albedo[^()]*)\)", line[1])
        factors = _FACTORS if file.startswith("ngan") else np.ones(3)
        numbers = {
            k: np.array(json.loads(v)) for k, v in re.findall(r"(\w+) = (\[[^]]*\]|[-+.\de]+)", glossy)
        }
        lobe, shape, coefficients = lobe_of(numbers)
        albedo = np.array(json.loads(re.findall(r"\[[^]]*\]", diffuse)[0]))
        model = find_model(f"{lobe}+lambert")
        problem = Problem(
            model.lobes, samples, find_objective(samples, "ngan_l2"), np.zeros(len(samples.cells), np.int8)
        )
        if not all(q.lower <= shape[q.name] <= q.upper for _, q in problem.parameters):
            continue
        x = np.array([q.to_unit(float(shape[q.name])) for _, q in problem.parameters])
        rows = [coefficients[c] * factors for i, c in problem.coefficients.names if i == 0]
        point = problem.evaluate(x, np.stack([*rows, albedo * factors]), solve=False)
        out[file] = account(problem, point).metrics
    return out


def fits_of(networks: Path, folder: Path | None, name: str) -> dict[str, Metrics]:
    """Every isotropic model with one and two lobes fitted to one material, and published fits: metrics by name."""
    samples = measurements(networks, name)
    ours = {
        fitted.model: {**fitted.residuals, "criterion": fitted.criterion or 0.0, "seconds": fitted.seconds}
        for fitted in fit_models(samples, isotropic_models(), (1, 2))
    }
    return ours if folder is None else {**ours, **published(folder, name, samples)}


def fit_all(
    networks: Path, folder: Path | None, each: Callable[[str, int], None] = lambda name, left: None
) -> dict[str, dict[str, Metrics]]:
    """`fits_of` every material, on all processors, a process each.

    Parameters
    ----------
    networks : path
        Of `NETWORKS`, or of the folder that holds it.
    folder : path, optional
        Of published fits.
    each : callable
        Called with each material that is done, and how many are left.
    """
    names = materials(networks)
    context = get_context("spawn")
    free = context.SimpleQueue()
    for cpu in _cpus():
        free.put(cpu)
    found = {}
    with ProcessPoolExecutor(processors(), context, _settle, (free,)) as pool:
        tasks = [pool.submit(fits_of, networks, folder, name) for name in names]
        for n, (name, task) in enumerate(zip(names, tasks, strict=True), 1):
            found[name] = task.result()
            each(name, len(names) - n)
    return found


def medians(found: Mapping[str, Mapping[str, Metrics]]) -> dict[str, tuple[float, float, int]]:
    """Medians of relative ngan_l2 and of low_log over materials, and how many they were, by model."""
    names = dict.fromkeys(model for fits in found.values() for model in fits)
    out = {}
    for model in names:
        of = [fits[model] for fits in found.values() if model in fits]
        error, log = (float(np.median([f[metric] for f in of])) for metric in ("relative_ngan_l2", "low_log"))
        out[model] = error, log, len(of)
    return out


def report(found: Mapping[str, Mapping[str, Metrics]]) -> list[str]:
    """Medians as lines: of every model, the best first, then of published fits beside ours."""
    lines = [f"{'median over materials of':62}{'relative ngan_l2':>17}{'low_log':>10}"]
    for model, (error, log, _) in sorted(medians(found).items(), key=lambda item: item[1]):
        if model not in OURS:
            lines.append(f"{model:62}{error:17.3f}{log:10.3g}")
    beside = [file for file in OURS if any(file in fits for fits in found.values())]
    if beside:
        lines.append(f"{'published fit':24}{'materials':>10}{'theirs':>9}  ours on the same")
    for file in beside:
        of = medians({name: fits for name, fits in found.items() if file in fits})
        lines.append(f"{file:24}{of[file][2]:10}{of[file][0]:9.3f}{of[OURS[file]][0]:9.3f}  {OURS[file]}")
    return lines


def _open(networks: Path) -> Any:
    path = networks / NETWORKS if networks.is_dir() else networks
    if not path.exists():
        raise InputError(
            f"{path}: does not exist; a file of networks is expected, as in Sztrajman et al. 2021"
        )
    return np.load(path)


def _cpus() -> list[int]:
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []


def _settle(free: SimpleQueue) -> None:
    """Give this process a processor of its own, so that its fits start no threads."""
    if not free.empty():
        os.sched_setaffinity(0, {free.get()})
