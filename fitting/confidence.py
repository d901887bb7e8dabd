"""How certain a fit is: intervals, correlation, and whether the model can be what was measured.

The covariance of all unknowns, shapes and coefficients together, is H^-1 S H^-1 with the Gauss-Newton
matrix H of the objective and the scatter S of its first derivatives over cells (Huber 1967; White 1980,
clustered by cell: Liang and Zeger 1986). Where the model holds, the errors are those in the table and
channels are independent, S is H and the covariance is H^-1, the inverse Hessian. But channels of a traced
table share their paths, which S sees, and objectives other than chi2 do not weigh by the errors. Unknowns at
a bound are held there.

The scatter is itself an estimate, and of an unknown on which few cells bear a rough one: quantiles are
Student's, of the degrees of freedom it has along each unknown (see `Account.freedom`).

Intervals of shape parameters are symmetric in the search's variable, which is the logarithm for most.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fitting.account import Account, inverse_over
from fitting.problem import Point, Problem

Array = NDArray[np.float64]

LEVEL = 0.95
_CALIBRATION = 0.03


@dataclass(frozen=True, eq=False)
class Confidence:
    """Uncertainty of the unknowns of a problem, in the order of `Problem.equations`.

    Parameters
    ----------
    covariance : ndarray, shape (M, M)
        Of shape parameters on [0, 1] and of coefficients; 0 where held at a bound.
    held : ndarray of bool, shape (M,)
        At a bound, or without any influence.
    half_width : ndarray, shape (M,)
        Of the interval; where held, what it would be were the others known.
    """

    covariance: Array
    held: NDArray[np.bool_]
    half_width: Array

    @property
    def correlation(self) -> Array:
        """Shape (M, M); 0 where held, 1 on the diagonal."""
        std = np.sqrt(np.diag(self.covariance))
        std[std == 0.0] = np.inf
        out = self.covariance / np.outer(std, std)
        np.fill_diagonal(out, 1.0)
        return np.clip(out, -1.0, 1.0)


def confidence(problem: Problem, point: Point, seen: Account) -> Confidence | None:
    """Uncertainty of a fit; None where there are no more values than unknowns."""
    values, size = problem.samples.values.size, problem.size
    if values <= size:
        return None
    inverse = inverse_over(seen.matrix, ~seen.held)
    covariance = inverse @ seen.scatter @ inverse
    np.fill_diagonal(covariance, np.maximum(np.diag(covariance), 0.0))  # rounding, where all but singular
    std = np.sqrt(np.diag(covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        alone = np.sqrt(np.diag(seen.scatter)) / np.diag(seen.matrix)
    std = np.where(seen.held, np.where(np.isfinite(alone), alone, np.inf), std)
    freedom = np.fmin(seen.freedom, values - size)
    return Confidence(covariance, seen.held, stats.t.ppf(0.5 + 0.5 * LEVEL, freedom) * std)


def describe(problem: Problem, point: Point, certain: Confidence) -> dict[str, Any]:
    """Intervals and correlation by name, as plain JSON types; see `Fit.confidence`."""
    d, channels = len(problem.parameters), problem.samples.channels
    out: list[dict[str, Any]] = []

    def add(lobe: int, name: str, channel: str | None, numbers: tuple[float, float, float, float]) -> None:
        value, std_error, lower, upper = (float(v) if np.isfinite(v) else None for v in numbers)
        at_bound = bool(certain.held[len(out)])
        out.append(
            {"lobe": lobe, "name": name, "channel": channel, "value": value, "at_bound": at_bound}
            | {"std_error": None if at_bound else std_error, "lower": lower, "upper": upper}
        )

    std = np.sqrt(np.diag(certain.covariance))
    for n, (lobe, q) in enumerate(problem.parameters):
        u, half = float(point.x[n]), certain.half_width[n]
        ends = q.from_unit(u - half), q.from_unit(u + half)
        add(lobe, q.name, None, (q.from_unit(u), std[n] * q.slope(u), *ends))
    for j, (lobe, name) in enumerate(problem.coefficients.names):
        for c, channel in enumerate(channels):
            value, n = point.coefficients[j, c], d + j * len(channels) + c
            half = certain.half_width[n]
            add(lobe, name, channel, (value, std[n], max(0.0, value - half), value + half))
    return {"level": LEVEL, "parameters": out, "correlation": certain.correlation.tolist()}


def goodness(seen: Account, values: int, unknowns: int, estimated: bool) -> dict[str, float] | None:
    """Whether the errors explain what a fit leaves over: None without errors, or with no degree of freedom left.

    Two tests, the smaller of their probabilities counting twice. The sum: chi^2, whose scatter is taken from
    its scatter over cells, as counts of few hits scatter more than Gaussian errors and the channels of a cell
    are not independent; its distribution is that of chi^2 of as many degrees of freedom as have this scatter.
    The order: what noise leaves has no neighbours of the same sign, what a wrong model leaves has. This
    one finds small deviations, and does not care how well the errors themselves are known.

    Parameters
    ----------
    seen : Account
    values, unknowns : int
    estimated : bool
        As in `fitting.samples.Samples`.

    Returns
    -------
    dict
        chi2, degrees_of_freedom, chi2_std; neighbours, the correlation of residuals side by side in standard
        deviations; p_value: the probability of so much if the model holds.
    """
    freedom = values - unknowns
    if "chi2" not in seen.metrics or freedom <= 0:
        return None
    chi2 = seen.metrics["chi2"]
    spread = max(seen.chi2_std, float(np.sqrt(2.0 * freedom)))
    if estimated:
        spread = float(np.hypot(spread, _CALIBRATION * freedom))
    by_sum = stats.chi2.sf(chi2 * 2.0 * freedom / spread**2, 2.0 * freedom**2 / spread**2)
    by_order = stats.norm.sf(seen.neighbours)
    return {
        "chi2": chi2,
        "degrees_of_freedom": freedom,
        "chi2_std": spread,
        "neighbours": seen.neighbours,
        "p_value": min(1.0, 2.0 * float(min(by_sum, by_order))),
    }
