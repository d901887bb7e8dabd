"""Schlick's rational lobe: numbers worked by hand."""

from __future__ import annotations

import math

import pytest

from .materials import polar, terms

PI = math.pi


def test_along_the_normal() -> None:
    # r = 1/4: Z(1) = 1/r = 4, G = 1, nothing hidden: Z/(4 pi)
    assert terms("schlick", polar(0.0), polar(0.0), roughness=0.25) == pytest.approx((1 / PI, 0.0), rel=1e-12)


def test_retro_reflection() -> None:
    # 60 degrees: G/v = 1/(1/4 - 1/8 + 1/2) = 1.6, G = 0.8; t^2 = 1/4: Z = 0.25/0.8125^2 = 0.3786982
    expected = (1.6**2 * 0.3786982 / 4 + 1 - 0.64) / PI
    found = terms("schlick", polar(60.0), polar(60.0), roughness=0.25)
    assert found == pytest.approx((expected, 0.0), rel=1e-6, abs=1e-30)


def test_fresnel_splits_the_lobe() -> None:
    # mirror at 60: s = (1/2)^5; Z(1) = 4
    total = (1.6**2 * 4 / 4 + 1 - 0.64) / PI
    found = terms("schlick", polar(60.0), polar(60.0, 180.0), roughness=0.25)
    assert found == pytest.approx((total * 31 / 32, total / 32), rel=1e-12)


def test_roughness_1_is_flat_but_for_shadowing() -> None:
    # Z = 1, G(v) = v: 1/(4 pi) + (1 - v v')/pi
    found = sum(terms("schlick", polar(60.0), polar(0.0), roughness=1.0))
    assert found == pytest.approx((0.25 + 0.5) / PI, rel=1e-12)


# p = 1/4: A = sqrt(p/(p^2 - p^2 w^2 + w^2)) is sqrt(1/4) = 1/2 along x and sqrt(4) = 2 along y
@pytest.mark.parametrize(("phi", "factor"), [(0.0, 0.5), (90.0, 2.0)])
def test_isotropy(phi: float, factor: float) -> None:
    pair = polar(0.0), polar(60.0, phi)
    round_lobe = sum(terms("schlick", *pair, roughness=0.25))
    hidden = (1 - 0.8) / PI
    found = sum(terms("schlick_anisotropic", *pair, roughness=0.25, isotropy=0.25))
    assert found - hidden == pytest.approx(factor * (round_lobe - hidden), rel=1e-12)
    assert sum(terms("schlick_anisotropic", *pair, roughness=0.25, isotropy=1.0)) == pytest.approx(round_lobe)
