"""Rough glass: Mitsuba's numbers, energy of both sides, reciprocity across the interface, the smooth limit."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fitting.models import LOBES
from fitting.models.dispatch import lobe_eval, lobe_pdf, lobe_sample

from .kit import Kit, albedo
from .materials import polar, terms

# (to the light, to the detector) and Mitsuba 3.9.1's roughdielectric, scalar_rgb, alpha 0.3, 1.5 below: eval/|cos|.
# Its Beckmann masking is a rational fit.
PAIRS = [
    (polar(30.0, 180.0), polar(30.0)),
    (polar(50.0, 200.0), polar(20.0, 10.0)),
    (polar(165.0, 180.0), polar(20.0)),
    (polar(140.0, 160.0), polar(60.0)),
    (polar(120.0, 250.0), polar(50.0, 20.0)),
    (polar(30.0, 180.0), polar(150.0)),
    (polar(140.0, 150.0), polar(130.0)),
]
MITSUBA = {
    "beckmann": (0.048952088, 0.031627112, 12.643926, 0.54897478, 0.0, 1.7841837, 0.90913970),
    "ggx": (0.048231292, 0.020938903, 11.576656, 0.61041182, 0.0036781861, 3.2256364, 0.59494298),
}


@pytest.mark.parametrize("facets", MITSUBA)
def test_mitsubas_rough_dielectric(facets: str) -> None:
    lobe = LOBES["walter_" + facets]
    p = lobe.pack({"alpha": 0.3, "eta": 1.5})
    rel = 1e-3 if facets == "beckmann" else 2e-6
    for (wi, wo), expected in zip(PAIRS, MITSUBA[facets], strict=True):
        assert lobe_eval(lobe.kind, p, wi, wo) == pytest.approx(expected, rel=rel, abs=1e-12)


@pytest.mark.compiled
@pytest.mark.parametrize("facets", ["beckmann", "ggx"])
@pytest.mark.parametrize(
    ("eta", "through", "below"),
    [(1.2, True, False), (2.0, True, False), (1.5, False, True), (1.5, True, True)],
)
def test_each_side_passes_the_validation_kit(facets: str, eta: float, through: bool, below: bool) -> None:
    kit = Kit("walter_" + facets, {"alpha": 0.3, "eta": eta}, through=through, below=below)
    report = kit.validate((0.0, 0.6, 1.2), 60_000)
    assert report.passed, "\n".join(report.lines())


@pytest.mark.parametrize("facets", ["beckmann", "ggx"])
def test_reciprocity_across_the_interface(facets: str) -> None:
    # f_s(i, o)/n_o^2 = f_s(o, i)/n_i^2 (Walter 2007, section 4.2)
    for wi, wo in PAIRS[2:6]:
        there = sum(terms("walter_" + facets, wi, wo, alpha=0.3, eta=1.5))
        back = sum(terms("walter_" + facets, wo, wi, alpha=0.3, eta=1.5))
        n2 = {True: 1.0, False: 2.25}
        assert there / n2[wo[2] > 0] == pytest.approx(back / n2[wi[2] > 0], rel=1e-9, abs=1e-300)


@pytest.mark.compiled
@pytest.mark.parametrize("facets", ["beckmann", "ggx"])
def test_energy_is_shared_by_reflection_and_transmission(facets: str) -> None:
    name = "walter_" + facets
    for angle, least in ((0.0, 0.97), (60.0, 0.9), (85.0, 0.75)):
        shape = {"alpha": 0.2, "eta": 1.5}
        total = albedo(name, shape, angle) + albedo(name, shape, angle, through=True)
        assert least < total <= 1.0


@pytest.mark.compiled
def test_smooth_glass_reflects_and_refracts_as_fresnel_and_snell_say() -> None:
    lobe = LOBES["walter_ggx"]
    p = lobe.pack({"alpha": 1e-3, "eta": 1.5})
    wi = polar(60.0, 180.0)
    # R(60) = 0.0891867, sin t = sin 60/1.5 (see test_cook_torrance)
    rng = np.random.default_rng(5)
    shares, directions = {True: 0.0, False: 0.0}, {True: [], False: []}
    for u0, u1 in rng.random((4000, 2)):
        wo = lobe_sample(lobe.kind, p, wi, u0, u1)
        weight = lobe_eval(lobe.kind, p, wi, wo) * abs(wo[2]) / lobe_pdf(lobe.kind, p, wi, wo)
        shares[wo[2] > 0] += weight / 4000
        directions[wo[2] > 0].append(wo)
    assert shares[True] == pytest.approx(0.0891867, rel=0.08)  # 4 sigma of the drawn share
    assert shares[True] + shares[False] == pytest.approx(1.0, abs=0.1)
    sine = math.sin(math.radians(60.0))
    assert np.median(directions[True], axis=0) == pytest.approx((sine, 0.0, 0.5), abs=1e-3)
    assert np.median(directions[False], axis=0)[0] == pytest.approx(sine / 1.5, abs=1e-3)


def test_total_reflection_from_below() -> None:
    # inside, 60 degrees is beyond the critical 41.8: a nearly flat interface lets nothing out
    found = terms("walter_beckmann", polar(120.0), polar(60.0, 180.0), alpha=1e-3, eta=1.5)
    assert found == (0.0, 0.0)
    mirror = terms("walter_beckmann", polar(120.0), polar(120.0, 180.0), alpha=1e-3, eta=1.5)
    assert mirror[0] == pytest.approx(
        sum(terms("beckmann_separable", polar(60.0), polar(60.0, 180.0), alpha=1e-3))
    )
