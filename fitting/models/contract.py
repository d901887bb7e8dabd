"""What a model is made of: terms, lobes, models, and how a lobe's numbers are packed for the kernels.

A model is a sum of lobes. A lobe has a few *shape parameters* (a roughness, an exponent) and one or two
*terms*: colourless functions of the shape and the directions, each multiplied by a coefficient per
channel. f_r = sum over lobes and terms of coefficient ** power x term. The coefficients enter linearly
(but for the squared albedo of Oren-Nayar's interreflection), so a fit finds them by non-negative least
squares and searches over the shape only.

Kernels of a lobe, in `fitting/models/<family>.py`, all in the local frame (z up, `wi` to the light, `wo`
to the detector, tuples of unit length), f_r in 1/sr without cosine:

- ``terms(p, wi, wo) -> (t0, t1)``: the terms, t1 = 0 where there is one only; (0, 0) unless both
  directions are strictly above the horizon.
- ``sample(p, wi, u0, u1) -> wo``: a direction drawn for light from `wi` (above the horizon). It may fall
  below the horizon, where the lobe is 0: such a sample is discarded.
- ``pdf(p, wi, wo)``: the density of `sample`, 1/sr, for `wo` on the whole sphere, where it integrates to 1.
  `dispatch.lobe_pdf` is 0 below the horizon, so it integrates to the share of samples kept.

`p` is a float64 array of length `SIZE` whatever the lobe: p[0] and p[1] are weights of the two terms
(`evaluate` returns p[0] t0 + p[1] t1), p[2:] the shape parameters in the order of `Lobe.parameters`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from microgeometry.errors import InputError

SIZE = 8
"""Length of a packed lobe."""
SHAPE = 2
"""Index of the first shape parameter in a packed lobe."""


@dataclass(frozen=True)
class Parameter:
    """One shape parameter: its range, what the search steps in, and what it means."""

    name: str
    lower: float
    upper: float
    scale: Literal["linear", "log"]
    meaning: str

    def from_unit(self, u: float) -> float:
        """The value at `u` in [0, 1] of the range, linear or logarithmic."""
        u = min(1.0, max(0.0, u))
        if self.scale == "log":
            return self.lower * (self.upper / self.lower) ** u
        return self.lower + u * (self.upper - self.lower)

    def to_unit(self, value: float) -> float:
        """Inverse of `from_unit`."""
        if self.scale == "log":
            return math.log(value / self.lower) / math.log(self.upper / self.lower)
        return (value - self.lower) / (self.upper - self.lower)

    def check(self, value: float, where: str) -> float:
        """The value as a float, or InputError where it is no number or outside the range."""
        if (
            isinstance(value, bool)
            or not isinstance(value, (int, float))
            or not self.lower <= value <= self.upper
        ):
            raise InputError(
                f"{where}.{self.name}: {value!r}; a number from {self.lower:g} to {self.upper:g} is allowed"
            )
        return float(value)


@dataclass(frozen=True)
class Term:
    """One basis function's factor: the coefficient of this name, to this power."""

    coefficient: str
    power: int = 1


@dataclass(frozen=True)
class Lobe:
    """One lobe family.

    Parameters
    ----------
    name : str
        As in files and reports.
    kind : int
        What `fitting.models.dispatch` branches on; never reused for another lobe.
    parameters : tuple of Parameter
        Shape parameters, at most SIZE - SHAPE.
    terms : tuple of Term
        One or two.
    source : str
        Paper and equation.
    errata : str
        Where the paper errs or the implementation departs from it; empty if nowhere.
    """

    name: str
    kind: int
    parameters: tuple[Parameter, ...]
    terms: tuple[Term, ...]
    source: str
    errata: str = ""

    @property
    def coefficients(self) -> tuple[str, ...]:
        """Names of the coefficients, each once, in the order of the terms."""
        return tuple(dict.fromkeys(term.coefficient for term in self.terms))

    def pack(
        self, values: Mapping[str, float], weights: tuple[float, float] = (1.0, 1.0)
    ) -> NDArray[np.float64]:
        """The array the kernels take: term weights, then shape parameters; shape (SIZE,)."""
        p = np.zeros(SIZE)
        p[:SHAPE] = weights
        for index, parameter in enumerate(self.parameters):
            p[SHAPE + index] = values[parameter.name]
        return p


@dataclass(frozen=True)
class Model:
    """A named sum of lobes."""

    name: str
    lobes: tuple[Lobe, ...]
    meaning: str
