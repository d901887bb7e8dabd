"""Shadowing and Fresnel terms of Cook-Torrance lobes: worked by hand, and against Mitsuba's numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fitting.models import LOBES
from fitting.models.dispatch import lobe_eval

from .kit import Kit, albedo
from .materials import polar, terms

PI = math.pi
METAL = {"eta": 0.2, "k": 3.4}


# In the mirror direction at 60 degrees, alpha = 0.5: f0 term = 4/pi G 31/32 (see test_lobes). 1 + Lambda is
# (1 + 1.322876)/2 = 1.161438 for GGX and 1.0131620 for Beckmann: separable G is its square's inverse, less
# than the correlated 1/(2 (1 + Lambda) - 1).
@pytest.mark.parametrize(("lobe", "one_way"), [("ggx", 1.161438), ("beckmann", 1.0131620)])
def test_separable_shadowing(lobe: str, one_way: float) -> None:
    first, second = terms(lobe + "_separable", polar(60.0), polar(60.0, 180.0), alpha=0.5)
    assert first == pytest.approx(4 / PI / one_way**2 * 31 / 32, rel=2e-6)
    assert second == pytest.approx(4 / PI / one_way**2 / 32, rel=2e-6)
    assert first < terms(lobe, polar(60.0), polar(60.0, 180.0), alpha=0.5)[0]


def test_v_cavities_of_ggx_facets() -> None:
    # retro-reflection at 60: G = 2 x 0.5 x 0.5/1 = 0.5, D = 0.25/(pi 0.8125^2), 4 cos cos = 1
    found = terms("ggx_v_cavity", polar(60.0), polar(60.0), alpha=0.5)[0]
    assert found == pytest.approx(0.5 * 0.25 / (PI * 0.66015625), rel=1e-12)


def test_dielectric_fresnel() -> None:
    # along the normal f = D/4 R, D = 4/pi, R = (0.5/2.5)^2
    along = terms("beckmann_dielectric", polar(0.0), polar(0.0), alpha=0.5, eta=1.5)
    assert along == pytest.approx((0.04 / PI, 0.0), rel=1e-12)
    # mirror at 60: cos t = sqrt(1 - 0.75/2.25) = 0.8164966; r_s = (0.5 - 1.2247449)/(0.5 + 1.2247449) =
    # -0.4202041, r_p = (0.75 - 0.8164966)/(0.75 + 0.8164966) = -0.0424493; R = (0.1765715 + 0.0018019)/2
    white = sum(terms("ggx", polar(60.0), polar(60.0, 180.0), alpha=0.5))
    found = terms("ggx_dielectric", polar(60.0), polar(60.0, 180.0), alpha=0.5, eta=1.5)[0]
    assert found == pytest.approx(white * 0.0891867, rel=2e-6)


def test_conductor_fresnel() -> None:
    # along the normal R = ((0.2 - 1)^2 + 3.4^2)/((0.2 + 1)^2 + 3.4^2) = 12.2/13
    found = terms("ggx_conductor", polar(0.0), polar(0.0), alpha=0.5, **METAL)
    assert found == pytest.approx((12.2 / 13 / PI, 0.0), rel=1e-12)
    # k = 0 is a dielectric
    pair = polar(50.0), polar(70.0, 160.0)
    assert terms("ggx_conductor", *pair, alpha=0.3, eta=1.5, k=0.0) == pytest.approx(
        terms("ggx_dielectric", *pair, alpha=0.3, eta=1.5), rel=1e-12
    )


# Mitsuba 3.9.1, scalar_rgb: roughconductor, eval/cos, eta 0.2, k 3.4. Its Beckmann masking is a rational fit
# (up to 0.5 % off here); it computes in single precision.
PAIRS = [
    (polar(30.0), polar(30.0, 180.0)),
    (polar(20.0, 10.0), polar(50.0, 200.0)),
    (polar(60.0), polar(40.0, 120.0)),
    (polar(75.0), polar(70.0, 170.0)),
    (polar(10.0), polar(10.0)),
]
MITSUBA = {
    ("beckmann", 0.2): (2.4882536, 0.54765065, 0.00072051547, 3.4270494, 0.94073960),
    ("beckmann", 0.5): (0.39812065, 0.42307339, 0.32221075, 2.2477584, 0.28916581),
    ("ggx", 0.2): (2.4718024, 0.42543657, 0.081544009, 2.3125053, 0.64752457),
    ("ggx", 0.5): (0.38234880, 0.30977472, 0.19342954, 1.0735152, 0.25802420),
}


@pytest.mark.parametrize(("distribution", "alpha"), MITSUBA, ids=str)
def test_mitsubas_rough_conductor(distribution: str, alpha: float) -> None:
    lobe = LOBES[f"{distribution}_separable_conductor"]
    p = lobe.pack({"alpha": alpha, **METAL})
    rel = 5e-3 if distribution == "beckmann" else 2e-6
    for (wi, wo), expected in zip(PAIRS, MITSUBA[distribution, alpha], strict=True):
        assert lobe_eval(lobe.kind, p, wi, wo) == pytest.approx(expected, rel=rel)


@pytest.mark.compiled
@pytest.mark.parametrize("d", ["beckmann", "ggx", "gtr"])
@pytest.mark.parametrize("g", ["", "_separable", "_v_cavity"])
def test_a_white_lobe_becomes_a_mirror(d: str, g: str) -> None:
    shape = {"alpha": 0.01, "gamma": 5.0} if d == "gtr" else {"alpha": 0.01}
    rng = np.random.default_rng(2)
    kit = Kit(d + g, shape, (1.0, 1.0))
    wi = [[-math.sin(0.5), 0.0, math.cos(0.5)]]
    wo, density = kit.sample(np.repeat(wi, 4000, axis=0), rng.random((4000, 3)))
    kept = density > 0
    weight = kit.eval(wi, wo[kept])[:, 0] * wo[kept, 2] / density[kept]
    assert weight.sum() / 4000 == pytest.approx(1.0, abs=0.02)


@pytest.mark.compiled
def test_correlated_heights_let_more_light_out_and_no_more_than_arrives() -> None:
    for angle in (0.0, 60.0, 85.0):
        separable = albedo("beckmann_separable", {"alpha": 1.0}, angle)
        assert separable <= albedo("beckmann", {"alpha": 1.0}, angle) + 1e-9 <= 1.0
