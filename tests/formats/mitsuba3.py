"""The real Mitsuba 3 as a referee, where it is installed: here, or in the Python named by MITSUBA_PYTHON."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

PYTHON = os.environ.get("MITSUBA_PYTHON") or (sys.executable if importlib.util.find_spec("mitsuba") else None)
needs_mitsuba = pytest.mark.skipif(
    PYTHON is None, reason="no mitsuba: install it, or name its Python in MITSUBA_PYTHON"
)
_SCRIPT = """
import sys, numpy, mitsuba as mi
variant, bsdf_file, points, out = sys.argv[1:]
mi.set_variant(variant)
bsdf = mi.load_dict({"type": "measured", "filename": bsdf_file})
q = numpy.load(points)
si, context, found = mi.SurfaceInteraction3f(), mi.BSDFContext(), []
for wi, wo in zip(q["wi"].tolist(), q["wo"].tolist()):
    si.wi = mi.Vector3f(*wi)
    if "spectral" in variant:
        si.wavelengths = q["wavelengths"].tolist()
    found.append(list(bsdf.eval(context, si, mi.Vector3f(*wo))))
numpy.save(out, numpy.array(found, float))
"""


def evaluate(path: Path, wi, wo, folder: Path, wavelengths=None):
    """f cos(theta_o) of a file by Mitsuba's `measured`, shape (N, 3), or (N, 4) for four wavelengths."""
    extra = {} if wavelengths is None else {"wavelengths": np.asarray(wavelengths, float)}
    np.savez(folder / "points.npz", wi=wi, wo=wo, **extra)
    variant = "scalar_rgb" if wavelengths is None else "scalar_spectral"
    command = [PYTHON, "-c", _SCRIPT, variant, path, folder / "points.npz", folder / "values.npy"]
    subprocess.run(command, check=True, capture_output=True)
    return np.load(folder / "values.npy")
