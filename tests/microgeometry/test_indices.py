import numpy as np
import pytest

from microgeometry.errors import InputError
from microgeometry.indices import PAGES, refractive_index


@pytest.mark.parametrize(
    ("name", "nm", "n", "k"),
    [
        # Johnson and Christy 1972 (2.01, 2.26, 2.63 eV), read off the database's table.
        ("Au", 616.8, 0.21, 3.272),
        ("Au", 548.6, 0.43, 2.455),
        ("main/Au/Johnson", 471.4, 1.31, 1.849),
        ("Ag", 616.8, 0.06, 4.152),
        ("Cu", 616.8, 0.30, 3.205),
        # Johnson and Christy 1974, likewise.
        ("Cr", 617.0, 3.17, 3.30),
        # Rakic 1995, likewise.
        ("Al", 516.60, 0.87340, 6.2418),
    ],
)
def test_published_points(name, nm, n, k):
    got_n, got_k = refractive_index(name, [nm])
    assert got_n[0] == pytest.approx(n, rel=1e-9)
    assert got_k[0] == pytest.approx(k, rel=1e-9)


def test_aluminium_reflects_as_aluminium_does():
    # Bare evaporated aluminium reflects 91.5 % at normal incidence in the green (CRC Handbook).
    n, k = refractive_index("Al", 550.0)
    assert n.shape == ()
    assert ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2) == pytest.approx(0.915, abs=0.01)


def test_interpolation_is_linear_and_keeps_the_order():
    # Midway between the tabulated 548.6 and 582.1 nm of gold.
    n, k = refractive_index("Au", [565.35, 548.6])
    assert n[0] == pytest.approx((0.43 + 0.29) / 2)
    assert k[0] == pytest.approx((2.455 + 2.863) / 2)
    assert n[1] == pytest.approx(0.43)


def test_glass_by_page():
    # SCHOTT's data sheet: N-BK7, n_d = 1.51680 at 587.6 nm.
    n, k = refractive_index("specs/SCHOTT-optical/N-BK7", [587.5618])
    assert n[0] == pytest.approx(1.51680, abs=1e-5)
    assert 0 <= k[0] < 1e-6
    # Malitson 1965, fused silica: 1.45846; the page has no k.
    n, k = refractive_index("main/SiO2/Malitson", [587.5618])
    assert n[0] == pytest.approx(1.45846, abs=1e-5)
    assert k[0] == 0


@pytest.mark.parametrize("name", sorted(PAGES))
def test_every_metal_covers_the_visible(name):
    n, k = refractive_index(name, np.linspace(380, 780, 41))
    assert (n > 0).all()
    assert (k > 1).all()


@pytest.mark.parametrize(
    ("name", "nm", "message"),
    [
        ("Au", 100, "no data at 100 nm, only from 187.9 to 1937 nm"),
        ("Au", 0.63, "0.63 nm"),
        ("Au", float("nan"), "nan nm"),
        ("au", 500, "did you mean 'Au'"),
        ("Unobtainium", 500, "known are Ag, Al, Au, Cr, Cu"),
        ("main/Au/Jonson", 500, "did you mean 'main/Au/Johnson'"),
        ("mian/Au/Johnson", 500, "did you mean 'main/Au/Johnson'"),
        ("../../Au/Johnson", 500, "unknown name"),
    ],
)
def test_bad_names_and_wavelengths(name, nm, message):
    with pytest.raises(InputError, match=message) as caught:
        refractive_index(name, [nm])
    assert repr(name) in str(caught.value)
    assert "\n" not in str(caught.value)
