"""What methods on arrays have in common: values as an array of equal importance, and the way back.

The values are weighted so that the plain L2 norm of a row is its error measure, and divided by the error the
row is allowed. An error made anywhere in that array then costs the same, and one number, a step of
quantisation or a pointwise bound, serves all of it (`search` looks for it).

What comes back is corrected: values are not negative and have the means of their rings (`rings`), but for tables with
negative ones, colours outside the gamut. Last, each row is scaled to re-integrate to its albedo.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gonio.table.compress.codes import Steps
from gonio.table.compress.metric import cosine_weights, reference_norms
from gonio.table.compress.rings import Rings
from gonio.table.table import Table

Array = NDArray[np.float64]

_SCALE_STEP = 0.001  # relative; rows that differ at random by that much are as smooth to a transform
_MAX_VALUES = 2**28  # 2 GiB of float64: what a damaged file may make us allocate at most
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
    weights : ndarray, shape (R, P)
        Root of what each cell counts: its projected solid angle.
    target : ndarray, shape (I, C), or None
        Reflectance each row is scaled to; None where cells do not add up to the albedo.
    gaps : ndarray, shape (I, R, P), or None
    rings : Rings or None
        None where values may be negative.
    base : ndarray, shape (I, R, P, C), or None
        What the array is added to: the part of the values that a model gives.
    """

    scale: Steps
    weights: Array
    target: Array | None = None
    gaps: NDArray[np.bool_] | None = None
    rings: Rings | None = None
    base: Array | None = None

    @classmethod
    def of(cls, values: Array, weights: Array, bounds: Array, **rest: Any) -> Frame:
        """The frame of values whose rows may err by `bounds`, shape (I, C), of their norms; `rest` as above."""
        scale = Steps.of(reference_norms(values, weights) * bounds, _SCALE_STEP)
        rings = Rings.of(_ring_means(values, weights), float(bounds.min())) if values.min() >= 0 else None
        return cls(scale, weights, rings=rings, **rest)

    @classmethod
    def of_table(cls, table: Table, bounds: Array, base: Array | None = None) -> Frame:
        """The frame of a table's values."""
        weights = cosine_weights(table.theta_r_edges, table.delta_phi_edges)
        total = np.einsum("irpc,rp->ic", table.values, table.projected_solid_angles)
        target = table.row_albedo - table.specular
        # where the albedo is not that of the cells, scaling to it would not restore them
        consistent = bool(np.allclose(total, target, rtol=1e-9, atol=1e-12))
        rest = {"target": target if consistent else None, "gaps": table.gaps, "base": base}
        return cls.of(table.values, weights, bounds, **rest)

    @classmethod
    def read(cls, content: Mapping[str, Any], weights: Array, shape: tuple[int, int], **rest: Any) -> Frame:
        """The frame from a file's content, of as many rows and channels; `rest` as above.

        Raises
        ------
        KeyError, TypeError, ValueError
            Content that is missing or damaged.
        """
        scale = Steps.read(content, "scale", shape, _SCALE_STEP)
        rings = Rings.read(content, (shape[0], len(weights), shape[1])) if "rings" in content else None
        return cls(scale, weights, rings=rings, **rest)

    @classmethod
    def read_table(
        cls, content: Mapping[str, Any], fields: Mapping[str, Any], base: Array | None = None
    ) -> Frame:
        """The frame from a file's content and the table's other fields; raises as `read`."""
        rows, _, _, channels = shape_of(fields)
        target = None
        if bool(content["rescaled"]):
            target = np.asarray(fields["row_albedo"], float) - fields.get("specular", 0.0)
            if target.shape != (rows, channels):
                raise ValueError(f"albedo of shape {target.shape} for {(rows, channels)}")
        weights = cosine_weights(fields["theta_r_edges"], fields["delta_phi_edges"])
        rest = {"target": target, "gaps": fields.get("gaps"), "base": base}
        return cls.read(content, weights, (rows, channels), **rest)

    def content(self, step: float, values: Array) -> dict[str, Any]:
        """What the file needs of the step, and for `read` to correct these values as `correct` does."""
        content = {"step": step, **self.scale.content("scale"), "rescaled": self.target is not None}
        if self.rings is not None:
            content |= self.rings.content(_ring_means(self._plausible(values), self.weights))
        return content

    def normalise(self, values: Array) -> Array:
        """The array of equal importance."""
        scale = self.scale.values
        inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)
        rest = values if self.base is None else values - self.base
        return rest * self.weights[:, :, None] * inverse[:, None, None]

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
        values = array / self.weights[:, :, None] * self.scale.values[:, None, None]
        return values if self.base is None else values + self.base

    def correct(self, values: Array) -> Array:
        """Values that are not negative, 0 in gaps, with the means of their rings, adding up to the albedo."""
        values = self._plausible(values)
        if self.rings is not None:
            means = _ring_means(values, self.weights)
            rings = self.rings.restore(means)
            values *= np.divide(rings, means, out=np.ones_like(means), where=means > 0)[:, :, None, :]
            values += np.where((means == 0) & (rings > 0), rings, 0.0)[:, :, None, :]
            self._close_gaps(values)
        if self.target is not None:
            # of values of both signs the sum may nearly cancel: what is missing goes by their sizes
            sizes = np.abs(values)
            areas = self.weights**2
            short = self.target - np.einsum("irpc,rp->ic", values, areas)
            size = np.einsum("irpc,rp->ic", sizes, areas)
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


def _ring_means(values: Array, weights: Array) -> Array:
    """Mean over delta phi of every ring of cells, shape (I, R, C)."""
    areas = weights**2
    return np.einsum("irpc,rp->irc", values, areas / areas.sum(axis=1, keepdims=True))
