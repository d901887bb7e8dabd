"""Tables no model was made for: a clear answer or a clear error, and an end."""

from __future__ import annotations

import time

import numpy as np
import pytest

from fitting import Samples, fit
from fitting.compare import isotropic_models
from fitting.objectives import OBJECTIVES
from gonio.table.table import Table
from microgeometry.errors import InputError

from .materials import gold, grid, material

pytestmark = pytest.mark.compiled

LIMIT = 30.0


def tables() -> dict[str, Table]:
    empty = grid(4, 8, 16)
    rng = np.random.default_rng(0)
    spike = np.zeros_like(empty.values)
    spike[1, 2, 15] = 1e6
    noise = rng.normal(0.0, 1.0, empty.values.shape)
    return {
        "zero": empty,
        "constant": empty.replace(values=np.full(empty.values.shape, 0.25)),
        "negative": empty.replace(values=np.full(empty.values.shape, -0.25)),
        "one cell": grid(1, 1, 1).replace(values=np.full((1, 1, 1, 3), 0.1)),
        "one bright cell": empty.replace(values=spike),
        "noise": empty.replace(values=noise, std_error=np.ones_like(noise)),
        "near mirror": gold(2e-3).table(empty),
        "tiny": gold(0.3).table(empty).replace(values=1e-20 * gold(0.3).table(empty).values),
        "huge": gold(0.3).table(empty).replace(values=1e20 * gold(0.3).table(empty).values),
        "retro-reflecting": empty.replace(values=np.broadcast_to(
            np.exp(-np.arange(16.0))[None, None, :, None], empty.values.shape
        ).copy()),
    }  # fmt: skip


@pytest.mark.parametrize("name", list(tables()))
@pytest.mark.parametrize(
    "model", ["lambert", "oren_nayar", "eon", "ggx+ggx+lambert", "gtr_conductor+lambert"]
)
def test_every_table_has_an_answer(name: str, model: str) -> None:
    began = time.perf_counter()
    found = fit(tables()[name], model, max_seconds=LIMIT)
    assert time.perf_counter() - began < 2 * LIMIT
    # 30 looks a dimension and one more in the search, 60 steps from each of 14 starts at most, 60 at the end
    assert found.evaluations < 30 * 6 + 15 * 60 + 10
    found.dumps()  # no NaN or infinity
    for lobe in found.lobes:
        for by_channel in lobe.coefficients.values():
            assert all(np.isfinite(v) and v >= 0 for v in by_channel.values())
    if name in ("zero", "negative"):
        assert "coefficients are 0" in " ".join(found.notes)
        assert all(v == 0 for lobe in found.lobes for c in lobe.coefficients.values() for v in c.values())
    if name == "one cell" and model != "lambert":
        assert "fewer values than parameters" in " ".join(found.notes)
    if name == "constant" and "conductor" not in model:
        assert found.residuals["relative_ngan_l2"] < 1e-3


@pytest.mark.parametrize("objective", [o for o in OBJECTIVES if o != "chi2"])
@pytest.mark.parametrize("name", [n for n in tables() if n != "noise"])
def test_every_objective_has_an_answer(name: str, objective: str) -> None:
    fit(tables()[name], "cook_torrance_ggx", objective=objective, max_seconds=LIMIT).dumps()


@pytest.mark.slow
@pytest.mark.parametrize("model", isotropic_models())
@pytest.mark.parametrize("name", list(tables()))
def test_every_model_has_an_answer(name: str, model: str) -> None:
    fit(tables()[name], model, max_seconds=LIMIT).dumps()


def test_two_identical_lobes_share_what_one_has() -> None:
    truth = gold(0.3)
    twice = material(
        "beckmann+beckmann+lambert",
        ("beckmann", {"alpha": 0.3}, {"f0": (0.45, 0.35, 0.15), "f90": (0.5, 0.5, 0.5)}),
        ("beckmann", {"alpha": 0.3}, {"f0": (0.45, 0.35, 0.15), "f90": (0.5, 0.5, 0.5)}),
        ("lambert", {}, {"albedo": (0.06, 0.05, 0.03)}),
    )
    table = twice.table(grid(6, 24, 36))
    found = fit(table, twice.model)
    assert found.residuals["relative_ngan_l2"] < 1e-4
    lit = [lobe for lobe in found.lobes[:2] if any(v > 1e-2 for v in lobe.coefficients["f0"].values())]
    assert all(lobe.parameters["alpha"] == pytest.approx(0.3, rel=1e-2) for lobe in lit)
    total = sum(lobe.coefficients["f0"]["R"] for lobe in found.lobes[:2])
    assert total == pytest.approx(truth.lobes[0].coefficients["f0"]["R"], rel=1e-2)


def test_a_mirror_like_lobe_is_found_in_one_degree_cells() -> None:
    truth = gold(5e-3)
    table = truth.table(grid(0, 90, 180, theta_i_deg=[10.0, 40.0, 65.0]))
    found = fit(table, truth.model)
    assert found.lobes[0].parameters["alpha"] == pytest.approx(5e-3, rel=0.05)


@pytest.mark.parametrize("scale", [1e-200, 1e100])
def test_values_in_no_unit_of_this_world(scale: float) -> None:
    table = gold(0.3).table(grid(2, 4, 8))
    with pytest.raises(InputError, match="values: the largest is"):
        fit(table.replace(values=scale * table.values), "cook_torrance_ggx")


def test_not_a_number_is_an_error() -> None:
    table = gold(0.3).table(grid(2, 4, 8))
    values = table.values.copy()
    values[0, 0, 0, 0] = np.nan
    with pytest.raises(InputError):
        fit(table.replace(values=values), "lambert")
    with pytest.raises(InputError, match="NaN"):
        Samples.of_directions([0.1], [0.2], [np.inf], [[1.0]], ("R",))
