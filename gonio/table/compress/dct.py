"""Compression by an orthonormal cosine transform of the whole table.

The values are weighted so that the plain L2 norm of a row is its error measure, and divided by the error
each row is allowed. Of that array, over theta_i, theta_r, delta phi and channel, the discrete cosine
transform (DCT-II) is orthonormal: the error made in the coefficients is the error of the values, whatever
their number. So one step of quantisation serves all; the largest that holds the bound of every row is
found by decoding. Smooth, and for channels similar, tables leave few coefficients that are not 0.
Against noise this is a threshold: what a row's bound of its own noise removes is its smallest coefficients.

Setting negative values to 0 brightens what is dark and noisy, and cosine weighting lets that pass near the
horizon: a bright rim around a rendered sphere. So the mean of every ring of cells
(theta_i, theta_r), known better than its cells, is stored in fine logarithmic steps, and restored.

Quantised coefficients are put in the order of their total frequency; of those that are not 0, the numbers of
zeros between them and their values are stored, each as byte planes packed with bzip2 (LZMA packs them 10 %
smaller and takes eight times as long where noise leaves many).
"""

from __future__ import annotations

import bz2
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from gonio.core.directions import projected_solid_angles
from gonio.table.compress.metric import cosine_weights, row_errors, row_norms
from gonio.table.table import Table
from microgeometry.errors import InputError

Array = NDArray[np.float64]

_TRIALS = 8
_RING_STEP = 0.01  # relative, of the stored means of rings
_MAX_VALUES = 2**28  # 2 GiB of float64: what a damaged file may make us allocate at most


def encode(table: Table, bound: Array) -> dict[str, Any]:
    """Compress the values so that each row and channel's error is at most `bound`, shape (I, C).

    Returns
    -------
    dict
        ``step``, ``scale`` (I, C), ``rescaled``, ``count``, ``zeros``, ``coefficients`` and, for the rings,
        ``rings``, ``ring_floor`` and ``ring_step``, as `decode` takes them.
    """
    weights = cosine_weights(table.theta_r_edges, table.delta_phi_edges)
    areas = table.projected_solid_angles
    # float32 is what the file holds; the encoder works with the same numbers
    scale = (row_norms(table.values, weights) * bound).astype(np.float32).astype(float)
    inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)
    coefficients = _forward(table.values * weights[:, :, None] * inverse[:, None, None])
    total = np.einsum("irpc,rp->ic", table.values, areas)
    target = table.row_albedo - table.specular
    # where the albedo is not that of the cells, scaling to it would not restore them
    rescaled = bool(np.allclose(total, target, rtol=1e-9, atol=1e-12))

    means = _ring_means(table.values, areas)
    ring_step = min(_RING_STEP, 0.5 * float(bound.min()))
    ring_floor = float(np.min(means, initial=np.inf, where=means > 0))
    codes = _ring_codes(means, ring_floor, ring_step)
    rings = _rings(codes, ring_floor, ring_step)

    def decoded(step: float) -> Array:
        values = _backward(np.rint(coefficients / step) * step)
        return _restore(values, scale, rings, weights, areas, target if rescaled else None, table.gaps)

    def excess(step: float) -> float:
        return float(np.max(row_errors(table, decoded(step)) / bound))

    step = _largest(excess)
    quantised = np.rint(coefficients / step).astype(np.int32)
    stream = quantised.ravel()[_order(quantised.shape)]
    kept = np.flatnonzero(stream)
    values = stream[kept]
    return {
        "step": step,
        "scale": scale.astype(np.float32),
        "rescaled": rescaled,
        "count": len(kept),
        "zeros": _pack(np.diff(kept, prepend=-1) - 1),
        "coefficients": _pack(_signless(values) - 1),
        "rings": _pack(_signless(_differences(codes))),
        "ring_floor": ring_floor if np.isfinite(ring_floor) else 0.0,
        "ring_step": ring_step,
    }


