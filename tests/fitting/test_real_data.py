"""Measured materials: MERL's, decoded from published neural fits, RGL's, and a goniophotometer's."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from fitting import fit
from fitting.compare import fit_models
from gonio.table.table import Table

from .merl import fits_of, materials, measurements, medians, published

pytestmark = pytest.mark.compiled


# A reference search over all 100 materials found these medians of the relative error: Lambert .976,
# Ashikhmin-Shirley .200, Cook-Torrance .199, GGX .151. Single materials scatter about them.
@pytest.mark.parametrize("name", ["purple-paint", "alum-bronze"])
def test_measured_materials_fit_as_well_as_a_reference_search(real: Path, name: str) -> None:
    samples = measurements(real, name)
    error = {
        model: fit(samples, model).residuals["relative_ngan_l2"]
        for model in ("lambert", "ashikhmin_shirley", "cook_torrance_1982", "cook_torrance_ggx")
    }
    assert error["lambert"] > 0.9
    assert 0.05 < error["cook_torrance_ggx"] < 0.2
    assert error["cook_torrance_ggx"] < error["cook_torrance_1982"] < 0.25
    assert error["ashikhmin_shirley"] < 0.25


def test_a_fit_is_better_than_the_published_one_by_the_same_measure(real: Path) -> None:
    samples = measurements(real, "pink-felt")
    others = published(real, "pink-felt", samples)
    assert others["ngan_cooktorrance"]["relative_ngan_l2"] < 0.2
    for ours, theirs in (("cook_torrance_1982", "ngan_cooktorrance"), ("ward_duer", "ngan_wardduer")):
        best = fit(samples, ours).residuals["relative_ngan_l2"]
        assert best <= others[theirs]["relative_ngan_l2"]
    ours = fit(samples, "beckmann_v_cavity_dielectric+lambert", objective="low_log").residuals["low_log"]
    assert ours <= min(others[file]["low_log"] for file in ("low_cooktorrance_E1", "low_cooktorrance_E2"))


# Ngan's parameters stand for values without MERL's channel factors (1, 1.15, 1.66).
@pytest.mark.parametrize("name", ["pink-felt", "red-plastic", "blue-metallic-paint", "special-walnut-224"])
def test_published_roughness_of_broad_highlights_is_found_again(real: Path, name: str) -> None:
    text = (real / "merl_fits" / "fits" / "ngan_cooktorrance.fit").read_text()
    theirs = re.search(rf"^{name} = .*roughness = ([\d.]+)", text, re.MULTILINE)
    ours = fit(measurements(real, name), "cook_torrance_1982").lobes[0].parameters["alpha"]
    assert ours == pytest.approx(float(theirs[1]), rel=0.1)


def test_published_albedos_lack_the_channel_factors(real: Path) -> None:
    text = (real / "merl_fits" / "fits" / "ngan_cooktorrance.fit").read_text()
    ratios = []
    for name in ("dark-red-paint", "nylon", "pink-felt", "purple-paint", "teflon", "white-acrylic"):
        theirs = json.loads(
            re.search(rf"^{name} = Aggregate\(Lambertian\(albedo = (\[[^]]*\])", text, re.M)[1]
        )
        ours = (
            fit(measurements(real, name), "cook_torrance_1982", objective="low_log")
            .lobes[1]
            .coefficients["albedo"]
        )
        ratios.append(np.array(list(ours.values())) / theirs)
    assert np.median(ratios, axis=0) == pytest.approx([1.0, 1.15, 1.66], rel=0.06)


@pytest.mark.slow
def test_medians_over_the_hundred_materials(real: Path) -> None:
    found = {name: fits_of((real, name)) for name in materials(real)}
    of = {model: error for model, (error, _, _) in medians(found).items()}
    assert of["cook_torrance_ggx"] <= 0.151
    assert of["cook_torrance_1982"] <= 0.199
    assert of["ashikhmin_shirley"] <= 0.2
    for one, two in (
        ("cook_torrance_ggx", "ggx+ggx+lambert"),
        ("cook_torrance_1982", "beckmann_v_cavity+beckmann_v_cavity+lambert"),
        ("ward_duer", "ward_duer+ward_duer+lambert"),
    ):
        assert of[two] < of[one]


def test_rgl_and_goniophotometer_files(real: Path) -> None:
    paint = fit(Table.load(real / "rgl" / "cm_military_green_rgb.bsdf"), "cook_torrance_ggx")
    assert paint.residuals["relative_ngan_l2"] < 0.3
    black = fit_models(
        Table.load(real / "ualoft" / "AnoBlackEC2onAlum.bsdf"), ["lambert", "cook_torrance_ggx"]
    )
    assert black[0].model == "cook_torrance_ggx"
    assert black[0].residuals["relative_ngan_l2"] < 0.5 < black[1].residuals["relative_ngan_l2"]
