"""Intervals cover the truth as often as they say, and a wrong model is told from a right one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from fitting import Fit, Samples, fit
from gonio.table.table import Table

from .materials import counted, gold, grid, material

pytestmark = pytest.mark.compiled

TRUTH = gold(0.3)
TWO = material(
    "ggx+ggx+lambert",
    ("ggx", {"alpha": 0.1}, {"f0": (0.3, 0.2, 0.1), "f90": (1.0, 0.9, 0.8)}),
    ("ggx", {"alpha": 0.5}, {"f0": (0.3, 0.4, 0.2), "f90": (0.5, 0.9, 0.8)}),
    ("lambert", {}, {"albedo": (0.2, 0.1, 0.05)}),
)


def alike(table: Table, paths: float, rng: np.random.Generator) -> Table:
    """Channels of a traced table share their paths, so that their noise is nearly the same."""
    per_hit = 1.0 / (paths / len(table.theta_i) * table.projected_solid_angles[None, :, :, None])
    most = table.values.max(axis=-1, keepdims=True)
    hits = rng.poisson(most / per_hit)
    share = np.divide(table.values, most, out=np.zeros_like(table.values), where=most > 0)
    error = np.sqrt(np.where(hits > 0, hits, 9.0)) * per_hit * share
    return table.replace(values=hits * per_hit * share, std_error=error, hits=hits[..., 0])


def scattered(table: Table, _paths: float, rng: np.random.Generator) -> Table:
    """Errors in proportion to the value, and nothing known of them."""
    return table.replace(values=table.values * (1.0 + 0.1 * rng.standard_normal(table.values.shape)))


def covered(truth: Fit, noise: Callable, runs: int, **options: str) -> np.ndarray:
    """Which intervals held the true number, shape (runs, unknowns)."""
    table = truth.table(grid(8, 24, 40))
    rng = np.random.default_rng(20)
    out = []
    for _ in range(runs):
        found = fit(noise(table, 400_000, rng), truth.model, **options)
        lobes = sorted(range(len(found.lobes)), key=lambda n: found.lobes[n].parameters.get("alpha", 9.0))
        order = {n: place for place, n in enumerate(lobes)}
        assert found.confidence is not None
        row = {}
        for of in found.confidence["parameters"]:
            lobe = truth.lobes[order[of["lobe"]]]
            if of["channel"] is None:
                true = lobe.parameters[of["name"]]
            else:
                true = lobe.coefficients[of["name"]][of["channel"]]
            row[order[of["lobe"]], of["name"], of["channel"]] = of["lower"] <= true <= of["upper"]
        out.append([row[key] for key in sorted(row, key=str)])
    return np.array(out)


@pytest.mark.parametrize("noise", [counted, alike], ids=["independent", "alike"])
def test_intervals_hold_the_truth(noise: Callable) -> None:
    held = covered(TRUTH, noise, 12)
    # 120 intervals that share their noise ten by ten: even 12 independent ones miss 4 of 12 once in 5000
    assert held.mean() > 8 / 12
    assert held.shape == (12, 10)


def test_copies_of_a_channel_tell_nothing_new() -> None:
    table = scattered(TRUTH.table(grid(8, 24, 40)), 0.0, np.random.default_rng(3))
    samples = Samples.of_table(table)
    one = samples.values[:, :1]
    once = fit(replace(samples, values=one, channels=("R",)), TRUTH.model)
    thrice = fit(replace(samples, values=np.repeat(one, 3, axis=1)), TRUTH.model)
    assert once.confidence is not None
    assert thrice.confidence is not None
    (alone,) = (of for of in once.confidence["parameters"] if of["name"] == "alpha")
    (together,) = (of for of in thrice.confidence["parameters"] if of["name"] == "alpha")
    # but for the leverages, of which each copy has a third; taken as independent they would give 1/sqrt(3)
    assert together["value"] == pytest.approx(alone["value"], rel=1e-4)
    assert together["std_error"] == pytest.approx(alone["std_error"], rel=0.05)


def test_interval_of_what_few_values_bear_on() -> None:
    # a weighted mean: an albedo of which three values at 45 degrees make three quarters, all errors being equal;
    # a hundred channels are a hundred experiments
    theta = np.radians(np.concatenate([np.full(3, 45.0), np.full(100, 3.0)]))
    weights = np.cos(theta) ** 2 * np.sin(theta) ** 2  # of ngan_l2
    leverage = weights / weights.sum()
    rng = np.random.default_rng(9)
    channels = tuple(f"c{n}" for n in range(100))
    held = []
    for _ in range(10):
        values = 0.4 + 0.02 * rng.standard_normal((len(theta), len(channels)))
        samples = Samples.of_directions(theta, theta, np.ones(len(theta)), values, channels)
        certain = fit(samples, "lambert").confidence
        assert certain is not None
        for y, albedo in zip(values.T, certain["parameters"], strict=True):
            # by hand: HC3's standard error, and Student's quantile for the degrees of freedom of its square
            q = leverage * (y - leverage @ y) / (1.0 - leverage)
            freedom = 3.0 * np.sum(q**2) ** 2 / np.sum(q**4) - 2.0
            assert albedo["value"] == pytest.approx(np.pi * leverage @ y)
            assert albedo["std_error"] == pytest.approx(np.pi * np.sqrt(np.sum(q**2)))
            half = stats.t.ppf(0.975, freedom) * albedo["std_error"]
            assert albedo["upper"] - albedo["value"] == pytest.approx(half)
            held.append(albedo["lower"] <= 0.4 * np.pi <= albedo["upper"])
    # without the leverage it is 0.90, with the normal quantile 0.86
    assert abs(np.mean(held) - 0.95) < 3.0 * np.sqrt(0.95 * 0.05 / len(held))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "noise", "options"),
    [
        (TRUTH, counted, {}),
        (TRUTH, alike, {}),
        (TRUTH, scattered, {}),
        (TRUTH, scattered, {"objective": "low_log"}),
        (TRUTH, scattered, {"objective": "nbrdf"}),
        (TWO, counted, {}),
    ],
    ids=["independent", "alike", "scattered", "low_log", "nbrdf", "two lobes"],
)
def test_intervals_cover_93_to_97_percent(truth: Fit, noise: Callable, options: dict) -> None:
    runs = 200
    held = covered(truth, noise, runs, **options)
    # each unknown's count is binomial: none may be further from 95 % than chance lets one of so many be
    chance = 0.001 / held.shape[1]
    low, high = stats.binom.ppf([0.5 * chance, 1.0 - 0.5 * chance], runs, 0.95) / runs
    print("coverage", held.mean(axis=0), held.mean())
    assert held.mean(axis=0).min() >= low
    assert held.mean(axis=0).max() <= high
    # the mean over the unknowns, whose errors are correlated: its own scatter over runs
    error = held.mean(axis=1).std() / np.sqrt(runs)
    assert 0.93 - 2.0 * error <= held.mean() <= 0.97 + 2.0 * error
