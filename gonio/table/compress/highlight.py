"""The cells of a highlight's own grid as few bytes: cosine transform over all their axes.

Rows are nearly alike in slopes (`gonio.table.peak`), so that most of what they hold is in few coefficients. Cells
are weighted by the root of their area and each row and channel is divided by its norm: the transform is
orthonormal, and one step for all coefficients bounds the relative error of each row.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from gonio.table.compress.metric import reference_norms, row_norms
from gonio.table.compress.packing import pack, step_of, unpack
from gonio.table.peak import Peak

Array = NDArray[np.float64]

_PREFIX = "peak_"
_TRIALS = 12
_FINER = 0.8
_LARGEST = 2**24


def errors(peak: Peak, values: Array) -> Array:
    """Relative error of other values, shape (I, C): RMS over the area of the slopes, as `metric.row_errors`."""
    weights = np.sqrt(peak.areas)
    norm = reference_norms(peak.values, weights)
    found = row_norms(values - peak.values, weights)
    return np.divide(found, norm, out=np.zeros_like(norm), where=norm > 0)


def encode(peak: Peak, bounds: Array) -> dict[str, Any]:
    """Content whose decoded values hold the bounds on `errors`, shape (I, C)."""
    scale = reference_norms(peak.values, np.sqrt(peak.areas)).astype(np.float32)
    # colours outside the gamut
    signed = bool(peak.values.min() < 0)
    whole = peak.values * np.sqrt(peak.areas)[..., None] / np.maximum(scale, 1e-30)[:, None, None]
    coefficients = fft.dctn(whole, norm="ortho")
    # were every coefficient rounded at random; those rounded to 0 err less, so the step may be larger
    fixed = {"scale": scale, "signed": signed}
    step = float(4.0 * bounds.min() * np.sqrt(12.0 / peak.areas.size))
    for _ in range(_TRIALS):
        found = {"coefficients": pack(np.round(coefficients / step).astype(np.int64))}
        content = {_PREFIX + name: part for name, part in {**found, **fixed, "step": step}.items()}
        if np.all(errors(peak, decode(content, peak.areas)) <= bounds):
            break
        step *= _FINER
    else:
        raise RuntimeError("a highlight's cells cannot be held to their bound")
    return content


def decode(content: Mapping[str, Any], areas: Array) -> Array:
    """Values, shape (I, S, Q, C), from the content and the cells' areas, shape (S, Q).

    Raises
    ------
    KeyError, TypeError, ValueError, OSError, EOFError
        Content that is missing or damaged.
    """
    own = {n.removeprefix(_PREFIX): part for n, part in content.items() if n.startswith(_PREFIX)}
    scale = np.asarray(own["scale"], float)
    if scale.ndim != 2 or not np.all(np.isfinite(scale) & (scale >= 0)):
        raise ValueError("scale of the highlight")
    shape = len(scale), *areas.shape, scale.shape[1]
    if math.prod(shape) > _LARGEST:
        raise ValueError(f"a highlight of {math.prod(shape)} cells")
    whole = fft.idctn(unpack(own["coefficients"], shape) * step_of(own), norm="ortho")
    if not own["signed"]:
        whole = np.maximum(whole, 0.0)
    return whole * scale[:, None, None] / np.sqrt(areas)[..., None]
