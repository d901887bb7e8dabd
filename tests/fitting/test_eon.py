"""Energy-preserving Oren-Nayar: numbers worked by hand, exact energy, Lambert as a limit."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from fitting import Fit
from fitting.models import LOBES
from fitting.models.eon import missing
from microgeometry.errors import InputError

from .kit import albedo
from .materials import material, polar, terms

PI = math.pi


# r = 1: C1 = 1/2 - 2/(3 pi) = 0.2877934, C2 = 2/3 - 28/(15 pi) = 0.0724882, A = 1/(1 + C1) = 0.7765219,
# <E> = A (1 + C2) = 0.8328106. Along the normal E = A: f_ms = <E> (1 - A)^2/(1 - <E>)/pi
# = 0.8328106 x 0.0499425/0.1671894/pi = 0.2487755/pi.
@pytest.mark.parametrize(
    ("theta", "phi", "single"),
    [
        (0.0, 0.0, 0.7765219),
        # retro at 60: s = 1 - 1/4, over 1/2: 1 + 1.5
        (60.0, 0.0, 0.7765219 * 2.5),
        # mirror at 60: s = -1/2 - 1/4, not divided
        (60.0, 180.0, 0.7765219 * 0.25),
    ],
)
def test_single_scattering(theta: float, phi: float, single: float) -> None:
    assert terms("eon", polar(theta), polar(theta, phi), roughness=1.0)[0] == pytest.approx(
        single / PI, rel=1e-6
    )


def test_multiple_scattering() -> None:
    assert terms("eon", polar(0.0), polar(0.0), roughness=1.0)[1] == pytest.approx(0.2487755 / PI, rel=1e-6)
    assert missing(1.0) == pytest.approx(0.1671894, rel=1e-6)


def test_roughness_0_is_exactly_lambert() -> None:
    for wo in (polar(0.0), polar(89.999, 77.0)):
        assert terms("eon", polar(89.0), wo, roughness=0.0) == (1 / PI, 0.0)
    assert missing(0.0) == 0.0


@pytest.mark.compiled
@pytest.mark.parametrize("roughness", [0.2, 1.0])
def test_a_white_surface_loses_nothing(roughness: float) -> None:
    bounces = 1.0 / (1.0 - missing(roughness))
    for angle in (0.0, 45.0, 80.0, 89.0):
        assert albedo("eon", {"roughness": roughness}, angle, (1.0, bounces)) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.compiled
def test_mean_albedo_is_the_series_of_bounces() -> None:
    # diffuse light on rho = 1/2: <E> rho + rho^2 <E> (1 - <E>) + ..., in closed form <E> rho/(1 - rho (1 - <E>))
    rho, back = 0.5, missing(0.8)
    x, w = np.polynomial.legendre.leggauss(16)
    cosines = 0.5 * (x + 1.0)
    found = sum(
        weight * c * albedo("eon", {"roughness": 0.8}, math.degrees(math.acos(c)),
                            (rho, rho**2 / (1 - rho * back)), nodes=120)
        for weight, c in zip(w, cosines, strict=True)
    )  # fmt: skip
    assert found == pytest.approx(rho * (1 - back) / (1 - rho * back), rel=1e-4)


def test_albedo_enters_as_a_series_in_a_material() -> None:
    fit = material("eon", ("eon", {"roughness": 0.8}, {"rho": (0.9, 0.5, 0.0)}))
    rho = np.array([0.9, 0.5, 0.0])
    expected = [rho, rho**2 / (1 - missing(0.8) * rho)]
    assert fit.terms().weights == pytest.approx(np.array(expected))
    assert len(LOBES["eon"].coefficients) == 1


def test_an_albedo_whose_bounces_never_end_is_refused(tmp_path: Path) -> None:
    # r = 1: 1/0.1671894 = 5.981
    lobe = {"name": "eon", "parameters": {"roughness": 1.0}, "coefficients": {"rho": {"R": 6.0}}}
    (tmp_path / "fit.json").write_text(json.dumps({"model": "eon", "lobes": [lobe]}))
    with pytest.raises(InputError, match=r"rho\.R: 6\.0; less than 5\.981 is allowed"):
        Fit.load(tmp_path / "fit.json")
