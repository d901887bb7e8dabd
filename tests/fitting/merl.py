"""All models fitted to the measured materials of the MERL database, beside published fits of them.

python -m tests.fitting.merl DATA [OUT.json] [EVERY]     DATA holds nbrdf/ and merl_fits/
"""

from __future__ import annotations

import json
import re
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from fitting import Samples
from fitting.account import account
from fitting.compare import fit_models, isotropic_models
from fitting.models import find_model
from fitting.objectives import find_objective
from fitting.problem import Problem
from gonio.core.directions import direction
from gonio.core.parallel import processors
from tests.formats.nbrdf import decode

from .materials import RGB

THETA, PHI = 28, 40
FACTORS = np.array([1.0, 1.15, 1.66])
"""Of MERL's channels, which Ngan's parameters leave out."""

# The specular lobe of each file in our terms: lobe, parameters, and coefficients by channel. Where the paper
# divides D G F by pi, ours divides by 4.
PUBLISHED = {
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
    "low_cooktorrance_E1": lambda a: _low(a),
    "low_cooktorrance_E2": lambda a: _low(a),
}


def _low(a: dict) -> tuple[str, dict, dict]:
    shape = {"alpha": a["roughness"], "eta": a["eta"]}
    return "beckmann_v_cavity_dielectric", shape, {"specular_reflectance": a["albedo"] * 4 / np.pi}


def materials(data: Path) -> list[str]:
    """Names of the 100 materials."""
    with np.load(data / "nbrdf" / "nbrdf_weights.npz") as file:
        return sorted(
            {key.split("|")[0].removeprefix("merl/") for key in file.files if key.startswith("merl/")}
        )


def measurements(data: Path, name: str) -> Samples:
    """A material decoded from its network (Sztrajman et al. 2021) on a grid of 31 360 pairs of directions.

    Even in theta_i, theta_r up to 80 degrees and in delta phi; it holds the mirror directions.
    """
    theta, phi = np.radians(np.linspace(0.0, 80.0, THETA)), np.linspace(0.0, np.pi, PHI)
    theta_i, theta_r, delta_phi = (a.ravel() for a in np.meshgrid(theta, theta, phi, indexing="ij"))
    with np.load(data / "nbrdf" / "nbrdf_weights.npz") as file:
        values = decode(file, name, direction(theta_i), direction(theta_r, delta_phi))
    return Samples.of_directions(theta_i, theta_r, delta_phi, values, RGB)


def published(data: Path, name: str, samples: Samples) -> dict[str, dict[str, float]]:
    """Metrics of the published fits of a material, by file, through the code that judges ours."""
    out = {}
    for file, lobe_of in PUBLISHED.items():
        text = (data / "merl_fits" / "fits" / f"{file}.fit").read_text()
        line = re.search(rf"^{re.escape(name)} = (.*)$", text, re.MULTILINE)
        if line is None:
            continue
        diffuse, glossy = re.findall(r"\((\s*albedo[^()]*)\)", line[1])
        factors = FACTORS if file.startswith("ngan") else np.ones(3)
        numbers = {
            k: np.array(json.loads(v)) for k, v in re.findall(r"(\w+) = (\[[^]]*\]|[-+.\de]+)", glossy)
        }
        lobe, shape, coefficients = lobe_of(numbers)
        albedo = np.array(json.loads(re.search(r"\[[^]]*\]", diffuse)[0]))
        model = find_model(f"{lobe}+lambert")
        problem = Problem(
            model.lobes, samples, find_objective(samples, "ngan_l2"), np.zeros(len(samples.cells), np.int8)
        )
        inside = all(q.lower <= shape[q.name] <= q.upper for _, q in problem.parameters)
        if not inside:  # an index below 1, a roughness of a mirror
            continue
        x = np.array([q.to_unit(float(shape[q.name])) for _, q in problem.parameters])
        rows = [coefficients[c] * factors for i, c in problem.coefficients.names if i == 0]
        point = problem.evaluate(x, np.stack([*rows, albedo * factors]), solve=False)
        out[file] = account(problem, point).metrics
    return out


def fits_of(task: tuple[Path, str]) -> dict[str, dict[str, float]]:
    """Every isotropic model with one and two lobes, fitted to one material, and published fits: metrics."""
    data, name = task
    samples = measurements(data, name)
    ours = {
        fitted.model: {**fitted.residuals, "criterion": fitted.criterion, "seconds": fitted.seconds}
        for fitted in fit_models(samples, isotropic_models(), (1, 2))
    }
    return {**ours, **published(data, name, samples)}


def medians(found: dict[str, dict[str, dict[str, float]]]) -> dict[str, tuple[float, float, int]]:
    """Medians of relative ngan_l2 and of low_log over materials, and how many they were, by model."""
    names = dict.fromkeys(model for fits in found.values() for model in fits)
    out = {}
    for model in names:
        of = [fits[model] for fits in found.values() if model in fits]
        out[model] = (
            float(np.median([f["relative_ngan_l2"] for f in of])),
            float(np.median([f["low_log"] for f in of])),
            len(of),
        )
    return out


def main() -> None:
    """Fit, print medians, write metrics by material."""
    data, *rest = sys.argv[1:]
    names = materials(Path(data))[:: int(rest[1]) if len(rest) > 1 else 1]
    began = time.perf_counter()
    with ProcessPoolExecutor(processors()) as pool:
        found = dict(zip(names, pool.map(fits_of, [(Path(data), name) for name in names]), strict=True))
    pairs = THETA * THETA * PHI
    print(f"{len(names)} materials, {pairs} pairs of directions, {time.perf_counter() - began:.0f} s")
    print(f"{'median of':62}{'relative ngan_l2':>17}{'low_log':>10}{'materials':>11}")
    for model, (error, log, count) in sorted(medians(found).items(), key=lambda item: item[1]):
        print(f"{model:62}{error:17.3f}{log:10.3g}{count:11}")
    if rest:
        Path(rest[0]).write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
