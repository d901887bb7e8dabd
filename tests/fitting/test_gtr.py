"""Generalised Trowbridge-Reitz facets: numbers worked by hand, GGX as a case, Smith's integral done again."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import integrate

from fitting.models import LOBES
from fitting.models.gtr import gtr, hidden

from .materials import polar, terms

PI = math.pi


# Along the normal f = D/4, D = c/alpha^(2 gamma), alpha = 1/2.
# gamma = 1: c = (alpha^2 - 1)/(pi ln alpha^2) = 0.75/(1.3862944 pi) = 0.5410106/pi; D = 4 c.
# gamma = 3: c = 2 (-0.75)/(pi (1 - 16)) = 0.1/pi; D = 64 c.
@pytest.mark.parametrize(("gamma", "expected"), [(1.0, 0.5410106 / PI), (3.0, 1.6 / PI)])
def test_along_the_normal(gamma: float, expected: float) -> None:
    found = terms("gtr", polar(0.0), polar(0.0), alpha=0.5, gamma=gamma)
    assert found == pytest.approx((expected, 0.0), rel=1e-6)


@pytest.mark.parametrize("shadowing", ["", "_separable", "_v_cavity"])
@pytest.mark.parametrize("alpha", [0.01, 0.3, 1.0])
def test_gamma_2_is_ggx(shadowing: str, alpha: float) -> None:
    for wi, wo in ((polar(20.0), polar(50.0, 170.0)), (polar(80.0), polar(75.0, 178.0)), (polar(89.0),) * 2):
        found = terms("gtr" + shadowing, wi, wo, alpha=alpha, gamma=2.0)
        assert found == pytest.approx(terms("ggx" + shadowing, wi, wo, alpha=alpha), rel=3e-5, abs=1e-300)


@pytest.mark.parametrize(
    ("fresnel", "index"), [("_dielectric", {"eta": 1.5}), ("_conductor", {"eta": 0.2, "k": 3.4})]
)
def test_index_stands_after_gamma(fresnel: str, index: dict[str, float]) -> None:
    pair = polar(50.0), polar(65.0, 170.0)
    found = terms("gtr" + fresnel, *pair, alpha=0.3, gamma=2.0, **index)
    assert found == pytest.approx(terms("ggx" + fresnel, *pair, alpha=0.3, **index), rel=3e-5)


def test_gamma_1_and_alpha_1_are_limits() -> None:
    wi, wo = polar(30.0), polar(60.0, 150.0)
    one = terms("gtr", wi, wo, alpha=0.2, gamma=1.0)
    assert terms("gtr", wi, wo, alpha=0.2, gamma=1.0 + 1e-7) == pytest.approx(one, rel=1e-5)
    # at alpha = 1 normals are uniform whatever gamma: D = 1/pi
    p = LOBES["gtr"].pack({"alpha": 1.0, "gamma": 5.0})
    assert gtr(p, polar(77.0)) == pytest.approx(1 / PI, rel=1e-12)


@pytest.mark.parametrize("gamma", [1.0, 1.4, 4.0, 10.0])
@pytest.mark.parametrize("alpha", [1e-3, 0.1, 0.6])
def test_facets_cover_the_plane_and_hide_what_smith_says(alpha: float, gamma: float) -> None:
    p = LOBES["gtr"].pack({"alpha": alpha, "gamma": gamma})

    def along(log_tan: float, theta: float) -> tuple[float, float]:
        """Integrands over log tan of the normals' angle: D cos, and D max(0, -w.m), azimuth by a mean."""
        t = math.exp(log_tan)
        c = 1.0 / math.sqrt(1.0 + t * t)
        measure = 2.0 * PI * t * c * t * c * c * gtr(p, (t * c, 0.0, c))
        phi = (np.arange(4000) + 0.5) * (PI / 4000)
        facing = math.cos(theta) * c + math.sin(theta) * t * c * np.cos(phi)
        return measure * c, measure * float(np.maximum(0.0, -facing).mean())

    covered = integrate.quad(lambda x: along(x, 0.0)[0], -25.0, 12.0, limit=200, points=[math.log(alpha)])[0]
    assert covered == pytest.approx(1.0, abs=1e-6)
    for theta in (math.radians(89.9), math.radians(80.0), 0.7):
        start = math.log(1.0 / math.tan(theta))
        integral = integrate.quad(lambda x, t=theta: along(x, t)[1], start, start + 20.0, limit=100)[0]
        visible = math.cos(theta) + integral
        assert hidden(p, math.cos(theta)) == pytest.approx(integral, abs=3e-4 * visible)


def test_tails_are_as_heavy_as_gamma_says() -> None:
    # far from the normal D goes as (sin^2)^-gamma: from 30 to 60 degrees (3)^-gamma for a narrow lobe
    for gamma in (1.0, 1.5, 3.0):
        p = LOBES["gtr"].pack({"alpha": 1e-3, "gamma": gamma})
        assert gtr(p, polar(60.0)) / gtr(p, polar(30.0)) == pytest.approx(3.0**-gamma, rel=1e-4)
