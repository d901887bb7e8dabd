"""Fitting: parameter error against time, of our search and of what one would write with nlopt or scipy.

The samples are a known GGX lobe + Lambert, noise-free, at random pairs of directions, so that the error is that
of the parameters. The others' objective is written in numpy, with all ten parameters as unknowns; scipy's
least_squares and nlopt's sequential quadratic programming take derivatives by differences, Subplex takes none.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import nlopt
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from fitting.fit import fit
from fitting.models.dispatch import eval_many
from fitting.result import Fit, FittedLobe
from fitting.samples import Samples
from gonio.table.table import Table

Array = NDArray[np.float64]

_SAMPLES = 100_000
_CHANNELS = ("R", "G", "B")
_TRUTH = np.array([0.2, 0.5, 0.04, 0.1, 1.0, 0.9, 0.8, 0.2, 0.1, 0.05])  # alpha, f0, f90, albedo
_LOWER = np.array([1e-3, *[0.0] * 9])
_UPPER = np.array([2.0, *[10.0] * 9])
_START = np.array([0.5, *[0.5] * 9])
_SECONDS = 20.0
_LOBES = {
    1: [("ggx", 0.3, 0.6)],
    3: [("ggx", 0.05, 0.2), ("ggx", 0.2, 0.3), ("ggx", 0.6, 0.3)],
}


def run(say: Callable[[str], None]) -> dict[str, Any]:
    """Run the benchmark; returns numbers by method and by size of table."""
    fit(_samples(2000), "cook_torrance_ggx")  # compiles
    samples = _samples(_SAMPLES)
    say(f"{_SAMPLES} pairs of directions x 3 channels, GGX + Lambert, noise-free, from one start")
    say(
        f"{'method':34}{'seconds':>9}{'looks':>7}{'error of a parameter':>22}   error at 1/8 1/4 1/2 of the time"
    )
    methods: dict[str, Callable[[_Trail], None]] = {
        "gonio fit": lambda trail: _ours(samples, trail),
        "scipy least_squares, numpy": lambda trail: _scipy(samples, trail),
        "nlopt LD_SLSQP, numpy": lambda trail: _nlopt(samples, nlopt.LD_SLSQP, trail),
        "nlopt LN_SBPLX, numpy": lambda trail: _nlopt(samples, nlopt.LN_SBPLX, trail),
    }
    out: dict[str, Any] = {"methods": {}, "tables": {}}
    for name, method in methods.items():
        trail = _Trail()
        method(trail)
        seconds, error = trail.points[-1]
        earlier = "  ".join(f"{trail.at(seconds * share):.0e}" for share in (0.125, 0.25, 0.5))
        say(f"{name:34}{seconds:9.3f}{trail.looks:7}{error:22.1e}   {earlier}")
        out["methods"][name] = {
            "seconds": seconds,
            "error": error,
            "looks": trail.looks,
            "trail": trail.points,
        }
    ours = out["methods"]["gonio fit"]["seconds"]
    for name in methods:
        out["methods"][name]["times_ours"] = out["methods"][name]["seconds"] / ours
    say("ratio of times: " + ", ".join(f"{k} {v['times_ours']:.0f}" for k, v in out["methods"].items()))
    for lobes, table, model in _tables():
        for noisy in (False, True):
            measured = _with_errors(table) if noisy else table
            found = fit(measured, model)
            name = f"{lobes} lobe{'s' * (lobes > 1)}, {'with error bars' if noisy else 'noise-free'}"
            out["tables"][name] = {"seconds": found.seconds, "looks": found.evaluations}
            error = found.residuals["relative_ngan_l2"]
            say(
                f"90 x 90 x 180 cells x 3, {name}: {found.seconds:.2f} s, {found.evaluations} looks, "
                f"residual {error:.1e}"
            )
    return out


class _Trail:
    """How far the best parameters so far were from the truth, and when."""

    def __init__(self) -> None:
        self.began = time.perf_counter()
        self.looks = 0
        self.best = np.inf
        self.points: list[tuple[float, float]] = []

    def look(self, x: Array, value: float) -> None:
        """Note an evaluation at parameters in the order of the truth."""
        self.looks += 1
        if value < self.best or not self.points:
            self.best = value
            error = float(np.max(np.abs(x - _TRUTH) / _TRUTH))
            self.points.append((time.perf_counter() - self.began, error))

    def end(self) -> None:
        """The last word is as late as the method ended."""
        self.points.append((time.perf_counter() - self.began, self.points[-1][1]))

    def at(self, seconds: float) -> float:
        """The error after some time."""
        before = [error for when, error in self.points if when <= seconds]
        return before[-1] if before else np.inf


def _samples(count: int) -> Samples:
    rng = np.random.default_rng(0)
    theta_i, theta_r = np.radians(80.0) * rng.random((2, count))
    delta_phi = np.pi * rng.random(count)
    near = slice(0, count // 2)
    theta_r[near] = np.clip(theta_i[near] + rng.normal(0.0, 0.1, count // 2), 0.0, np.radians(80.0))
    delta_phi[near] = np.pi - np.minimum(np.pi, np.abs(rng.normal(0.0, 0.2, count // 2)))
    values = _model(_TRUTH, _angles(theta_i, theta_r, delta_phi))
    return Samples.of_directions(theta_i, theta_r, delta_phi, values, _CHANNELS)


def _angles(theta_i: Array, theta_r: Array, delta_phi: Array) -> tuple[Array, Array, Array, Array]:
    """cos_i, cos_o, cos_h and wi.wh."""
    cos_i, cos_o = np.cos(theta_i), np.cos(theta_r)
    cosine = cos_i * cos_o + np.sin(theta_i) * np.sin(theta_r) * np.cos(delta_phi)
    c = np.sqrt(0.5 * (1.0 + cosine))
    return cos_i, cos_o, (cos_i + cos_o) / (2.0 * c), c


def _model(x: Array, angles: tuple[Array, Array, Array, Array]) -> Array:
    """GGX with height-correlated Smith and Schlick's Fresnel term, + Lambert, in numpy, shape (N, 3)."""
    cos_i, cos_o, cos_h, c = angles
    a2 = x[0] ** 2
    d = a2 / (np.pi * (1.0 + (a2 - 1.0) * cos_h**2) ** 2)

    def hidden(cos: Array) -> Array:
        return 0.5 * (np.sqrt(cos**2 + a2 * (1.0 - cos**2)) - cos)

    lobe = 0.25 * d / (cos_i * cos_o + cos_o * hidden(cos_i) + cos_i * hidden(cos_o))
    s = (1.0 - c) ** 5
    return lobe[:, None] * ((1.0 - s)[:, None] * x[1:4] + s[:, None] * x[4:7]) + x[7:10] / np.pi


