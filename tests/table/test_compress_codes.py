"""Numbers of rows come back to their step, means of rings whatever was decoded."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.table.compress.codes import Steps
from gonio.table.compress.rings import Rings
from gonio.validation import seed_from

pytestmark = pytest.mark.compiled

SHAPE = (20, 15, 3)


@pytest.mark.parametrize("step", [1e-6, 0.01])
def test_steps_are_relative_whatever_size_and_sign(step):
    rng = np.random.default_rng(seed_from("steps"))
    values = rng.choice([-1, 0, 1], SHAPE[:2]) * 10.0 ** rng.uniform(-40, 5, SHAPE[:2])
    steps = Steps.of(values, step)
    found = Steps.read(steps.content("x"), "x", SHAPE[:2], step).values
    np.testing.assert_allclose(found, values, rtol=0.51 * step)
    np.testing.assert_array_equal(found == 0, values == 0)


def test_numbers_of_rows_that_are_hardly_there():
    """The least stand for what is less than that: 1e-50 of the largest, or nothing at all."""
    np.testing.assert_allclose(
        Steps.of(np.array([[1e-200, -1e-300, 2.0]]), 1e-6).values, [[2e-50, -2e-50, 2.0]], rtol=1e-6
    )
    np.testing.assert_array_equal(Steps.of(np.zeros((2, 3)), 1e-6).values, np.zeros((2, 3)))


def test_smooth_numbers_are_small():
    """Albedos of 90 rows: a quarter of the bytes of float64 or less."""
    albedo = 0.5 + 0.4 * np.cos(np.linspace(0, 1.5, 90))[:, None] * [1.0, 0.8, 0.5]
    assert Steps.of(albedo, 1e-6).content("x")["x"].size < albedo.nbytes / 4


def wanted_and_decoded():
    rng = np.random.default_rng(seed_from("rings"))
    wanted = 10.0 ** rng.uniform(-6, 1, SHAPE) * (rng.random(SHAPE) < 0.8)
    decoded = wanted * rng.lognormal(0, 0.02, SHAPE)
    decoded[rng.random(SHAPE) < 0.2] = 0.0
    decoded[(wanted == 0) & (rng.random(SHAPE) < 0.5)] = 1e-3
    return wanted, decoded


def test_means_of_rings_come_back_from_whatever_was_decoded():
    wanted, decoded = wanted_and_decoded()
    rings = Rings.of(wanted, 0.01)
    found = Rings.read(rings.content(decoded), SHAPE).restore(decoded)
    np.testing.assert_array_equal(found, rings.restore(decoded))
    np.testing.assert_array_equal(found == 0, wanted == 0)
    lit = wanted > 0
    assert np.abs(np.log(found[lit] / wanted[lit])).max() <= 0.7 * np.log1p(0.01) + 1e-12


def test_means_that_come_back_by_themselves_take_nothing():
    wanted, _ = wanted_and_decoded()
    assert Rings.of(wanted, 0.01).content(wanted * 1.006)["rings"].size == 0


def test_means_that_are_hardly_there():
    """1e-50 of the largest is the least, and no number is beyond what a reader accepts."""
    wanted = np.array([[[1e-300], [1e-20], [0.0], [2.0]]])
    for decoded in (np.zeros(wanted.shape), wanted[:, ::-1]):
        content = Rings.of(wanted, 1e-6).content(decoded)
        found = Rings.read(content, wanted.shape).restore(decoded)
        np.testing.assert_allclose(found[0, :, 0], [2e-50, 1e-20, 0.0, 2.0], rtol=1e-6)


def test_last_digits_of_what_is_decoded_change_last_digits_only():
    """Another machine's transform: a factor that depended on them would jump by a step."""
    wanted, decoded = wanted_and_decoded()
    content = Rings.of(wanted, 0.01).content(decoded)
    other = decoded * (1 + 1e-12)
    found, again = (Rings.read(content, SHAPE).restore(x) for x in (decoded, other))
    np.testing.assert_allclose(again, found, rtol=3e-12)


@pytest.mark.parametrize(
    "change", [{"ring_step": 2.0}, {"ring_step": float("nan")}, {"ring_floor": -1.0}, {"ring_floor": 1e308}]
)
def test_damaged_rings(change):
    wanted, decoded = wanted_and_decoded()
    with pytest.raises(ValueError, match="factors of rings that are no numbers"):
        Rings.read(Rings.of(wanted, 0.01).content(decoded) | change, SHAPE)
