import numpy as np
import pytest
from scipy import integrate, stats

from microgeometry.errors import InputError
from tests.microgeometry.conftest import assert_drawn_from, chi_squared_p, z_score

# D with a gap, a shoulder and a kink: theta_deg, D.
TABLE = [(5, 0.0), (15, 3.0), (30, 3.0), (40, 0.0), (50, 0.0), (70, 1.5)]


def beckmann(theta, alpha):
    return np.exp(-((np.tan(theta) / alpha) ** 2)) / (np.pi * alpha**2 * np.cos(theta) ** 4)


def ggx(theta, alpha):
    return alpha**2 / (np.pi * (np.cos(theta) ** 2 * (alpha**2 - 1) + 1) ** 2)


def tabulated(theta, alpha):
    return np.interp(np.rad2deg(theta), *np.transpose(TABLE), left=0, right=0)


def inclinations(surface, seeds):
    """Inclination of one facet of each groove, a row for each seed."""
    angles = []
    for seed in seeds:
        tile = surface.realise(seed)
        normals, areas = tile.facets()
        # All have the same projected area, and what is asked for is a distribution by projected area.
        np.testing.assert_allclose(areas * normals[:, 2], tile.size[0] * tile.size[1] / 256, rtol=1e-6)
        angles.append(np.arccos(normals[:128:2, 2]))
    return np.array(angles)


@pytest.mark.parametrize("first_seed", [0, 1000, 2000])
@pytest.mark.parametrize(
    ("density", "alpha"),
    [(beckmann, 0.1), (beckmann, 0.5), (beckmann, 1.0), (ggx, 0.1), (ggx, 0.5), (tabulated, None)],
)
def test_measured_normals_follow_the_distribution(specimen_of, tmp_path, density, alpha, first_seed):
    keys = {"distribution": density.__name__, "alpha": alpha}
    if density is tabulated:
        np.savetxt(tmp_path / "d.csv", TABLE, delimiter=",", header="theta_deg,D")
        keys = {"distribution": "d.csv"}

    def projected_area(alpha):
        return lambda t: 2 * np.pi * density(t, alpha) * np.cos(t) * np.sin(t)

    if density is not tabulated:
        assert integrate.quad(projected_area(alpha), 0, np.pi / 2)[0] == pytest.approx(1, rel=1e-6)
    angles = inclinations(specimen_of("ndf", **keys).surface, range(first_seed, first_seed + 100))
    wrong = None if density is tabulated else projected_area(1.03 * alpha)
    assert_drawn_from(angles, projected_area(alpha), wrong, 0, np.pi / 2)


def test_all_azimuths_of_a_turned_specimen_make_up_the_distribution(specimen_of):
    # Slopes of Beckmann's D are normal along any axis, of variance alpha^2 / 2: turned about z, the grooves' are.
    # One groove of each tile: independent draws.
    surface = specimen_of("ndf", distribution="beckmann", alpha=0.4).surface
    tangents = np.tan(inclinations(surface, range(4000))[:, 0])
    turned = tangents * np.cos(np.random.default_rng(1).uniform(0, 2 * np.pi, len(tangents)))
    edges = np.linspace(-2, 2, 41)
    assert chi_squared_p(turned, edges, np.diff(stats.norm.cdf(edges, scale=0.4 / np.sqrt(2)))) > 1e-4
    assert chi_squared_p(turned, edges, np.diff(stats.norm.cdf(edges, scale=0.5 / np.sqrt(2)))) < 1e-4


def test_alpha_of_beckmann_is_the_meshs(specimen_of):
    surface = specimen_of("ndf", distribution="beckmann", alpha=0.5).surface
    squares = np.array([surface.realise(seed).statistics().alpha ** 2 for seed in range(100)])
    z, relative = z_score(squares, 0.25)
    assert z < 4
    assert relative < 0.01
    assert surface.realise(1).heights.tobytes() == surface.realise(1).heights.tobytes()
    assert surface.realise(1).heights.tobytes() != surface.realise(2).heights.tobytes()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, "distribution: missing"),
        ({"distribution": "ggx"}, "alpha: missing"),
        ({"distribution": "ggx", "alpha": 0}, "above 0 and at most 5"),
        ({"distribution": "GGX", "alpha": 1}, "must be 'beckmann', 'ggx' or a CSV file.*did you mean 'ggx'"),
        ({"distribution": "oren_nayar"}, "must be 'beckmann', 'ggx' or a CSV file"),
        ({"distribution": "good.csv", "alpha": 1}, "alpha = 1: the distribution 'good.csv' has none"),
    ],
)
def test_bad_keys(specimen_of, tmp_path, keys, message):
    (tmp_path / "good.csv").write_text("0,1\n10,0\n")
    with pytest.raises(InputError, match=message):
        specimen_of("ndf", **keys)


@pytest.mark.parametrize("head", ["", "theta_deg,D\n", "# measured\n\ntheta_deg, D\n", "\ufefftheta_deg,D\n"])
def test_header_of_a_file_may_be_there(tile_of, tmp_path, head):
    (tmp_path / "d.csv").write_text(head + "20,1\n21, 2\n", encoding="utf-8")
    slopes = np.rad2deg(np.arctan(np.abs(tile_of("ndf", distribution="d.csv").slopes()[0])))
    assert 20 <= slopes.min() < slopes.max() <= 21


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("theta,D\n0,1\n", "cannot be read"),
        ("D,theta_deg\n0,1\n1,1\n", "cannot be read"),
        ("", "at least two rows"),
        ("0,1\n", "at least two rows"),
        ("0,1,2\n1,1,2\n", "two finite numbers"),
        ("0,1\n1,nan\n", "two finite numbers"),
        ("0,1\n0,1\n", "must increase"),
        ("0,1\n91,1\n", "within 0 to 90"),
        ("0,1\n1,-1\n", "not be negative"),
        ("0,0\n1,0\n", "above 0 somewhere"),
    ],
)
def test_bad_files(specimen_of, tmp_path, text, message):
    (tmp_path / "d.csv").write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        specimen_of("ndf", distribution="d.csv")
    assert "\n" not in str(caught.value)
