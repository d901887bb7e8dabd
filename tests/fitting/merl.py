"""All models fitted to the measured materials of the MERL database, beside published fits of them.

python -m tests.fitting.merl DATA [OUT.json]     DATA holds nbrdf/ and merl_fits/
"""

from __future__ import annotations

import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fitting import Samples
from fitting.compare import fit_models, isotropic_models
from gonio.core.parallel import processors

PAIRS = 30_000


def materials(data: Path) -> list[str]:
    """Names of the 100 materials."""
    with np.load(data / "nbrdf" / "nbrdf_weights.npz") as file:
        return sorted(
            {key.split("|")[0].removeprefix("merl/") for key in file.files if key.startswith("merl/")}
        )


def measurements(data: Path, name: str, n: int = PAIRS) -> Samples:
    """A material decoded from its network (Sztrajman et al. 2021) at n pairs of directions, theta <= 80 degrees."""
    rng = np.random.default_rng(0)
    theta_h = rng.random(4 * n) ** 2 * np.pi / 2  # as MERL's own bins: dense about the highlight
    theta_d, phi_d = rng.random(4 * n) * np.pi / 2, rng.random(4 * n) * np.pi
    difference = np.stack([np.sin(theta_d) * np.cos(phi_d), np.sin(theta_d) * np.sin(phi_d), np.cos(theta_d)])
    wi, wo = _tilt(difference, theta_h), _tilt(difference * np.array([[-1], [-1], [1]]), theta_h)
    keep = np.flatnonzero((wi[2] > np.cos(np.radians(80))) & (wo[2] > np.cos(np.radians(80))))[:n]
    with np.load(data / "nbrdf" / "nbrdf_weights.npz") as file:
        w1, b1, w2, b2, w3, b3 = (file[f"merl/{name}|{k}"] for k in range(6))
    x = np.stack([np.sin(theta_h), 0 * theta_h, np.cos(theta_h), *difference], axis=1)[keep]
    hidden = np.maximum(np.maximum(x @ w1 + b1, 0) @ w2 + b2, 0)
    values = np.maximum(np.exp(hidden @ w3 + b3) - 1, 0)
    delta_phi = np.abs(np.arctan2(wi[1], wi[0]) - np.arctan2(wo[1], wo[0]))[keep]
    delta_phi = np.minimum(delta_phi, 2 * np.pi - delta_phi)
    return Samples.of_directions(
        np.arccos(wi[2, keep]), np.arccos(wo[2, keep]), delta_phi, values, ("R", "G", "B")
    )


def _tilt(v: NDArray, theta: NDArray) -> NDArray:
    return np.stack(
        [np.cos(theta) * v[0] + np.sin(theta) * v[2], v[1], np.cos(theta) * v[2] - np.sin(theta) * v[0]]
    )


def fits_of(task: tuple[Path, str]) -> dict[str, dict[str, float]]:
    """Every isotropic model with one and two lobes, fitted to one material: metrics by model."""
    data, name = task
    samples = measurements(data, name)
    return {
        fitted.model: {**fitted.residuals, "criterion": fitted.criterion, "seconds": fitted.seconds}
        for fitted in fit_models(samples, isotropic_models(), (1, 2))
    }


def main() -> None:
    data = Path(sys.argv[1])
    names = materials(data)[:: int(sys.argv[3]) if len(sys.argv) > 3 else 1]
    began = time.perf_counter()
    with ProcessPoolExecutor(processors()) as pool:
        found = dict(zip(names, pool.map(fits_of, [(data, name) for name in names]), strict=True))
    models = list(next(iter(found.values())))
    print(f"{len(names)} materials, {PAIRS} pairs of directions, {time.perf_counter() - began:.0f} s")
    print(f"{'model':45s} median relative ngan_l2")
    for model in sorted(
        models, key=lambda m: float(np.median([f[m]["relative_ngan_l2"] for f in found.values()]))
    ):
        print(
            f"{model:45s} {np.median([f[model]['relative_ngan_l2'] for f in found.values()]):.3f}   {np.sum([f[model]['seconds'] for f in found.values()]):.1f} s"
        )
    if len(sys.argv) > 2 and sys.argv[2] != "-":
        Path(sys.argv[2]).write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