def _ours(samples: Samples, trail: _Trail) -> None:
    """Our search tells its residual as it goes, its parameters at the end."""
    found = fit(samples, "cook_torrance_ggx")
    facets, diffuse = found.lobes
    x = [facets.parameters["alpha"]]
    x += [facets.coefficients[name][c] for name in ("f0", "f90") for c in _CHANNELS]
    x += [diffuse.coefficients["albedo"][c] for c in _CHANNELS]
    trail.look(np.array(x), 0.0)
    trail.looks = found.evaluations


def _residuals(samples: Samples) -> Callable[[Array], Array]:
    grid = samples.grid
    theta_i, theta_r = (np.arctan2(n[0, :, 0, 0], n[0, :, 0, 1]) for n in (grid.rows, grid.rings))
    angles = _angles(theta_i, theta_r, np.arctan2(grid.sectors[0, :, 0, 0], grid.sectors[0, :, 0, 1]))
    root = np.sqrt(samples.cos_i**2 * samples.sin_i * samples.sin_o)[:, None]
    return lambda x: (root * (_model(x, angles) - samples.values)).ravel()


def _scipy(samples: Samples, trail: _Trail) -> None:
    residuals = _residuals(samples)

    def noted(x: Array) -> Array:
        r = residuals(x)
        trail.look(x, float(r @ r))
        return r

    least_squares(noted, _START, bounds=(_LOWER, _UPPER), x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12)
    trail.end()


