import numpy as np
import pytest

from microgeometry.errors import InputError
from tests.microgeometry.conftest import assert_closed, assert_height_field


@pytest.mark.parametrize("arrangement", ["hexagonal", "square", "random"])
def test_bosses_are_pits_turned_inside_out(tile_of, arrangement):
    keys = {"cover": 0.4, "arrangement": arrangement, "depth": 0.7, "segments": 24}
    boss, pit = tile_of("bosses", 3, **keys), tile_of("pits", 3, **keys)
    assert_closed(boss)
    assert_height_field(boss)
    assert boss.vertices[:, 2].min() == 0
    for name, value in vars(boss.statistics()).items():
        assert getattr(pit.statistics(), name) == pytest.approx(value, rel=1e-12), name


def test_normals_of_a_hemisphere_are_uniform_over_it(tile_of):
    # Archimedes: equal steps of n_z hold equal areas. Over the seeds facets have every inclination.
    shares = []
    for seed in range(40):
        tile = tile_of("bosses", seed, cover=0.3, arrangement="square")
        normals, areas = tile.facets()
        cap = (tile.vertices[tile.faces, 2] > 0).any(axis=1)
        bins = np.histogram(normals[cap, 2], bins=5, range=(0, 1), weights=areas[cap])[0]
        shares.append(bins / areas[cap].sum())
    std_error = np.std(shares, axis=0, ddof=1) / np.sqrt(40)
    assert (std_error < 0.005).all()
    assert (np.abs(np.mean(shares, axis=0) - 0.2) < 4 * std_error).all()


def test_bad_keys(specimen_of):
    with pytest.raises(InputError, match="cover: missing"):
        specimen_of("bosses")