def decode(content: Mapping[str, Any], fields: Mapping[str, Any]) -> Array:
    """Values, shape (I, R, P, C), from what `encode` returned and the table's axes, albedo, delta and gaps.

    Raises
    ------
    InputError
        Content that is missing, damaged, or does not fit the axes.
    """
    edges_r, edges_phi = fields["theta_r_edges"], fields["delta_phi_edges"]
    shape = (len(fields["theta_i"]), len(edges_r) - 1, len(edges_phi) - 1, len(fields["channels"]))
    try:
        step, count, rescaled = float(content["step"]), int(content["count"]), bool(content["rescaled"])
        scale = np.asarray(content["scale"], float)
        size = int(np.prod(shape))
        if not (0 <= count <= size <= _MAX_VALUES and scale.shape == (shape[0], shape[3]) and min(shape) > 0):
            raise ValueError(f"{count} coefficients and scale {scale.shape} for a table of shape {shape}")
        if not (np.isfinite(step) and step > 0 and np.all(np.isfinite(scale))):
            raise ValueError("a step or scale that is not a positive number")
        places = np.cumsum(_unpack(content["zeros"], count) + 1) - 1
        if count and places[-1] >= size:
            raise ValueError(f"coefficient {places[-1]} of {size}")
        kept = _signed(_unpack(content["coefficients"], count) + 1)
        ring_shape = (shape[0], shape[1], shape[3])
        codes = _sums(_signed(_unpack(content["rings"], int(np.prod(ring_shape)))).reshape(ring_shape))
        ring_floor, ring_step = float(content["ring_floor"]), float(content["ring_step"])
        if not (ring_floor >= 0 and 0 < ring_step < 1 and np.all(codes >= 0)):
            raise ValueError("ring means that are not positive numbers")
        with np.errstate(over="raise"):
            rings = _rings(codes, ring_floor, ring_step)
    except (KeyError, TypeError, ValueError, OSError, EOFError, FloatingPointError) as error:
        raise InputError(f"compressed: damaged content ({error}); compress the table again") from error
    coefficients = np.zeros(size)
    coefficients[_order(shape)[places]] = kept * step
    weights = cosine_weights(edges_r, edges_phi)
    areas = projected_solid_angles(edges_r, edges_phi)
    target = np.asarray(fields["row_albedo"], float) - fields.get("specular", 0.0) if rescaled else None
    gaps = fields.get("gaps")
    return _restore(_backward(coefficients.reshape(shape)), scale, rings, weights, areas, target, gaps)


def _ring_means(values: Array, areas: Array) -> Array:
    """Mean over delta phi of every ring of cells, shape (I, R, C)."""
    return np.einsum("irpc,rp->irc", values, areas / areas.sum(axis=1, keepdims=True))


def _ring_codes(means: Array, floor: float, step: float) -> NDArray[np.int64]:
    """Means in logarithmic steps above the smallest, from 1; 0 where the mean is 0."""
    lit = means > 0
    steps = np.log(np.divide(means, floor, out=np.ones_like(means), where=lit)) / np.log1p(step)
    return np.where(lit, 1 + np.rint(steps), 0).astype(np.int64)


def _rings(codes: NDArray[np.int64], floor: float, step: float) -> Array:
    """Means from their codes."""
    return np.where(codes > 0, floor * np.exp((np.maximum(codes, 1) - 1) * np.log1p(step)), 0.0)


