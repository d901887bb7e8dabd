"""Part of `gonio bench trace`: the same loop over the same tile by Mitsuba 3's LLVM backend, where there is one.

Looked for in this Python, or in the one that MITSUBA_PYTHON names; Mitsuba needs LLVM 16 or later
(DRJIT_LIBLLVM_PATH). All count every path as one, so at equal paths their errors are equal. "In our order" is the
same loop with one azimuth for every 16 neighbouring paths: most of what the order of the work is worth.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gonio.trace.scene import periodic_vertices
from microgeometry.tile import HeightField


def run(
    tile: HeightField, ours: Mapping[float, float], paths: int, say: Callable[[str], None]
) -> dict[str, Any] | None:
    """Compare with our paths/s by angle of incidence in degrees; None where there is no Mitsuba to run."""
    say("")
    python = os.environ.get("MITSUBA_PYTHON") or (importlib.util.find_spec("mitsuba") and sys.executable)
    if not python:
        say("Mitsuba: left out, it is not installed here and MITSUBA_PYTHON names no Python that has it")
        return None
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "tile.npz")
        np.savez(file, **_mesh(tile), theta_i_deg=list(ours), paths=paths)
        loop = Path(__file__).with_name("mitsuba_loop.py")
        done = subprocess.run([python, str(loop), str(file)], capture_output=True, text=True, check=False)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
        say(
            f"Mitsuba: left out, it fails here (LLVM 16 or later is needed, in DRJIT_LIBLLVM_PATH): {lines[-1]}"
        )
        return None
    results = []
    say(
        f"{'theta_i':>8} {'M paths/s':>10} {'Mitsuba llvm':>13} {'ratio':>6} {'its albedo':>11} "
        f"{'in our order':>13} {'ratio':>6}"
    )
    for (theta, fast), other in zip(ours.items(), json.loads(done.stdout), strict=True):
        ratio = fast / other["paths_per_second"]
        coherent = fast / other["coherent_paths_per_second"]
        results.append(
            {
                "theta_i_deg": theta,
                "paths_per_second": fast,
                "mitsuba": other,
                "ratio": ratio,
                "coherent_ratio": coherent,
            }
        )
        say(
            f"{theta:8.0f} {fast / 1e6:10.2f} {other['paths_per_second'] / 1e6:13.2f} {ratio:6.2f} "
            f"{other['albedo']:11.6f} {other['coherent_paths_per_second'] / 1e6:13.2f} {coherent:6.2f}"
        )
    means = [float(np.exp(np.mean([np.log(r[key]) for r in results]))) for key in ("ratio", "coherent_ratio")]
    say(f"{'mean':>8} {'':10} {'':13} {means[0]:6.2f} {'':11} {'':13} {means[1]:6.2f}  (geometric)")
    return {"angles": results, "ratio": means[0], "coherent_ratio": means[1]}


def _mesh(tile: HeightField) -> dict[str, Any]:
    """One period as triangles, in a unit tile."""
    z = tile.heights / max(tile.size)
    grid = periodic_vertices(z - 0.5 * (z.min() + z.max()), 1.0, 1.0).astype(np.float32)
    nx, ny = z.shape
    i, j = (a.ravel() for a in np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"))
    a, b, c, d = ((i + p) * (ny + 1) + j + q for p, q in ((0, 0), (1, 0), (1, 1), (0, 1)))
    faces = np.concatenate([np.stack([a, b, d], axis=1), np.stack([c, d, b], axis=1)])
    top = float(grid[..., 2].max()) + 1e-4
    return {"vertices": grid.reshape(-1, 3), "faces": faces, "width": 1.0, "top": top}
