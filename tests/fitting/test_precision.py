"""Noise-free measurements give the parameters they were made with, from any start."""

from __future__ import annotations

import numpy as np
import pytest

from fitting import fit
from fitting.compare import isotropic_models

from .exact import MODELS, numbers, samples_of
from .materials import material

pytestmark = pytest.mark.compiled


def worst(model: str, seeds: range) -> float:
    """Largest relative error of any number from any start."""
    truth = material(model, *MODELS[model])
    samples, true = samples_of(truth, 10_000), numbers(truth)
    errors = [
        np.abs(numbers(fit(samples, model, seed=seed)) - true) / np.maximum(true, 1e-2) for seed in seeds
    ]
    return float(np.max(errors))


def test_every_isotropic_model_has_known_numbers() -> None:
    assert set(MODELS) >= set(isotropic_models())


@pytest.mark.parametrize("model", [m for m in MODELS if "gtr_conductor" not in m and m.count("+") < 3])
def test_parameters_come_back(model: str) -> None:
    assert worst(model, range(1)) < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_parameters_come_back_from_a_hundred_starts(model: str) -> None:
    assert worst(model, range(100)) < 1e-4
