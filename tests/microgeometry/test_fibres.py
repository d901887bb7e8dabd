import numpy as np
import pytest

from microgeometry.errors import InputError
from tests.microgeometry.conftest import assert_closed, assert_height_field


@pytest.mark.parametrize("segments", [8, 64])
def test_surface_is_closed_and_covers_the_tile_once(tile_of, segments):
    for seed in range(5):
        tile = tile_of("fibres", seed, segments=segments)
        assert_closed(tile)
        assert_height_field(tile)


def test_fibre_is_round(tile_of):
    tile = tile_of("fibres", radius=3, units="nm")
    assert tile.size == pytest.approx((6e-9, 6e-9))
    x, _, z = tile.vertices.T
    np.testing.assert_allclose(np.hypot(x - 3e-9, z), 3e-9, rtol=1e-12)
    assert (z >= 0).all()
    stats = tile.statistics()
    assert stats.n_facets == 2 * 65
    # Half a circle over its diameter, pi / 2; each chord is (pi / 64)^2 / 24 shorter than its arc.
    assert stats.area_ratio == pytest.approx(np.pi / 2 * (1 - (np.pi / 64) ** 2 / 24), rel=3e-6)
    assert stats.peak_to_valley == pytest.approx(3e-9, rel=(np.pi / 64) ** 2 / 8)


def test_facets_take_every_inclination(tile_of):
    # Equal angles hold equal areas: in ten bins of 18 degrees a tenth each, over the seeds.
    shares = []
    for seed in range(40):
        normals, areas = tile_of("fibres", seed).facets()
        assert np.abs(normals[:, 1]).max() < 1e-12
        angles = np.arctan2(normals[:, 2], normals[:, 0])
        shares.append(np.histogram(angles, 10, (0, np.pi), weights=areas)[0] / areas.sum())
    std_error = np.std(shares, axis=0, ddof=1) / np.sqrt(40)
    assert (std_error < 0.002).all()
    assert (np.abs(np.mean(shares, axis=0) - 0.1) < 4 * std_error + 1e-6).all()


def test_seed_is_the_realisation(specimen_of):
    surface = specimen_of("fibres").surface
    first, again, other = (surface.realise(seed).vertices for seed in (7, 7, 8))
    assert first.tobytes() == again.tobytes() != other.tobytes()


@pytest.mark.parametrize(
    ("keys", "message"),
    [({"radius": 0}, "above 0"), ({"segments": 7}, "at least 8"), ({"size": 1}, "unknown key")],
)
def test_bad_keys(specimen_of, keys, message):
    with pytest.raises(InputError, match=message):
        specimen_of("fibres", **keys)
