"""What a model is made of: terms, lobes, models, and how a lobe's numbers are packed for the kernels.

A model is a sum of lobes. A lobe has a few *shape parameters* (a roughness, an exponent) and one or two
*terms*: colourless functions of the shape and the directions, each multiplied by a coefficient per
channel. f_r = sum over lobes and terms of coefficient ** power x term. The coefficients enter linearly
(but for the squared albedo of Oren-Nayar's interreflection), so a fit finds them by non-negative least
squares and searches over the shape only. A shape parameter is the same in all channels; a metal with an
index of its own in each is a sum of lobes with one channel each.

Kernels of a lobe, in `fitting/models/<family>.py`, all in the local frame (z up, `wi` to the light, `wo`
to the detector, tuples of unit length), f_r in 1/sr without cosine:

- ``terms(p, wi, wo) -> (t0, t1)``: the terms, t1 = 0 where there is one only. Only called with both
  directions strictly above the horizon.
- ``slopes(p, wi, wo, values, out)``: derivatives of the terms by the shape parameters, for fits, where there
  are any and the lobe is isotropic; `values` are the terms, and out[2 j + t] is of term t by parameter j.
  Written by hand; a test holds them to differences of `terms`.
- ``sample(p, wi, u0, u1) -> wo``: a direction drawn for light from `wi` (above the horizon). It may fall
  below the horizon, where the lobe is 0: such a sample is discarded.
- ``pdf(p, wi, wo)``: the density of `sample`, 1/sr, for `wo` on the whole sphere, where it integrates to 1.
  `dispatch.lobe_pdf` is 0 below the horizon, so it integrates to the share of samples kept.

Cook-Torrance's has a ``side(variant, p, tangents, w, out)`` as well: what shadowing needs of one direction alone,
which a fit asks for once a ring of cells; its ``slopes`` take the two directions' (`dispatch.lobe_side`).

A lobe that `transmits` takes both directions on either side: `terms` is f_s of any pair (1/sr, without
cosine), `sample` may refract, and its density integrates to 1 over the sphere.

A family with variants (a choice of shadowing, say) has the same kernels for all, with the variant as the
first argument.

`p` is a float64 array of length `SIZE` whatever the lobe: p[0] and p[1] are weights of the two terms
(`evaluate` returns p[0] t0 + p[1] t1), p[2:] the shape parameters in the order of `Lobe.parameters`, and
p[DERIVED:] what `Lobe.derive` makes of them, once for each shape instead of once for each direction.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from microgeometry.errors import InputError

SIZE = 26
"""Length of a packed lobe."""
SHAPE = 2
"""Index of the first shape parameter in a packed lobe."""
DERIVED = 8
"""Index of the first number derived from them."""

VARIANTS = 64
"""A lobe's kind is VARIANTS x its family + its variant."""


@dataclass(frozen=True)
class Parameter:
    """One shape parameter: its range, what the search steps in, and what it means.

    An `optical` one, an index or a depth, does not make a lobe wider or narrower but changes it a little
    everywhere; two of them may trade against each other, so the search starts from more places.
    """

    name: str
    lower: float
    upper: float
    scale: Literal["linear", "log"]
    meaning: str
    optical: bool = False

    def from_unit(self, u: float) -> float:
        """The value at `u` in [0, 1] of the range, linear or logarithmic."""
        u = min(1.0, max(0.0, u))
        if self.scale == "log":
            return self.lower * (self.upper / self.lower) ** u
        return self.lower + u * (self.upper - self.lower)

    def slope(self, u: float) -> float:
        """Derivative of `from_unit`."""
        if self.scale == "log":
            return self.from_unit(u) * math.log(self.upper / self.lower)
        return self.upper - self.lower

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
    """One basis function's factor: c ** power / (1 - feedback c) of the coefficient c of this name.

    Parameters
    ----------
    coefficient : str
    power : int
        1 or 2.
    feedback : callable, optional
        From the shape parameters, in their order, to a number in [0, 1): a series of bounces, each with
        the coefficient as its albedo, of which that share bounces again. Of a squared coefficient only.
    """

    coefficient: str
    power: int = 1
    feedback: Callable[..., float] | None = None

    def factor(self, coefficient: NDArray[np.float64], shape: Sequence[float]) -> NDArray[np.float64]:
        """The factor for coefficients below 1 / feedback, of any shape, at the values of the parameters."""
        back = 0.0 if self.feedback is None else self.feedback(*shape)
        return coefficient**self.power / (1.0 - back * coefficient)


@dataclass(frozen=True)
class Lobe:
    """One lobe family.

    Parameters
    ----------
    name : str
        As in files and reports.
    kind : int
        What `fitting.models.dispatch` branches on: family and variant.
    parameters : tuple of Parameter
        Shape parameters, at most DERIVED - SHAPE.
    terms : tuple of Term
        One or two.
    source : str
        Paper and equation.
    errata : str
        Where the paper errs or the implementation departs from it, whether and by how much it creates
        energy; empty if nowhere. All lobes are reciprocal.
    isotropic : bool
        Whether only the difference of the azimuths matters. An anisotropic lobe's x axis is the direction
        along the surface that its parameters name; a table of an isotropic surface cannot tell them.
    diffuse : bool
        Whether it is spread over all directions, so that a sum of several of them is of no use.
    transmits : bool
        Whether light goes through, with `wi` and `wo` on different sides.
    derive : callable, optional
        From the values of the parameters, in their order, to at most SIZE - DERIVED numbers.
    """

    name: str
    kind: int
    parameters: tuple[Parameter, ...]
    terms: tuple[Term, ...]
    source: str
    errata: str = ""
    isotropic: bool = True
    diffuse: bool = False
    transmits: bool = False
    derive: Callable[..., NDArray[np.float64]] | None = None

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
        if self.derive is not None:
            derived = self.derive(*p[SHAPE : SHAPE + len(self.parameters)])
            p[DERIVED : DERIVED + len(derived)] = derived
        return p

    def tangents(self, values: Sequence[float]) -> NDArray[np.float64]:
        """Derivatives of what `pack` returns by the parameters, shape (parameters, SIZE).

        What `derive` makes is smooth: central differences of it are good to 1e-7.
        """
        out = np.zeros((len(self.parameters), SIZE))
        for j, (parameter, value) in enumerate(zip(self.parameters, values, strict=True)):
            out[j, SHAPE + j] = 1.0
            if self.derive is None:
                continue
            step = 1e-5 * (value if parameter.scale == "log" else parameter.upper - parameter.lower)
            ends = [np.array(values), np.array(values)]
            ends[0][j] = min(parameter.upper, value + step)
            ends[1][j] = max(parameter.lower, value - step)
            change = self.derive(*ends[0]) - self.derive(*ends[1])
            out[j, DERIVED : DERIVED + len(change)] = change / (ends[0][j] - ends[1][j])
        return out


@dataclass(frozen=True)
class Model:
    """A named sum of lobes."""

    name: str
    lobes: tuple[Lobe, ...]
    meaning: str
