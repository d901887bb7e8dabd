"""What tests of the validation kit find, and the statistics they judge by."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FALSE_ALARM = 1e-3
"""Probability that a correct model fails one call of `validate`."""


@dataclass(frozen=True)
class Outcome:
    """One test of the kit.

    Parameters
    ----------
    name : str
        Which test, at which direction.
    passed : bool
    detail : str
        The numbers compared, in words.
    p_value : float, optional
        Of a statistical test: `passed` is then decided by `validate` over all tests together.
    """

    name: str
    passed: bool
    detail: str
    p_value: float | None = None


@dataclass(frozen=True)
class Report:
    """Outcomes of all tests of one model."""

    outcomes: tuple[Outcome, ...]

    @property
    def passed(self) -> bool:
        """Whether every test passed."""
        return all(outcome.passed for outcome in self.outcomes)

    def lines(self) -> list[str]:
        """One line a test, failures first."""
        ordered = sorted(self.outcomes, key=lambda outcome: outcome.passed)
        return [f"{'ok  ' if o.passed else 'FAIL'} {o.name}: {o.detail}" for o in ordered]


def seed_from(name: str) -> int:
    """A random seed fixed by a test's name, so that nobody picks one that passes."""
    return zlib.crc32(name.encode())


def sidak(false_alarm: float, n_tests: int) -> float:
    """Level of one test so that `n_tests` independent ones raise a false alarm with the given probability."""
    return -np.expm1(np.log1p(-false_alarm) / max(1, n_tests))


def join(grid: Array, n: int) -> Array:
    """Sums over n x n blocks, flattened."""
    return grid.reshape(grid.shape[0] // n, n, grid.shape[1] // n, n).sum(axis=(1, 3)).ravel()


def chi_squared(observed: Array, expected: Array, blur: Array) -> tuple[float, int]:
    """Pearson's chi^2 and its degrees of freedom; bins are pooled until 5 are expected in each.

    `blur`, the error of the expectation, joins the variance: an unresolved peak must not fail a good sampler.
    """
    order = np.argsort(expected, kind="stable")
    observed, expected, blur = observed[order], expected[order], blur[order]
    pooled = max(1, int(np.searchsorted(np.cumsum(expected), 5.0)) + 1)
    pooled = max(pooled, int(np.searchsorted(expected, 5.0)))
    observed, expected, blur = (np.append(a[pooled:], a[:pooled].sum()) for a in (observed, expected, blur))
    if expected[-1] < 1e-3:  # bins nobody may enter
        if observed[-1] > 0:
            return np.inf, max(1, len(expected) - 1)
        observed, expected, blur = observed[:-1], expected[:-1], blur[:-1]
    chi2 = float(np.sum((observed - expected) ** 2 / (expected + blur**2)))
    return chi2, len(expected) - 1


def close(name: str, a: Array, b: Array | float, rtol: float = 1e-5) -> Outcome:
    """Whether two arrays agree to a relative difference, small values relative to the largest."""
    a, b = np.broadcast_arrays(np.asarray(a), np.asarray(b))
    if a.size == 0:
        return Outcome(name, True, "nothing to compare")
    scale = np.maximum(
        np.maximum(np.abs(a), np.abs(b)), 1e-6 * max(float(np.abs(a).max()), np.finfo(float).tiny)
    )
    worst = float(np.max(np.abs(a - b) / scale))
    return Outcome(name, worst <= rtol, f"largest relative difference {worst:.2g}, allowed {rtol:.2g}")


def finite(name: str, *arrays: Array) -> Outcome:
    """Whether all numbers are finite."""
    bad = sum(int(np.count_nonzero(~np.isfinite(a))) for a in arrays)
    return Outcome(name, bad == 0, f"{bad} NaN or infinite numbers")
