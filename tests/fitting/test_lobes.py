"""Numbers worked by hand from the papers."""

from __future__ import annotations

import math

import pytest

from .materials import polar, terms

PI = math.pi


def test_lambert_is_one_over_pi() -> None:
    assert terms("lambert", polar(10.0), polar(80.0, 70.0)) == (1 / PI, 0.0)


# sigma = 0.3, so sigma^2 = 0.09: C1 = 1 - 0.5 x 0.09/0.42 = 0.892857; 0.45 x 0.09/0.18 = 0.225 in C2;
# 0.125 x 0.09/0.18 = 0.0625 in C3; 0.17 x 0.09/0.22 = 0.0695455 in the interreflection.
# theta_i = theta_r = 60 degrees: alpha = beta = pi/3, 2 beta/pi = 2/3, tan 60 = 1.732051, sin 60 = 0.866025.
@pytest.mark.parametrize(
    ("delta_phi", "direct", "interreflection"),
    [
        # C2 tan = 0.225 x 0.866025 x 1.732051 = 0.3375; no C3; 1 - 4/9
        (0.0, 0.892857 + 0.3375, 0.0695455 * 5 / 9),
        # no C2; C3 = 0.0625 x (4/9)^2 = 0.0123457, times tan 60; no azimuth in the interreflection
        (90.0, 0.892857 + 0.0123457 * 1.732051, 0.0695455),
        # C2 = 0.225 (0.866025 - 8/27) = 0.128189, times -tan 60; 1 + 4/9
        (180.0, 0.892857 - 0.128189 * 1.732051, 0.0695455 * 13 / 9),
    ],
)
def test_oren_nayar(delta_phi: float, direct: float, interreflection: float) -> None:
    first, second = terms("oren_nayar", polar(60.0), polar(60.0, delta_phi), sigma=0.3)
    assert first == pytest.approx(direct / PI, rel=2e-6)
    assert second == pytest.approx(interreflection / PI, rel=2e-6)


@pytest.mark.parametrize("theta_o", [0.0, 45.0, 89.999])
def test_oren_nayar_of_a_smooth_surface_is_exactly_lambert(theta_o: float) -> None:
    for phi in (0.0, 77.0, 180.0):
        assert terms("oren_nayar", polar(89.0), polar(theta_o, phi), sigma=0.0) == (1 / PI, 0.0)


def test_oren_nayar_does_not_turn_negative() -> None:
    # sigma = 1, 80 degrees, mirror: C1 = 0.6241; C2 = 0.4128 (0.9848 - 0.7023) = 0.1166, x tan 80 = 0.661
    assert terms("oren_nayar", polar(80.0), polar(80.0, 180.0), sigma=1.0)[0] == 0.0


# Looking along the normal (wh = wi): D(0) = 1/(pi alpha^2) for both, G = 1, f = D/4, no grazing part.
@pytest.mark.parametrize("lobe", ["beckmann", "ggx", "beckmann_v_cavity"])
def test_microfacets_along_the_normal(lobe: str) -> None:
    first, second = terms(lobe, polar(0.0), polar(0.0), alpha=0.5)
    assert first == pytest.approx(1 / (4 * PI * 0.25), rel=1e-14)
    assert second == 0.0


# In the mirror direction at 60 degrees: wh = n, s = (1 - 0.5)^5 = 1/32, 4 cos cos = 1, so f = D(0) G F with
# alpha = 0.5: D(0) = 4/pi. alpha tan = 0.866025.
# GGX: 1 + Lambda_i + Lambda_o = sqrt(1 + 0.75) = 1.322876.
# Beckmann: a = 1/0.866025 = 1.154701; exp(-4/3)/(a sqrt pi) = 0.263597/2.046653 = 0.128794;
#   erfc(a) = 0.102470; Lambda = 0.0131620, twice 0.0263240.
# V-cavity: 2 x 1 x 0.5/0.5 = 2, so G = 1.
@pytest.mark.parametrize(
    ("lobe", "shadowing"), [("ggx", 1 / 1.322876), ("beckmann", 1 / 1.026324), ("beckmann_v_cavity", 1.0)]
)
def test_microfacets_in_the_mirror_direction(lobe: str, shadowing: float) -> None:
    first, second = terms(lobe, polar(60.0), polar(60.0, 180.0), alpha=0.5)
    assert first == pytest.approx(4 / PI * shadowing * 31 / 32, rel=2e-6)
    assert second == pytest.approx(4 / PI * shadowing / 32, rel=2e-6)


