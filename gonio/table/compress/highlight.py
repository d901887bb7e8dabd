"""The cells of a highlight's own grid (`gonio.table.peak`) as few bytes: by the tree, as a table's.

Rows are nearly alike in slopes, so that most of what they hold is in few coefficients. A cell counts by its area.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.table.compress import tree
from gonio.table.compress.frame import Frame
from gonio.table.compress.metric import reference_norms, row_norms
from gonio.table.peak import Peak

Array = NDArray[np.float64]

_PREFIX = "peak_"
_LARGEST = 2**24


def errors(peak: Peak, values: Array) -> Array:
    """Relative error of other values, shape (I, C): RMS over the area of the slopes, as `metric.row_errors`."""
    weights = np.sqrt(peak.areas)
    norm = reference_norms(peak.values, weights)
    found = row_norms(values - peak.values, weights)
    return np.divide(found, norm, out=np.zeros_like(norm), where=norm > 0)


def encode(peak: Peak, bounds: Array) -> dict[str, Any]:
    """Content whose decoded values hold the bounds on `errors`, shape (I, C)."""
    frame = Frame.of(peak.values, np.sqrt(peak.areas), bounds)
    content = tree.encode_values(frame, peak.values, lambda values: errors(peak, values) / bounds)
    return {_PREFIX + name: item for name, item in content.items()}


def decode(content: Mapping[str, Any], areas: Array, shape: tuple[int, int]) -> Array:
    """Values, shape (I, S, Q, C), from the content, the cells' areas, shape (S, Q), and the shape (I, C).

    Raises
    ------
    KeyError, TypeError, ValueError, OSError, EOFError
        Content that is missing or damaged.
    """
    own = {n.removeprefix(_PREFIX): item for n, item in content.items() if n.startswith(_PREFIX)}
    whole = shape[0], *areas.shape, shape[1]
    if math.prod(whole) > _LARGEST:
        raise ValueError(f"a highlight of {math.prod(whole)} cells")
    return tree.decode_values(own, Frame.read(own, np.sqrt(areas), shape), whole)
