from __future__ import annotations

import numpy as np
import pytest

from fitting import Fit, Samples, fit
from fitting.account import account
from fitting.models import find_model
from fitting.objectives import find_objective
from fitting.problem import Problem
from gonio.table.table import Table
from microgeometry.errors import InputError

from .materials import counted, gold, grid, material

pytestmark = pytest.mark.compiled

MATERIALS = [
    material("lambert", ("lambert", {}, {"albedo": (0.9, 0.5, 0.1)})),
    material("oren_nayar", ("oren_nayar", {"sigma": 0.35}, {"rho": (0.9, 0.5, 0.1)})),
    gold(0.5),
    gold(0.08),
    gold(0.3, "ggx"),
    material(
        "cook_torrance_1982",
        ("beckmann_v_cavity", {"alpha": 0.25}, {"f0": (0.5, 0.04, 0.04), "f90": (0.9, 0.8, 0.7)}),
        ("lambert", {}, {"albedo": (0.2, 0.0, 0.1)}),
    ),
    material(
        "ashikhmin_shirley",
        ("ashikhmin_shirley", {"exponent": 40.0}, {"f0": (0.5, 0.04, 0.1), "f90": (1.0, 1.0, 1.0)}),
        ("ashikhmin_shirley_diffuse", {}, {"rd": (0.2, 0.0, 0.1)}),
    ),
]


def numbers(fitted: Fit) -> dict[str, float]:
    """Every parameter and coefficient by a path of names."""
    out = {}
    for lobe in fitted.lobes:
        out.update({f"{lobe.name}.{k}": v for k, v in lobe.parameters.items()})
        for name, by_channel in lobe.coefficients.items():
            out.update({f"{lobe.name}.{name}.{c}": v for c, v in by_channel.items()})
    return out


@pytest.mark.parametrize("truth", MATERIALS, ids=lambda m: f"{m.model} {dict(m.lobes[0].parameters)}")
def test_noise_free_parameters_come_back(truth: Fit) -> None:
    rng = np.random.default_rng(3)
    theta_i, theta_r = np.radians(rng.uniform(0, 80, (2, 20_000)))
    # half of the directions near the mirror direction, for the sharp lobes
    theta_r[::2] = np.abs(theta_i[::2] + rng.normal(0, 0.05, 10_000))
    delta_phi = np.pi * rng.random(20_000)
    delta_phi[::2] = np.pi - np.abs(rng.normal(0, 0.1, 10_000))
    bare = Samples.of_directions(theta_i, theta_r, delta_phi, np.zeros((20_000, 3)), truth.channels)
    kinds, shapes, weights = truth.terms()
    picks = shapes[:, :2].reshape(-1, 1) * np.repeat(weights, 2, axis=0)
    values = np.zeros((20_000, 3))
    inside = np.radians(80.0) >= theta_r
    values[inside] = bare.terms(kinds, shapes, 0) @ picks
    samples = Samples.of_directions(theta_i, theta_r, delta_phi, values, truth.channels)
    for seed in range(3):
        found = fit(samples, truth.model, seed=seed)
        assert numbers(found) == pytest.approx(numbers(truth), rel=1e-4, abs=1e-5)
        assert found.residuals["relative_ngan_l2"] < 1e-6


@pytest.mark.parametrize("alpha", [0.5, 0.1, 0.03])
def test_cell_averages_are_compared_with_cell_averages(alpha: float) -> None:
    truth = gold(alpha)
    table = truth.table(grid(6, 45, 90, theta_i_deg=[5.0, 20.0, 35.0, 50.0, 65.0, 75.0]))
    found = fit(table, truth.model)
    assert found.lobes[0].parameters["alpha"] == pytest.approx(alpha, rel=2e-3 if alpha < 0.1 else 1e-4)
    assert found.cells_left_out == {"theta above 80 degrees": 6 * 5 * 90}
    assert found.theta_limit_deg == 80.0


