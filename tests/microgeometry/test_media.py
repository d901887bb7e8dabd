from math import inf, pi

import numpy as np
import pytest

from microgeometry.errors import InputError
from microgeometry.media import HenyeyGreenstein, Isotropic, Medium, Rayleigh, TabulatedPhase
from microgeometry.specimen import parse_specimen


@pytest.fixture
def medium_of(tmp_path):
    """Build the medium of a half-space from its keys."""

    def build(grid=None, **keys):
        tables = {"surface": {"kind": "flat"}, "material": {"kind": "none"}, "grid": grid or {}}
        return parse_specimen({**tables, "medium": {"thickness": inf, **keys}}, tmp_path).layers[0].medium

    return build


def slab(**keys):
    layer = {"surface": {"kind": "flat"}, "material": {"kind": "none"}}
    base = {"surface": {"kind": "flat"}, "material": {"kind": "black"}}
    return parse_specimen({"layer": [{**layer, "medium": keys}, base]}).layers[0].medium


def test_lengths_are_metres():
    for units, metre in (("m", 1), ("mm", 1e-3), ("um", 1e-6), ("nm", 1e-9)):
        medium = slab(sigma_a=0.1, sigma_s=2, thickness=10, units=units)
        assert medium.sigma_a == pytest.approx((0.1 / metre,), rel=1e-14)
        assert medium.sigma_s == pytest.approx((2 / metre,), rel=1e-14)
        assert medium.thickness == pytest.approx(10 * metre, rel=1e-14)
    assert slab(sigma_a=1, thickness=1) == slab(sigma_a=1, thickness=1, units="um")


def test_defaults_are_a_clear_isotropic_space():
    assert slab(thickness=1, units="m") == Medium((0.0,), (0.0,), Isotropic(), 1.0)


def test_one_number_or_one_per_channel(medium_of):
    grid = {"wavelengths_nm": [400, 500]}
    medium = medium_of(grid, sigma_a=[0, 1], sigma_s=3, units="m")
    assert (medium.sigma_a, medium.sigma_s) == ((0.0, 1.0), (3.0, 3.0))
    assert medium.thickness == inf


def test_phase_functions_with_a_formula(medium_of):
    assert medium_of(sigma_s=1, phase="isotropic").phase == Isotropic()
    assert medium_of(sigma_s=1, phase="hg", g=-0.9).phase == HenyeyGreenstein(-0.9)
    assert medium_of(sigma_s=1, phase="rayleigh").phase == Rayleigh()


def test_tabulated_phase(medium_of, tmp_path):
    # Forward hemisphere 3, backward 1, with a straight line in the cosine between 60 and 120 degrees:
    # the integral over the cosine is 0.5 * 3 + 1 * 2 + 0.5 * 1 = 4.
    (tmp_path / "phase.csv").write_text("# two halves\ntheta_deg, value\n0,3\n60,3\n120,1\n180,1\n")
    phase = medium_of(sigma_s=1, phase="table", file="phase.csv").phase
    assert phase.cosines == pytest.approx((-1, -0.5, 0.5, 1), abs=1e-15)
    assert (phase.cosines[0], phase.cosines[-1]) == (-1.0, 1.0)
    assert phase.values == pytest.approx(np.array((1, 1, 3, 3)) / (8 * pi), rel=1e-14)


def test_any_scale_of_a_table_is_the_same(tmp_path):
    for scale in (1e-300, 1, 1e308):
        file = tmp_path / f"{scale}.csv"
        file.write_text(f"value,theta_deg\n{scale},0\n0,90\n{scale},180\n")
        phase = TabulatedPhase.read(file)
        assert phase.values == pytest.approx((1 / (2 * pi), 0, 1 / (2 * pi)), rel=1e-12)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"sigma_a": -0.1}, r"\[medium\] sigma_a = -0.1: .*at least 0"),
        ({"sigma_s": -0.1}, "sigma_s = -0.1: .*at least 0"),
        ({"sigma_s": inf}, "finite number"),
        ({"sigma_s": [1, 2]}, "2 values for 1 channel"),
        ({"sigma_s": "much"}, "finite number"),
        ({"sigma_t": 1}, "sigma_t = 1: unknown key .did you mean 'sigma_"),
        ({"sigma_s": 1, "thickness": 0}, "thickness = 0: .*above 0, or inf"),
        ({"sigma_s": 1, "thickness": -inf}, "thickness = -inf: .*above 0, or inf"),
        ({"sigma_s": 1, "thickness": "inf"}, "thickness = 'inf': .*above 0, or inf"),
        ({"sigma_s": 1, "units": "cm"}, "must be one of 'm', 'mm', 'um', 'nm'"),
        ({"phase": "mie"}, "must be one of 'isotropic', 'hg', 'rayleigh', 'table'"),
        ({"phase": "hg"}, "g: missing"),
        ({"phase": "hg", "g": 1}, "g = 1: .*above -1 and below 1"),
        ({"phase": "hg", "g": -1}, "g = -1: .*above -1 and below 1"),
        ({"phase": "rayleigh", "g": 0.5}, 'g = 0.5: only with phase = "hg"'),
        ({"g": 0.5}, 'only with phase = "hg"'),
        ({"phase": "hg", "g": 0, "file": "x.csv"}, 'only with phase = "table"'),
        ({"phase": "table"}, "file: missing"),
        ({"phase": "table", "file": "none.csv"}, "there is no file"),
    ],
)
def test_bad_media(medium_of, keys, message):
    with pytest.raises(InputError, match=message) as caught:
        medium_of(**keys)
    assert "\n" not in str(caught.value)


def test_thickness_is_required():
    with pytest.raises(InputError, match=r"\[layer 1 medium\] thickness: missing"):
        slab(sigma_a=1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("theta_deg,value\n0,1\n90,1\n", "from 0 to 180"),
        ("theta_deg,value\n1,1\n180,1\n", "from 0 to 180"),
        ("theta_deg,value\n180,1\n0,1\n", "increase from row to row"),
        ("theta_deg,value\n0,1\n90,1\n90,2\n180,1\n", "increase from row to row"),
        ("theta_deg,value\n0,1\n1e-9,1\n180,1\n", "increase from row to row"),
        ("theta_deg,value\n0,1\n90,-1\n180,1\n", "must not be negative"),
        ("theta_deg,value\n0,0\n180,0\n", "above 0 somewhere"),
        ("theta_deg,p\n0,1\n180,1\n", "header line with theta_deg, value"),
    ],
)
def test_bad_tables_of_a_phase_function(tmp_path, text, message):
    file = tmp_path / "phase.csv"
    file.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        TabulatedPhase.read(file)
    assert str(caught.value).startswith(str(file))
