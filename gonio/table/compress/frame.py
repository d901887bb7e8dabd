"""What methods on arrays have in common: a table as an array of equal importance, and the way back.

The values are weighted so that the plain L2 norm of a row is its error measure, and divided by the error the
row is allowed. An error made anywhere in that array then costs the same, and one number, a step of
quantisation or a pointwise bound, serves all of it.

Setting negative values to 0 brightens what is dark and noisy, and cosine weighting lets that pass near the
horizon: a bright rim around a rendered sphere. So the mean of every ring of cells (theta_i, theta_r), known
better than its cells, is stored in fine logarithmic steps, and restored; not of a table with negative values,
colours outside the gamut. Last, each row is scaled to re-integrate to its albedo.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gonio.core.directions import projected_solid_angles
from gonio.table.compress.codes import Scale, check_codes, codes_of, from_codes, pack_smooth, unpack_smooth
from gonio.table.compress.metric import cosine_weights, excess, reference_norms
from gonio.table.table import Table
from microgeometry.errors import InputError

Array = NDArray[np.float64]

_RING_STEP = 0.01  # relative, of the stored means of rings
_MAX_VALUES = 2**28  # 2 GiB of float64: what a damaged file may make us allocate at most
_TRIALS = 8
_BEYOND = 1.1 ** np.arange(7, 0, -1)
"""Where larger steps are tried than the first found to hold: errors of few coefficients jump about."""
_MOST = 0.8  # share of rows and channels that one step is to suit
_NEEDED = 0.6  # of the error allowed: rows that come so near to it need their step
_ROUNDS = 12
_AIM, _HELD = 0.93, 0.97
"""Rows whose error is above _HELD of what is allowed are to come to _AIM."""
_SMOOTH = 1 / 30  # of the rows: a scale that jumps from row to row is no smooth function to a transform


@dataclass(frozen=True)
class Frame:
    """From values, shape (I, R, P, C), to the array of equal importance of the same shape, and back.

    Parameters
    ----------
    scale : Scale
    theta_r_edges, delta_phi_edges : ndarray
        Of the table.
    target : ndarray, shape (I, C), or None
        Reflectance each row is scaled to; None where cells do not add up to the albedo.
    gaps : ndarray, shape (I, R, P), or None
    codes, ring_floor, ring_step
        Means over delta phi of the rings, shape (I, R, C), as they are stored; `codes` is None where values
        may be negative.
    base : ndarray, shape (I, R, P, C), or None
        What the array is added to: the part of the values that a model gives.
    """

    scale: Scale
    theta_r_edges: Array
    delta_phi_edges: Array
    target: Array | None
    gaps: NDArray[np.bool_] | None
    codes: NDArray[np.int64] | None
    ring_floor: float
    ring_step: float
    base: Array | None = None

    @classmethod
    def of(cls, table: Table, bounds: Array, base: Array | None = None) -> Frame:
        """The frame of a table whose rows may err by `bounds`, shape (I, C), of their norms."""
        weights = cosine_weights(table.theta_r_edges, table.delta_phi_edges)
        scale = reference_norms(table.values, weights) * bounds
        total = np.einsum("irpc,rp->ic", table.values, table.projected_solid_angles)
        target = table.row_albedo - table.specular
        # where the albedo is not that of the cells, scaling to it would not restore them
        consistent = bool(np.allclose(total, target, rtol=1e-9, atol=1e-12))
        codes, floor, step = None, 0.0, min(_RING_STEP, 0.5 * float(bounds.min()))
        if table.values.min() >= 0:
            means = _ring_means(table.values, table.projected_solid_angles)
            floor = float(np.min(means, initial=np.inf, where=means > 0))
            codes, floor = codes_of(means, floor, step), floor if np.isfinite(floor) else 0.0
        return cls(
            Scale.of(scale),
            table.theta_r_edges,
            table.delta_phi_edges,
            target if consistent else None,
            table.gaps,
            codes,
            floor,
            step,
            base,
        )

    @classmethod
    def read(cls, content: Mapping[str, Any], fields: Mapping[str, Any], base: Array | None = None) -> Frame:
        """The frame from a file's content and the table's other fields.

        Raises
        ------
        KeyError, TypeError, ValueError, OSError, EOFError
            Content that is missing, damaged, or does not fit the axes.
        """
        rows, rings, _, channels = shape_of(fields)
        scale = Scale.read(content, (rows, channels))
        codes, floor, step = None, 0.0, 0.0
        if "rings" in content:
            codes = unpack_smooth(content, "rings", (rows, rings, channels))
            floor, step = float(content["ring_floor"]), float(content["ring_step"])
            check_codes(codes, floor, step)
        target = None
        if bool(content["rescaled"]):
            target = np.asarray(fields["row_albedo"], float) - fields.get("specular", 0.0)
            if target.shape != (rows, channels):
                raise ValueError(f"albedo of shape {target.shape} for {(rows, channels)}")
        edges = fields["theta_r_edges"], fields["delta_phi_edges"]
        return cls(scale, *edges, target, fields.get("gaps"), codes, floor, step, base)

    def content(self) -> dict[str, Any]:
        """What `read` needs from the file."""
        content: dict[str, Any] = {
            **self.scale.content(),
            "rescaled": self.target is not None,
        }
        if self.codes is not None:
            content.update(pack_smooth("rings", self.codes))
            content.update(ring_floor=self.ring_floor, ring_step=self.ring_step)
        return content

    def normalise(self, values: Array) -> Array:
        """The array of equal importance."""
        scale = self.scale.values
        inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)
        rest = values if self.base is None else values - self.base
        return rest * self._weights[:, :, None] * inverse[:, None, None]

    def finer(self, errors: Array) -> Frame:
        """The frame that grants those rows less whose errors, over what is allowed, shape (I, C), are too large.

        All channels of a row alike, and its neighbours with it.
        """
        less = np.minimum(-np.log(np.maximum(errors, _HELD) / _AIM), 0.0) * (errors > _HELD)
        width = len(less) * _SMOOTH
        least = ndimage.minimum_filter1d(less.min(axis=1), 2 * round(width) + 1, mode="nearest")
        smooth = ndimage.gaussian_filter1d(least, width, mode="nearest")
        return replace(self, scale=Scale.of(self.scale.values * np.exp(smooth)[:, None]))

    def restore(self, array: Array) -> Array:
        """Back to values: not negative, 0 in gaps, with the means of their rings, adding up to the albedo.

        Values are not negative, so setting negative ones to 0 can only bring them closer to the original.
        """
        values = array / self._weights[:, :, None] * self.scale.values[:, None, None]
        return self.correct(values if self.base is None else values + self.base)

    def correct(self, values: Array) -> Array:
        """The last steps of `restore`, for values from elsewhere."""
        areas = projected_solid_angles(self.theta_r_edges, self.delta_phi_edges)
        if self.codes is not None:
            values = np.maximum(values, 0.0)
            rings = from_codes(self.codes, self.ring_floor, self.ring_step)
            means = _ring_means(values, areas)
            values *= np.divide(rings, means, out=np.ones_like(means), where=means > 0)[:, :, None, :]
            values += np.where((means == 0) & (rings > 0), rings, 0.0)[:, :, None, :]
        if self.gaps is not None:
            values[np.asarray(self.gaps, bool)] = 0.0
        if self.target is not None:
            # of values of both signs the sum may nearly cancel: what is missing goes by their sizes
            sizes = np.abs(values)
            short = self.target - np.einsum("irpc,rp->ic", values, areas)
            size = np.einsum("irpc,rp->ic", sizes, areas)
            sizes *= np.divide(short, size, out=np.zeros_like(size), where=size > 0)[:, None, None]
            values += sizes
        return values

    @property
    def _weights(self) -> Array:
        return cosine_weights(self.theta_r_edges, self.delta_phi_edges)


Prepare = Callable[[Frame], Callable[[float], Array]]


def hold(
    table: Table, bounds: Array, prepare: Prepare, quick: bool = False, base: Array | None = None
) -> tuple[Frame, float]:
    """Find the coarsest step whose approximation holds the bounds of all rows.

    Parameters
    ----------
    table : Table
    bounds : ndarray, shape (I, C)
        Relative error allowed in each row and channel.
    prepare : callable
        From a frame to a function from a step to the values the decoder will return.
    quick : bool
        Look for the step to 20 % only, enough to compare methods by.
    base : ndarray, optional
        Of the frame.

    Returns
    -------
    frame : Frame
    step : float

    Raises
    ------
    InputError
        No step holds the bounds.
    """
    frame = Frame.of(table, bounds, base)
    decoded = prepare(frame)

    def worst(step: float) -> float:
        return float(excess(table, decoded(step), bounds).max())

    if quick:
        return frame, _largest(worst, 0.1, 1.2)
    step = _largest(worst, 0.1, 1.02)
    return frame, next((further for further in step * _BEYOND if worst(further) <= 1.0), step)


def suit_most(
    table: Table, bounds: Array, prepare: Prepare, frame: Frame, step: float
) -> tuple[Frame, float] | None:
    """A step that suits most rows, and the frame in which it holds the bounds of the others too.

    Few rows would have all others stored too finely; here they alone are. From what `hold` was given and what it
    returned; None where most need that step anyway, or a few rounds do not find another.
    """
    decoded = prepare(frame)

    def most(step: float) -> float:
        return float(np.quantile(excess(table, decoded(step), bounds), _MOST))

    if most(step) > _NEEDED:
        return None
    suited = _largest(most, step, 1.1)
    for _ in range(_ROUNDS):
        errors = excess(table, prepare(frame)(suited), bounds)
        if errors.max() <= 1.0:
            return frame, suited
        frame = frame.finer(errors)
    return None


def _largest(worst: Callable[[float], float], step: float, tolerance: float) -> float:
    """The largest step found, to a factor, at which `worst`, an error over its bound, is at most 1.

    The error grows smoothly with the step, roughly as its power: a secant on logarithms, kept in brackets.
    """
    low, high, failures = 0.0, np.inf, 0
    for trial in range(40):
        error = worst(step)
        if error <= 1.0:
            low, failures = step, 0
        else:
            high, failures = step, failures + 1
        if low > 0 and (high / low < tolerance or trial >= _TRIALS):
            return low
        guess = step * (0.98 / max(error, 1e-3)) ** 0.8
        if not low < guess < high or (failures >= 2 and low > 0):
            # against noise the error hardly depends on the step: then halve the bracket
            if low > 0:
                guess = np.sqrt(low * high) if np.isfinite(high) else 2 * low
            else:
                guess = high / 4
        step = float(guess)
    raise InputError("max_error: no step of quantisation holds it")


def shape_of(fields: Mapping[str, Any]) -> tuple[int, int, int, int]:
    """Shape of the values, from a table's other fields.

    Raises
    ------
    ValueError
        More values than any file may ask for, or none.
    """
    shape = (
        len(fields["theta_i"]),
        len(fields["theta_r_edges"]) - 1,
        len(fields["delta_phi_edges"]) - 1,
        len(fields["channels"]),
    )
    if min(shape) <= 0 or np.prod(shape, dtype=float) > _MAX_VALUES:
        raise ValueError(f"a table of shape {shape}")
    return shape


def _ring_means(values: Array, areas: Array) -> Array:
    """Mean over delta phi of every ring of cells, shape (I, R, C)."""
    return np.einsum("irpc,rp->irc", values, areas / areas.sum(axis=1, keepdims=True))
