"""The benchmarks of the table: what they claim must be what they measure, on tables of a second's work."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.bench import compress, sample
from tests.table.tables import ggx, grid, make


@pytest.mark.compiled
def test_samples_saved(monkeypatch):
    """On a glossy table: constant light leaves no variance at all, a smooth sky little, a weight is one number."""
    monkeypatch.setattr(sample, "_gold", lambda: make(ggx(0.2, 0.9), grid(45, 45, 90)))
    monkeypatch.setattr(sample, "_SAMPLES", 200_000)
    lines = []
    found = sample.run(lines.append)
    ratios = found["variance_ratio"]
    assert set(ratios) == set(sample.LIGHTS)
    assert min(ratios["white"]) > 1e5
    assert min(ratios["sky"]) > 10
    assert np.median(ratios["window"]) > 10
    assert found["largest_weight"] == pytest.approx(1, abs=1e-5)
    # as good as sampling that does not know the light can be. At 75 degrees a few percent of the light miss the
    # window, of which so many even samples tell no more
    for light in ("window", "window aside"):
        best = found["variance_ratio_at_best"][light]
        np.testing.assert_allclose(ratios[light][:3], best[:3], rtol=0.1)
        np.testing.assert_allclose(ratios[light][3], best[3], rtol=0.25)
    assert len(lines) == 2 + 2 * len(ratios)


@pytest.mark.compiled
def test_cosine_sampling_against_itself(monkeypatch):
    """A Lambertian table is sampled by the cosine: no samples are saved under any light."""
    monkeypatch.setattr(
        sample, "_gold", lambda: make(lambda wi, wo: np.full((wi + wo).shape[:-1], 0.2), grid())
    )
    monkeypatch.setattr(sample, "_SAMPLES", 100_000)
    ratios = sample.run(lambda line: None)["variance_ratio"]
    for light in ("sky", "window", "window aside"):
        # a variance of 1e5 samples is known to about 1 %, of light that few samples meet to some more
        np.testing.assert_allclose(ratios[light], 1, atol=0.15)


def test_the_formula_is_rough_gold():
    """Reciprocal, energy kept; R, G and B as a mirror of gold reflects them at normal incidence."""
    table = compress._formula()
    swapped = np.swapaxes(table.values, 0, 1)
    np.testing.assert_allclose(table.values, swapped, rtol=1e-9)
    assert np.all(table.row_albedo < 1)
    mirror = ((1 - compress._GOLD[:, 0]) ** 2 + compress._GOLD[:, 1] ** 2) / (
        (1 + compress._GOLD[:, 0]) ** 2 + compress._GOLD[:, 1] ** 2
    )
    peak = table.values[0, 0, -1]
    np.testing.assert_allclose(peak / peak[0], mirror / mirror[0], rtol=1e-3)


@pytest.mark.compiled
def test_methods_are_compared(monkeypatch):
    monkeypatch.setattr(compress, "_LOOKS", 2000)
    monkeypatch.setattr(compress, "_REPEATS", 1)
    monkeypatch.setattr(compress, "methods", lambda: {"tree": None, "dct": None})
    table = make(ggx(0.3, 0.9), grid(20, 20, 30))
    found = compress._compare(table, lambda line: None)
    assert list(found) == ["plain file", "tree", "dct", "RGL file"]
    assert found["plain file"]["error_worst"] == 0
    for method in ("tree", "dct"):
        assert 0 < found[method]["error_worst"] <= 0.01
        assert found[method]["ratio"] == 4 * table.values.size / found[method]["bytes"]
    assert found["RGL file"]["error_worst"] > 0.01
