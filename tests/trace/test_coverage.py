"""Error bars that are true: intervals cover what they should, in every kind of cell.

The study runs a specimen 200 times and counts how often value +- 1.96 standard errors holds the known answer
(the mean of all runs where there is no closed form); an empty cell must have the answer below its bound.
Cells are told apart by the paths they expect, and by where they are: the pole's ring, the horizon's, the rest.
A class is judged by its mean over runs, with the error of that mean from the scatter between runs.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from gonio.trace.measure import measure
from microgeometry.specimen import parse_specimen

LOW, HIGH = 0.93, 0.97
# Of a Poisson number, an interval covers by steps of a whole path: below about 3 paths no interval can keep to
# 93 ... 97 % at every expectation, and where nothing is expected the answer is always below the bound.
EXPECTED = (0.3, 3.0, 10.0, 30.0, 100.0, 1e9)
ALBEDO_LOW = 0.93


def covered(values, std_error, hits, truth):
    """Whether each interval holds the truth; of empty cells, whether it is below their bound."""
    width = np.where(hits[..., None] > 0, 1.96, 1.0) * std_error
    return np.abs(values - truth) <= width


def classes(expected):
    """Cells by name of class: of paths expected, and of rings; `expected` of shape (rows, rings, sectors)."""
    found = {
        f"{low:g} to {high:g} paths": (expected >= low) & (expected < high)
        for low, high in pairwise(EXPECTED)
    }
    known = expected >= EXPECTED[0]
    rings = np.arange(expected.shape[1])[None, :, None]
    found["pole"] = known & (rings == 0)
    found["horizon"] = known & (rings == expected.shape[1] - 1)
    found["all"] = known
    return found


def study(specs, rays, runs, truth=None, seed=0):
    """Coverage of each class over runs of each number of rays: name -> (mean, its standard error)."""
    shares: dict[str, list[float]] = {}
    albedo = []
    for n_rays in rays:
        tables = [measure(spec, rays=n_rays, seed=seed + k) for k, spec in enumerate([specs] * runs)]
        answer = np.mean([t.values for t in tables], axis=0) if truth is None else truth
        expected = np.mean([t.hits for t in tables], axis=0)
        row_answer = np.mean([t.row_albedo for t in tables], axis=0)
        for table in tables:
            hit = covered(table.values, table.std_error, table.hits, answer).mean(axis=-1)
            for name, mask in classes(expected).items():
                if mask.any():
                    shares.setdefault(name, []).append(float(hit[mask].mean()))
            off = np.abs(table.row_albedo - row_answer) <= 1.96 * table.albedo_std_error + 1e-9
            albedo.append(float(off.mean()))
    shares["albedo"] = albedo
    return {k: (float(np.mean(v)), float(np.std(v, ddof=1) / math.sqrt(len(v)))) for k, v in shares.items()}


if __name__ == "__main__":
    import sys

    grid = {"theta_step_deg": 5, "phi_step_deg": 10, "theta_i_deg": [5, 40, 80]}
    cases = {
        "flat": ({"kind": "flat"}, {"kind": "lambert", "albedo": 0.7}),
        "pit": (
            {"kind": "pits", "cover": 0.5, "depth": 1.0, "arrangement": "hexagonal"},
            {"kind": "lambert", "albedo": 0.7},
        ),
        "gaussian": ({"kind": "gaussian", "alpha": 0.5, "samples": 64, "size": 16}, {"kind": "mirror"}),
        "clumps": (
            {"kind": "gaussian", "alpha": 0.5, "samples": 16, "size": 4},
            {"kind": "conductor", "eta": 1.0, "k": 2.0},
        ),
    }
    for name in sys.argv[2:]:
        surface, material = cases[name]
        spec = parse_specimen({"surface": surface, "material": material, "grid": grid})
        for n in (3_000, 12_000, 50_000, 200_000):
            print(
                name,
                n,
                {k: (round(a, 3), round(b, 3)) for k, (a, b) in study(spec, [n], int(sys.argv[1])).items()},
                flush=True,
            )