def _differences(codes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Small numbers for smooth tables: from ring to ring, and of each channel from the first."""
    codes = np.concatenate([codes[..., :1], codes[..., 1:] - codes[..., :1]], axis=-1)
    return np.diff(codes, axis=1, prepend=0)


def _sums(differences: NDArray[np.int64]) -> NDArray[np.int64]:
    """The inverse of `_differences`."""
    codes = np.cumsum(differences, axis=1)
    codes[..., 1:] += codes[..., :1]
    return codes


def _signless(numbers: NDArray) -> NDArray:
    """0, 1, 2, 3, 4... for 0, 1, -1, 2, -2..."""
    return np.where(numbers > 0, 2 * numbers - 1, -2 * numbers)


def _signed(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """The inverse of `_signless`."""
    return np.where(numbers % 2 == 1, (numbers + 1) // 2, -(numbers // 2))


def _pack(numbers: NDArray) -> NDArray[np.uint8]:
    """Numbers from 0 to 2^32 - 1 as byte planes, packed."""
    planes = np.ascontiguousarray(numbers.astype("<u4").view(np.uint8).reshape(-1, 4).T)
    return np.frombuffer(bz2.compress(planes.tobytes()), np.uint8)


def _unpack(packed: NDArray, count: int) -> NDArray[np.int64]:
    """What `_pack` packed; never unpacks more than `count` numbers."""
    raw = bz2.BZ2Decompressor().decompress(np.asarray(packed, np.uint8).tobytes(), 4 * count)
    if len(raw) != 4 * count:
        raise ValueError(f"{len(raw)} of {4 * count} bytes")
    return (
        np.ascontiguousarray(np.frombuffer(raw, np.uint8).reshape(4, -1).T)
        .view("<u4")
        .ravel()
        .astype(np.int64)
    )


def _forward(values: Array) -> Array:
    return fft.dctn(values, norm="ortho", workers=-1, overwrite_x=True)


def _backward(coefficients: Array) -> Array:
    return fft.idctn(coefficients, norm="ortho", workers=-1, overwrite_x=True)


def _restore(
    weighted: Array, scale: Array, rings: Array, weights: Array, areas: Array,
    target: Array | None, gaps: NDArray | None,
) -> Array:  # fmt: skip
    """From the weighted array back to values: not negative, 0 in gaps, with the means of their rings.

    Last, each row is scaled to re-integrate to its albedo.

    Values are not negative, so setting negative ones to 0 can only bring them closer to the original.
    """
    values = np.maximum(weighted / weights[:, :, None] * scale[:, None, None], 0.0)
    means = _ring_means(values, areas)
    factor = np.divide(rings, means, out=np.ones_like(means), where=means > 0)
    values *= factor[:, :, None, :]
    values += np.where((means == 0) & (rings > 0), rings, 0.0)[:, :, None, :]
    if gaps is not None:
        values[np.asarray(gaps, bool)] = 0.0
    if target is not None:
        total = np.einsum("irpc,rp->ic", values, areas)
        factor = np.divide(target, total, out=np.ones_like(total), where=total > 0)
        values *= np.maximum(factor, 0.0)[:, None, None]
    return values


def _largest(excess: Any) -> float:
    """The largest step found at which `excess`, the worst row's error over its bound, is at most 1.

    The error grows smoothly with the step, roughly as its power: a secant on logarithms, kept in brackets.
    """
    low, high = 0.0, np.inf
    step = 0.5
    for _ in range(40):
        error = excess(step)
        if error <= 1.0:
            low = step
        else:
            high = step
        if low > 0 and (high / low < 1.02 or _ >= _TRIALS):
            return low
        guess = step * (0.98 / max(error, 1e-3)) ** 0.8
        if not low < guess < high:
            guess = (
                np.sqrt(low * high) if low > 0 and np.isfinite(high) else (2 * low if low > 0 else high / 4)
            )
        step = float(guess)
    raise RuntimeError("dct: no step of quantisation holds the bound")


def _order(shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Flat indices by total frequency, in cycles over the whole table; ties in memory order."""
    frequency = np.zeros(shape, np.float32)
    for axis, n in enumerate(shape):
        place = [1] * len(shape)
        place[axis] = n
        frequency += np.arange(n, dtype=np.float32).reshape(place)
    return np.argsort(frequency.ravel(), kind="stable")