def _nlopt(samples: Samples, algorithm: int, trail: _Trail) -> None:
    residuals = _residuals(samples)

    def value(x: Array, gradient: Array) -> float:
        r = residuals(x)
        total = float(r @ r)
        trail.look(x, total)
        if gradient.size:
            for k in range(len(x)):
                moved = x.copy()
                moved[k] += 1e-6
                trail.looks += 1
                gradient[k] = (float(np.sum(residuals(moved) ** 2)) - total) / 1e-6
        return total

    optimizer = nlopt.opt(algorithm, len(_TRUTH))
    optimizer.set_lower_bounds(_LOWER)
    optimizer.set_upper_bounds(_UPPER)
    optimizer.set_min_objective(value)
    optimizer.set_xtol_rel(1e-9)
    optimizer.set_maxtime(_SECONDS)
    with suppress(nlopt.RoundoffLimited, RuntimeError):
        optimizer.optimize(_START)
    trail.end()


def _tables() -> list[tuple[int, Table, str]]:
    """1.458 million cells of known lobes, with their values at the cells' middles: quick to make."""
    edges, azimuth = np.linspace(0.0, math.pi / 2, 91), np.linspace(0.0, math.pi, 181)
    middle, phi = 0.5 * (edges[1:] + edges[:-1]), 0.5 * (azimuth[1:] + azimuth[:-1])
    out = []
    for count, lobes in _LOBES.items():
        parts = [FittedLobe(n, {"alpha": a}, {"f0": _grey(f), "f90": _grey(1.0)}) for n, a, f in lobes]
        parts.append(
            FittedLobe("lambert", {}, {"albedo": dict(zip(_CHANNELS, (0.2, 0.1, 0.05), strict=True))})
        )
        model = Fit("+".join(p.name for p in parts), tuple(parts), _CHANNELS)
        kinds, shapes, weights = model.terms()
        values = np.zeros((90, 90, 180, 3))
        wo = np.stack(
            [
                np.outer(np.sin(middle), np.cos(phi)),
                np.outer(np.sin(middle), np.sin(phi)),
                np.outer(np.cos(middle), np.ones(180)),
            ],
            axis=-1,
        ).reshape(-1, 3)
        for row, theta in enumerate(middle):
            wi = np.tile([math.sin(theta), 0.0, math.cos(theta)], (len(wo), 1))
            terms = np.stack([eval_many(k, p, wi, wo) for k, p in zip(kinds, shapes, strict=True)], axis=1)
            values[row] = (terms @ weights).reshape(90, 180, 3)
        table = Table(
            values=values,
            theta_i=middle,
            theta_r_edges=edges,
            delta_phi_edges=azimuth,
            channels=_CHANNELS,
            row_albedo=np.zeros((90, 3)),
            theta_i_edges=edges,
        )
        out.append((count, table, model.model))
    return out


def _grey(value: float) -> dict[str, float]:
    return dict.fromkeys(_CHANNELS, value)


def _with_errors(table: Table) -> Table:
    """The table as 20 million paths would have counted it."""
    per_hit = 1.0 / (20e6 / len(table.theta_i) * table.projected_solid_angles[None, :, :, None])
    hits = np.random.default_rng(0).poisson(table.values / per_hit)
    error = np.sqrt(np.where(hits > 0, hits, 9.0)) * per_hit
    return table.replace(values=hits * per_hit, std_error=error, hits=hits.sum(axis=-1))
