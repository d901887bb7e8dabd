"""What a fit can minimise. Every fit reports all of them, whichever it minimised.

With f measured, g fitted, e = f - g, all sums over cells and channels:

========== ==========================================================================================
chi2       sum e^2/variance; asks for standard errors
ngan_l2    sum (e cos_i)^2 sin_i sin_o (Ngan, Durand and Matusik 2005)
low_log    sum (ln(1 + f cos_i) - ln(1 + g cos_i))^2 sin_i (Low et al. 2012)
nbrdf      mean |ln(1 + f cos_i) - ln(1 + g cos_i)| (Sztrajman et al. 2021)
cube_root  root of the mean squared difference of (f cos_i)^(1/3) (Fores, Ferwerda and Gu 2012)
========== ==========================================================================================

The first two are quadratic in g, hence in the coefficients: these are eliminated exactly. The others are not.
There a step of the search looks at the quadratic that touches the objective at the current g
(`fitting.moments.touching`), over coefficients and shapes together, and is taken only if the objective
itself falls: Gauss and Newton's method with the coefficients as unknowns like any other. nbrdf is least
absolute deviations, done by iteratively re-weighted least squares: near 0 its modulus is rounded off over a
hundredth of its own mean.

These others are also biased by noise: the logarithm and the root of a count scatter below those of its mean.
Where a table's cells have few hits they find the faint parts of a surface too dark. At 4 hits a cell and channel
the albedo of a diffuse lobe of 0.06 comes out as 0.050 under low_log and below 0.01 under nbrdf and cube_root, at
60 hits as 0.058, 0.057 and 0.056; chi2 and ngan_l2 find it within their intervals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitting.moments import ABSOLUTE_LOG, CUBE_ROOT, LOG, QUADRATIC
from fitting.samples import Samples
from microgeometry.errors import InputError

Array = NDArray[np.float64]

DIFFERENCES = {
    "chi2": QUADRATIC,
    "ngan_l2": QUADRATIC,
    "low_log": LOG,
    "nbrdf": ABSOLUTE_LOG,
    "cube_root": CUBE_ROOT,
}
OBJECTIVES = tuple(DIFFERENCES)
"""By the name the command line calls them."""

_ROUNDED = 0.01  # of the mean modulus
_DARK = 1e-6  # of the mean f cos_i


@dataclass(frozen=True, eq=False)
class Objective:
    """An objective on some samples.

    Parameters
    ----------
    name : str
    difference : int
        See `fitting.moments`.
    weights : ndarray, shape (N, C) or (N, 1)
        Of every value's share; the same for all channels if (N, 1).
    scale : float
        See `fitting.moments.moments`.
    """

    name: str
    difference: int
    weights: Array
    scale: float = 0.0

    @property
    def quadratic(self) -> bool:
        """Whether coefficients can be eliminated."""
        return self.difference == QUADRATIC

    def shares(self, samples: Samples) -> Array:
        """What each sample adds to the objective of a model that is 0 everywhere, shape (N,)."""
        y = samples.values
        if self.quadratic:
            return np.einsum("nc,nc,nc->n", np.broadcast_to(self.weights, y.shape), y, y)
        f = np.maximum(y * samples.cos_i[:, None], 0.0)
        if self.difference == CUBE_ROOT:
            return np.sum(self.weights * np.cbrt(f) ** 2, axis=1)
        d = np.log1p(f)
        return np.sum(self.weights * (d * d if self.difference == LOG else np.hypot(d, self.scale)), axis=1)


def default_objective(samples: Samples) -> str:
    """chi2 where standard errors are known, else ngan_l2."""
    return "ngan_l2" if samples.variance is None else "chi2"


def find_objective(samples: Samples, name: str) -> Objective:
    """The objective called `name`.

    Raises
    ------
    InputError
        An unknown name, or chi2 without standard errors.
    """
    if name not in DIFFERENCES:
        raise InputError(f"objective: {name!r}; {', '.join(OBJECTIVES)} is allowed")
    n = len(samples.cells)
    if name == "chi2":
        if samples.variance is None:
            raise InputError("objective: chi2 needs the table's standard errors and it has none; use ngan_l2")
        return Objective(name, QUADRATIC, 1.0 / samples.variance)
    if name == "ngan_l2":
        return Objective(name, QUADRATIC, (samples.cos_i**2 * samples.sin_i * samples.sin_o)[:, None])
    if name == "low_log":
        return Objective(name, LOG, samples.sin_i[:, None])
    brightness = np.maximum(samples.values, 0.0) * samples.cos_i[:, None]
    if name == "nbrdf":
        scale = _ROUNDED * float(np.mean(np.log1p(brightness))) or 1.0
        return Objective(name, ABSOLUTE_LOG, np.ones((n, 1)), scale)
    return Objective(name, CUBE_ROOT, np.ones((n, 1)), _DARK * float(np.mean(brightness)) or 1.0)