def test_few_hits_a_cell_do_not_bias_the_fit() -> None:
    """Weights from a cell's own count pull a fit down by a hit a cell; here cells have about 7 hits."""
    truth = gold(0.5)
    table = truth.table(grid(10, 36, 60))
    rng = np.random.default_rng(11)
    found = [numbers(fit(counted(table, 150_000, rng), truth.model)) for _ in range(8)]
    for name, expected in numbers(truth).items():
        values = np.array([f[name] for f in found])
        error = values.std(ddof=1) / np.sqrt(len(values))
        # 8 fits: t distribution with 7 degrees of freedom, two-sided 1e-3 over 10 numbers
        assert abs(values.mean() - expected) < 7.1 * error + 1e-6, (name, values.mean(), expected, error)
    alphas = np.array([f["beckmann.alpha"] for f in found])
    assert alphas.std() < 0.01 * 0.5
    assert np.mean([f["beckmann.f0.R"] for f in found]) == pytest.approx(0.9, rel=0.005)


def test_chi_squared_of_the_right_model_is_its_degrees_of_freedom() -> None:
    table = counted(gold(0.5).table(grid(15, 45, 90)), 4_000_000, np.random.default_rng(5))
    right, wrong = fit(table, "cook_torrance_beckmann"), fit(table, "cook_torrance_ggx")
    assert right.objective == "chi2"
    assert right.degrees_of_freedom is not None
    # 0.5 % for the pooled variance, 4 sigma of chi^2 / dof = 4 sqrt(2/160 000)
    assert right.residuals["chi2"] / right.degrees_of_freedom == pytest.approx(1.0, abs=0.02)
    assert wrong.residuals["chi2"] > 1.1 * right.residuals["chi2"]


def test_traced_gold_with_multiple_scattering() -> None:
    """20 M paths: alpha within 10 % is asked for where the scattering is only roughly Lambertian."""
    truth = gold(0.5)
    table = truth.table(grid(30, 45, 90))
    cos_r, cos_i = np.cos(table.theta_r)[None, :, None, None], np.cos(table.theta_i)[:, None, None, None]
    smooth = 0.06 / np.pi * (0.4 + 0.9 * np.sqrt(cos_r * cos_i)) * np.array([0.81, 0.49, 0.09])
    noisy = counted(table.replace(values=table.values + smooth), 20e6, np.random.default_rng(7))
    found = fit(noisy, "cook_torrance_beckmann")
    assert found.lobes[0].parameters["alpha"] == pytest.approx(0.5, rel=0.1)
    assert found.albedo["conserves_energy"]


def test_same_numbers_for_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    table = gold(0.4).table(grid(6, 30, 60))
    found = []
    for threads in (1, 2, 8):
        monkeypatch.setattr("gonio.core.parallel.processors", lambda threads=threads: threads)
        result = fit(table, "cook_torrance_beckmann").to_json()
        found.append([result[k] for k in ("lobes", "residuals", "evaluations")])
    assert found[0] == found[1] == found[2]


def test_unknown_objective_and_model() -> None:
    table = gold().table(grid(2, 4, 8))
    with pytest.raises(InputError, match="chi2 needs the table's standard errors"):
        fit(table, "lambert", objective="chi2")
    with pytest.raises(InputError, match="chi2, ngan_l2, low_log, nbrdf, cube_root is allowed"):
        fit(table, "lambert", objective="l1")
    with pytest.raises(InputError, match="unknown name 'phong'"):
        fit(table, "phong")
    with pytest.raises(InputError, match="max_seconds"):
        fit(table, "lambert", max_seconds=0.0)


@pytest.mark.parametrize("model", ["lambert", "oren_nayar", "cook_torrance_beckmann", "ashikhmin_shirley"])
def test_hard_tables_have_a_clear_answer(model: str) -> None:
    zero = grid(4, 8, 16)
    found = fit(zero, model)
    assert all(v == 0.0 for k, v in numbers(found).items() if k.count(".") == 2)
    assert "coefficients are 0" in found.notes[0]

    constant = zero.replace(values=np.full(zero.values.shape, 0.25))
    found = fit(constant, model)
    if model != "ashikhmin_shirley":  # its diffuse term is not constant
        assert found.residuals["relative_ngan_l2"] < 1e-3
        assert numbers(found).get("lambert.albedo.R", 0.25 * np.pi) == pytest.approx(0.25 * np.pi, rel=1e-3)

    one = grid(1, 1, 1).replace(values=np.full((1, 1, 1, 3), 0.1))
    found = fit(one, model)
    assert found.residuals["relative_ngan_l2"] < 1e-6
    if model != "lambert":
        assert "fewer values than parameters" in found.notes[0]