# Retro-reflection at 60 degrees: wh = wi, cos_h = 1/2, tan^2 = 3, s = 0, 4 cos cos = 1.
# GGX: D = 0.25/(pi (0.75 + 0.0625)^2); Beckmann: exp(-12)/(pi 0.25/16); V-cavity: G = 2 x 0.5 x 0.5/1 = 0.5.
@pytest.mark.parametrize(
    ("lobe", "expected"),
    [
        ("ggx", 0.25 / (PI * 0.66015625) / 1.322876),
        ("beckmann", 64 * math.exp(-12) / PI / 1.026324),
        ("beckmann_v_cavity", 64 * math.exp(-12) / PI * 0.5),
    ],
)
def test_microfacets_in_retro_reflection(lobe: str, expected: float) -> None:
    first, second = terms(lobe, polar(60.0), polar(60.0), alpha=0.5)
    assert first == pytest.approx(expected, rel=2e-6)
    assert second == pytest.approx(0.0, abs=1e-30)


@pytest.mark.parametrize(
    ("theta_o", "delta_phi", "expected"),
    [
        # mirror at 60: wh = n, wi.wh = 1/2, max(cos) = 1/2, s = 1/32
        (60.0, 180.0, (3 / (8 * PI) * 4 * 31 / 32, 3 / (8 * PI) * 4 / 32)),
        # retro: cos_h^2 = 1/4, wi.wh = 1, max(cos) = 1/2
        (60.0, 0.0, (3 / (8 * PI) * 0.25 * 2, 0.0)),
    ],
)
def test_ashikhmin_shirley(theta_o: float, delta_phi: float, expected: tuple[float, float]) -> None:
    found = terms("ashikhmin_shirley", polar(60.0), polar(theta_o, delta_phi), exponent=2.0)
    assert found == pytest.approx(expected, rel=1e-12, abs=1e-30)


def test_ashikhmin_shirley_diffuse() -> None:
    # normal: (1 - 1/32); 60 degrees: 1 - (3/4)^5 = 781/1024
    found = terms("ashikhmin_shirley_diffuse", polar(0.0), polar(60.0))
    assert found == pytest.approx((28 / (23 * PI) * 31 / 32 * 781 / 1024, 0.0), rel=1e-12)


# wi on the normal, wo at 60: cos_h^2 = 3/4, wi.wh = sqrt(3)/2, larger cosine 1; n_u = 2 along x, n_v = 4 along y
@pytest.mark.parametrize(("phi", "power"), [(0.0, 2.0), (90.0, 4.0), (45.0, 3.0)])
def test_ashikhmin_shirley_anisotropic(phi: float, power: float) -> None:
    cosine = math.sqrt(0.75)
    found = terms(
        "ashikhmin_shirley_anisotropic", polar(0.0), polar(60.0, phi), exponent_u=2.0, exponent_v=4.0
    )
    expected = math.sqrt(15.0) / (8 * PI) * cosine**power / cosine
    grazing = (1 - cosine) ** 5
    assert found == pytest.approx((expected * (1 - grazing), expected * grazing), rel=1e-12)


def test_oren_nayar_qualitative() -> None:
    # sigma = 0.3: A = 0.892857, B = 0.225; retro at 60: B sin tan = 0.225 x 1.5; elsewhere cos(delta phi) <= 0
    for phi, expected in ((0.0, 0.892857 + 0.3375), (90.0, 0.892857), (180.0, 0.892857)):
        found = terms("oren_nayar_qualitative", polar(60.0), polar(60.0, phi), sigma=0.3)
        assert found == pytest.approx((expected / PI, 0.0), rel=2e-6)
    # the larger angle's sine, the smaller one's tangent: 60 and 30 degrees
    found = terms("oren_nayar_qualitative", polar(30.0), polar(60.0), sigma=0.3)[0]
    assert found == pytest.approx((0.892857 + 0.225 * 0.8660254 * 0.5773503) / PI, rel=2e-6)
    assert terms("oren_nayar_qualitative", polar(80.0), polar(70.0), sigma=0.0) == (1 / PI, 0.0)
