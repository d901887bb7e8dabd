"""The modified Phong lobe: numbers worked by hand, energy."""

from __future__ import annotations

import math

import pytest

from .kit import albedo
from .materials import polar, terms

PI = math.pi


@pytest.mark.parametrize(
    ("theta_o", "phi", "expected"),
    [
        (60.0, 180.0, 2 / PI),  # mirror: (2 + 2)/(2 pi)
        (0.0, 0.0, 0.5 / PI),  # 60 degrees off: cos^2 = 1/4
        (60.0, 0.0, 0.0),  # 120 degrees off
        (60.0, 90.0, 0.125 / PI),  # cos = (0, .866, .5).(-.866, 0, .5) = 1/4
    ],
)
def test_by_hand(theta_o: float, phi: float, expected: float) -> None:
    found = terms("modified_phong", polar(60.0), polar(theta_o, phi), exponent=2.0)
    assert found == pytest.approx((expected, 0.0), rel=1e-12, abs=1e-15)


@pytest.mark.compiled
@pytest.mark.parametrize("exponent", [1.0, 20.0])
def test_energy_is_all_at_the_normal_and_never_more(exponent: float) -> None:
    assert albedo("modified_phong", {"exponent": exponent}, 0.0) == pytest.approx(1.0, abs=1e-5)
    for angle in (30.0, 60.0, 89.0):
        assert albedo("modified_phong", {"exponent": exponent}, angle) < 1.0
