"""What methods on arrays have in common: a table as an array of equal importance, and the way back.

The values are weighted so that the plain L2 norm of a row is its error measure, and divided by the error the
row is allowed. An error made anywhere in that array then costs the same, and one number, a step of
quantisation or a pointwise bound, serves all of it.

What comes back is corrected: values are not negative and have the means of their rings (`rings`), but for tables with
negative ones, colours outside the gamut. Last, each row is scaled to re-integrate to its albedo.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gonio.core.directions import projected_solid_angles
from gonio.table.compress.codes import Steps
from gonio.table.compress.metric import cosine_weights, excess, reference_norms
from gonio.table.compress.rings import Rings
from gonio.table.table import Table
from microgeometry.errors import InputError

Array = NDArray[np.float64]

_SCALE_STEP = 0.001  # relative; rows that differ at random by that much are as smooth to a transform
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
    scale : Steps
        What each row and channel is divided by, shape (I, C): the error allowed in it.
    theta_r_edges, delta_phi_edges : ndarray
        Of the table.
    target : ndarray, shape (I, C), or None
        Reflectance each row is scaled to; None where cells do not add up to the albedo.
    gaps : ndarray, shape (I, R, P), or None
    rings : Rings or None
        None where values may be negative.
    base : ndarray, shape (I, R, P, C), or None
        What the array is added to: the part of the values that a model gives.
    """

    scale: Steps
    theta_r_edges: Array
    delta_phi_edges: Array
    target: Array | None
    gaps: NDArray[np.bool_] | None
    rings: Rings | None
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
        rings = None
        if table.values.min() >= 0:
            rings = Rings.of(_ring_means(table.values, table.projected_solid_angles), float(bounds.min()))
        edges = table.theta_r_edges, table.delta_phi_edges
        scaled_to = target if consistent else None
        return cls(Steps.of(scale, _SCALE_STEP), *edges, scaled_to, table.gaps, rings, base)

    @classmethod
    def read(cls, content: Mapping[str, Any], fields: Mapping[str, Any], base: Array | None = None) -> Frame:
        """The frame from a file's content and the table's other fields.

        Raises
        ------
        KeyError, TypeError, ValueError, OSError, EOFError
            Content that is missing, damaged, or does not fit the axes.
        """
        rows, per_row, _, channels = shape_of(fields)
        scale = Steps.read(content, "scale", (rows, channels), _SCALE_STEP)
        rings = Rings.read(content, (rows, per_row, channels)) if "rings" in content else None
        target = None
        if bool(content["rescaled"]):
            target = np.asarray(fields["row_albedo"], float) - fields.get("specular", 0.0)
            if target.shape != (rows, channels):
                raise ValueError(f"albedo of shape {target.shape} for {(rows, channels)}")
        edges = fields["theta_r_edges"], fields["delta_phi_edges"]
        return cls(scale, *edges, target, fields.get("gaps"), rings, base)

    def content(self, step: float, values: Array) -> dict[str, Any]:
        """What the file needs of the step, and for `read` to correct these values as `correct` does."""
        content = {"step": step, **self.scale.content("scale"), "rescaled": self.target is not None}
        if self.rings is not None:
            content |= self.rings.content(_ring_means(self._plausible(values), self._areas))
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
        return replace(self, scale=Steps.of(self.scale.values * np.exp(smooth)[:, None], _SCALE_STEP))

    def values(self, array: Array) -> Array:
        """The inverse of `normalise`."""
        values = array / self._weights[:, :, None] * self.scale.values[:, None, None]
        return values if self.base is None else values + self.base

    def correct(self, values: Array) -> Array:
        """Values that are not negative, 0 in gaps, with the means of their rings, adding up to the albedo."""
        values = self._plausible(values)
        if self.rings is not None:
            means = _ring_means(values, self._areas)
            rings = self.rings.restore(means)
            values *= np.divide(rings, means, out=np.ones_like(means), where=means > 0)[:, :, None, :]
            values += np.where((means == 0) & (rings > 0), rings, 0.0)[:, :, None, :]
            self._close_gaps(values)
        if self.target is not None:
            # of values of both signs the sum may nearly cancel: what is missing goes by their sizes
            sizes = np.abs(values)
            short = self.target - np.einsum("irpc,rp->ic", values, self._areas)
            size = np.einsum("irpc,rp->ic", sizes, self._areas)
            sizes *= np.divide(short, size, out=np.zeros_like(size), where=size > 0)[:, None, None]
            values += sizes
        return values

    def _plausible(self, values: Array) -> Array:
        """A copy without negative values, which can only bring it closer to a table that has none, and 0 in gaps."""
        values = values.copy() if self.rings is None else np.maximum(values, 0.0)
        self._close_gaps(values)
        return values

    def _close_gaps(self, values: Array) -> None:
        if self.gaps is not None:
            values[np.asarray(self.gaps, bool)] = 0.0

    @property
    def _areas(self) -> Array:
        return projected_solid_angles(self.theta_r_edges, self.delta_phi_edges)

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
        From a frame to a function from a step to the values that the decoder will correct.
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
        return float(excess(table, frame.correct(decoded(step)), bounds).max())

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
        return float(np.quantile(excess(table, frame.correct(decoded(step)), bounds), _MOST))

    if most(step) > _NEEDED:
        return None
    suited = _largest(most, step, 1.1)
    for _ in range(_ROUNDS):
        errors = excess(table, frame.correct(prepare(frame)(suited)), bounds)
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
