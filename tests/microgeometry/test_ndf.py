import itertools

import numpy as np
import pytest
from scipy import integrate, stats

from microgeometry.errors import InputError

# D with a gap, a shoulder and a kink: theta_deg, D.
TABLE = [(5, 0.0), (15, 3.0), (30, 3.0), (40, 0.0), (50, 0.0), (70, 1.5)]


def beckmann(theta, alpha):
    return np.exp(-((np.tan(theta) / alpha) ** 2)) / (np.pi * alpha**2 * np.cos(theta) ** 4)


def ggx(theta, alpha):
    return alpha**2 / (np.pi * (np.cos(theta) ** 2 * (alpha**2 - 1) + 1) ** 2)


def tabulated(theta, alpha):
    return np.interp(np.rad2deg(theta), *np.transpose(TABLE), left=0, right=0)


@pytest.mark.parametrize(
    ("density", "alpha"),
    [(beckmann, 0.1), (beckmann, 0.5), (beckmann, 1.0), (ggx, 0.1), (ggx, 0.5), (tabulated, None)],
)
def test_measured_normals_follow_the_distribution(specimen_of, tmp_path, density, alpha):
    # chi^2 of the grooves, each an independent draw, against the share of projected area D cos sin in 2 degrees.
    keys = {"distribution": density.__name__, "alpha": alpha}
    if density is tabulated:
        np.savetxt(tmp_path / "d.csv", TABLE, delimiter=",", header="theta_deg,D")
        keys = {"distribution": "d.csv"}
    surface = specimen_of("ndf", **keys).surface
    edges = np.deg2rad(np.arange(0, 91, 2))
    shares = np.array(
        [
            integrate.quad(lambda t: density(t, alpha) * np.cos(t) * np.sin(t), a, b)[0]
            for a, b in itertools.pairwise(edges)
        ]
    )
    if density is not tabulated:
        assert 2 * np.pi * shares.sum() == pytest.approx(1, rel=1e-6)
    counts = np.zeros(45)
    for seed in range(100):
        normals, areas = surface.realise(seed).facets()
        projected = areas * normals[:, 2]
        np.testing.assert_allclose(projected, projected[0], rtol=1e-6)
        # Four facets to a groove.
        counts += np.histogram(np.arccos(normals[:, 2]), edges)[0] / 4
    expected = 25600 * shares / shares.sum()
    assert counts[expected == 0].sum() == 0
    # Bins of fewer than 10 are thrown together.
    few = expected < 10
    observed = np.append(counts[~few], counts[few].sum())
    expected = np.append(expected[~few], expected[few].sum())
    good = expected > 1
    chi2 = np.sum((observed[good] - expected[good]) ** 2 / expected[good])
    assert stats.chi2.sf(chi2, np.count_nonzero(good) - 1) > 1e-4


def test_alpha_of_beckmann_is_the_meshs(specimen_of):
    surface = specimen_of("ndf", distribution="beckmann", alpha=0.5).surface
    squares = np.array([surface.realise(seed).statistics().alpha ** 2 for seed in range(100)])
    # tan^2 is exponential of mean alpha^2.
    assert abs(squares.mean() - 0.25) < 4 * 0.25 / np.sqrt(25600)
    assert surface.realise(1).heights.tobytes() == surface.realise(1).heights.tobytes()
    assert surface.realise(1).heights.tobytes() != surface.realise(2).heights.tobytes()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, "distribution: missing"),
        ({"distribution": "ggx"}, "alpha: missing"),
        ({"distribution": "ggx", "alpha": 0}, "above 0 and at most 5"),
        ({"distribution": "GGX", "alpha": 1}, "must be 'beckmann', 'ggx' or a CSV file"),
        ({"distribution": "good.csv", "alpha": 1}, "alpha = 1: a distribution from a file has none"),
    ],
)
def test_bad_keys(specimen_of, tmp_path, keys, message):
    (tmp_path / "good.csv").write_text("0,1\n10,0\n")
    with pytest.raises(InputError, match=message):
        specimen_of("ndf", **keys)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("theta,D\n0,1\n", "cannot be read"),
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