def test_one_row_at_normal_incidence() -> None:
    truth = gold(0.3)
    found = fit(truth.table(grid(0, 45, 4, theta_i_deg=[0.0])), truth.model)
    assert found.lobes[0].parameters["alpha"] == pytest.approx(0.3, rel=1e-3)


def test_noise_only_and_negative_values() -> None:
    table = grid(4, 8, 16)
    noise = np.random.default_rng(0).normal(0.0, 1.0, table.values.shape)
    found = fit(table.replace(values=noise, std_error=np.ones_like(noise)), "cook_torrance_ggx")
    assert found.degrees_of_freedom is not None
    assert found.residuals["chi2"] / found.degrees_of_freedom == pytest.approx(1.0, abs=0.2)


def test_all_gaps_is_an_error() -> None:
    table = grid(4, 8, 16)
    with pytest.raises(InputError, match="no cell is left to fit"):
        fit(table.replace(gaps=np.ones(table.values.shape[:3], bool)), "lambert")


def test_gaps_and_unknown_errors_are_counted() -> None:
    table = material("lambert", ("lambert", {}, {"albedo": (0.5, 0.5, 0.5)})).table(grid(9, 9, 4))
    gaps = np.zeros(table.values.shape[:3], bool)
    gaps[0, 0, 0] = True
    error = np.full(table.values.shape, 0.01)
    error[1] = 0.0  # a row that never learnt its error
    found = fit(table.replace(gaps=gaps, std_error=error), "lambert")
    # 9 rings of 10 degrees: the last row and ring lie above 80
    assert found.cells_left_out == {"theta above 80 degrees": 17 * 4, "gap": 1, "error not known": 8 * 4}
    assert found.cells_used == 9 * 9 * 4 - 17 * 4 - 1 - 8 * 4
    assert numbers(found)["lambert.albedo.R"] == pytest.approx(0.5, rel=1e-9)


def test_time_limit() -> None:
    found = fit(gold(0.3).table(grid(10, 45, 90)), "cook_torrance_ggx", max_seconds=1e-3)
    assert "time limit" in found.notes[0]
    assert np.isfinite(found.residuals["ngan_l2"])


def test_nan_measurements_are_an_error() -> None:
    with pytest.raises(InputError, match="NaN"):
        Samples.of_directions([0.1], [0.2], [0.3], [[np.nan]], ("R",))


def test_metrics_by_hand() -> None:
    # One measurement, theta_i = 60: cos 0.5, sin 0.866025; theta_r = 30: sin 0.5. f = 2, g = 1: e cos = 0.5.
    samples = Samples.of_directions(*np.radians([[60.0], [30.0], [0.0]]), [[2.0]], ("R",), [[0.5]])
    problem = Problem(
        find_model("lambert").lobes, samples, find_objective(samples, "ngan_l2"), np.zeros(1, np.int8)
    )
    found = account(problem, problem.evaluate(np.zeros(0), np.array([[np.pi]]), solve=False)).metrics
    assert found == pytest.approx(
        {
            "ngan_l2": 0.25 * 0.8660254 * 0.5,
            "relative_ngan_l2": 0.5,
            "low_log": np.log(2.0 / 1.5) ** 2 * 0.8660254,
            "nbrdf": np.log(2.0 / 1.5),
            "cube_root": 1.0 - 0.5 ** (1 / 3),
            "chi2": 4.0,
        },
        rel=1e-6,
    )


def test_progress_and_type() -> None:
    seen: list[float] = []
    table = gold(0.3).table(grid(6, 30, 60))
    assert isinstance(table, Table)
    fit(table, "cook_torrance_ggx", progress=lambda fraction, words: seen.append(fraction))
    assert seen == sorted(seen)
    assert 0.0 <= seen[0] <= seen[-1] <= 1.0
