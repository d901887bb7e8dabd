import numpy as np
import pytest

from microgeometry.errors import InputError
from microgeometry.grid import CIE_RANGE_NM
from microgeometry.indices import PAGES, refractive_index, tabulated_index
from microgeometry.materials.fresnel import MAX_CLEAR_K

METALS = {"Ag", "Al", "Au", "Cr", "Cu", "Fe", "Ni", "Pt", "Ti", "W"}
SEMICONDUCTORS = {"Ge", "Si"}


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


@pytest.mark.parametrize(
    ("name", "n_d", "tolerance"),
    [
        # n at 587.56 nm: SCHOTT's data sheet, and the papers' own tables or handbooks (Palik; CRC).
        ("BK7", 1.51680, 1e-5),
        ("SiO2", 1.45846, 1e-5),
        ("H2O", 1.33340, 1e-4),
        ("Al2O3", 1.76817, 1e-4),
        ("CaF2", 1.43384, 1e-4),
        ("MgF2", 1.37774, 1e-4),
        ("NaCl", 1.5443, 5e-4),
        ("Si3N4", 2.016, 2e-3),
        ("TiO2", 2.49, 0.05),
        ("ZnS", 2.368, 2e-3),
        ("diamond", 2.4175, 1e-3),
    ],
)
def test_dielectrics_by_plain_name(name, n_d, tolerance):
    assert refractive_index(name, 587.5618)[0] == pytest.approx(n_d, abs=tolerance)


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


def test_a_page_without_k():
    assert refractive_index("main/SiO2/Malitson", [587.5618])[1] == [0]


@pytest.mark.parametrize("name", sorted(PAGES))
def test_every_plain_name_covers_the_visible(name):
    _, k = refractive_index(name, np.linspace(*CIE_RANGE_NM, 61))
    if name in METALS:
        assert (k > 1).all()
    elif name not in SEMICONDUCTORS:
        assert (k <= MAX_CLEAR_K).all()


@pytest.mark.parametrize(
    ("name", "nm", "message"),
    [
        ("Au", 100, "no data at 100 nm, only from 187.9 to 1937 nm"),
        ("Au", 0.63, "0.63 nm"),
        ("Au", float("nan"), "nan nm"),
        ("au", 500, "did you mean 'Au'"),
        ("BK-7", 500, "did you mean 'BK7'"),
        ("Unobtainium", 500, "known are Ag, Al, Al2O3, Au, BK7"),
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


@pytest.fixture
def csv(tmp_path):
    def write(text):
        file = tmp_path / "n.csv"
        file.write_bytes(text.encode())
        return file

    return write


def test_csv_is_linear_between_its_rows(csv):
    file = csv("# gold, roughly\n\nwavelength_nm, n, k\n500, 0.8, 2.0\n# green\n600,0.2,3.0\r\n700,0.1,4\n")
    n, k = tabulated_index(file, [525, 500, 700, 650])
    assert n == pytest.approx([0.65, 0.8, 0.1, 0.15], rel=1e-12)
    assert k == pytest.approx([2.25, 2, 4, 3.5], rel=1e-12)


def test_csv_in_any_order_of_columns_and_in_micrometres(csv):
    n, k = tabulated_index(csv("n,wavelength_um\n1.5,0.405\n1.4,0.705\n"), [405, 555, 705])
    assert n == pytest.approx([1.5, 1.45, 1.4], rel=1e-12)
    assert k is None


def test_csv_saved_by_a_spreadsheet(csv):
    # With a byte-order mark, quotes and carriage returns.
    n, k = tabulated_index(csv('\ufeff"wavelength_nm","n","k"\r\n500,"1.5",0\r\n'), [500])
    assert (n, k) == ([1.5], [0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty; .*columns n"),
        ("wavelength_nm,n,k\n", "no row of numbers"),
        ("500,1.5\n600,1.5\n", "line 1: the columns are '500, 1.5'; a header line"),
        ("wavelength_nm,n,kappa\n500,1.5,0\n", "line 1: .*kappa"),
        ("wavelength_nm,n,n\n500,1.5,0\n", "line 1: .*header"),
        ("wavelength_nm,k\n500,0\n", "line 1: .*header line with n"),
        ("n\n1.5\n", "wavelength_nm or wavelength_um"),
        ("wavelength_nm,wavelength_um,n\n500,0.5,1.5\n", "in one column"),
        ("wavelength_nm,n\n500,1.5\n600\n", "line 3: '600'; 2 finite numbers"),
        ("wavelength_nm,n\n500,one\n", "line 2: .*finite numbers"),
        ("wavelength_nm,n\n500,nan\n", "line 2: .*finite numbers"),
        ("wavelength_nm,n\n600,1.5\n500,1.5\n", "increase from row to row"),
        ("wavelength_nm,n\n0,1.5\n500,1.5\n", "above 0"),
        ("wavelength_nm,n\n500,0\n600,1\n", "n must be above 0"),
        ("wavelength_nm,n,k\n500,1,0\n600,1,-1\n", "k .* at least 0"),
        ("wavelength_nm,n\n501,1.5\n600,1.5\n", "no data at 500 nm, only from 501 to 600 nm"),
        ("wavelength_um,n\n500,1.5\n600,1.5\n", "only from 500000 to 600000 nm"),
    ],
)
def test_bad_csv(csv, text, message):
    file = csv(text)
    with pytest.raises(InputError, match=message) as caught:
        tabulated_index(file, [500.0])
    assert str(caught.value).startswith(str(file))
    assert "\n" not in str(caught.value)


def test_csv_that_is_none(tmp_path):
    (tmp_path / "n.csv").write_bytes(b"\xff\xfe\x00n")
    with pytest.raises(InputError, match="not a text file"):
        tabulated_index(tmp_path / "n.csv", [500])
    with pytest.raises(InputError, match="cannot be read"):
        tabulated_index(tmp_path, [500])
