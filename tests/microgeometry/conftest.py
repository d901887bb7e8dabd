from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from microgeometry.specimen import Specimen, parse_specimen


@pytest.fixture
def topography_dir() -> Path:
    """Folder of real height maps, which are not part of the project."""
    beside = Path(__file__).resolve().parents[2].parent / "shared" / "data"
    folder = Path(os.environ.get("GONIO_TEST_DATA", beside)) / "topography"
    if not folder.is_dir():
        pytest.skip(f"no real height maps at {folder}; GONIO_TEST_DATA names the folder above")
    return folder


@pytest.fixture
def specimen_of(tmp_path):
    """Build a specimen from the keys of [surface], files relative to tmp_path."""

    def build(kind: str, folder: Path = tmp_path, **keys) -> Specimen:
        return parse_specimen({"surface": {"kind": kind, **keys}, "material": {"kind": "mirror"}}, folder)

    return build


@pytest.fixture
def tile_of(specimen_of):
    """Build a surface from its keys and realise it."""

    def build(kind: str, seed: int = 0, **keys):
        return specimen_of(kind, **keys).surface.realise(seed)

    return build


def z_score(values, expected):
    """Distance of the mean from its expected value in standard errors, and the relative standard error."""
    values = np.asarray(values)
    std_error = values.std(ddof=1) / np.sqrt(len(values))
    return abs(values.mean() - expected) / std_error, std_error / expected


def chi_squared_p(values, edges, shares):
    """Chance of a chi^2 as large as that of independent values against the shares expected between edges.

    From the left, bins are thrown together until 10 values are expected in each; the counts sum to the number
    of values, so there is one degree of freedom less than bins. A value where none can be gives 0.
    """
    counts = np.histogram(values, edges)[0]
    shares = np.asarray(shares) / np.sum(shares)
    if counts.sum() < len(values) or counts[shares == 0].any():
        return 0.0
    group, full = [], 0.0
    for expected in len(values) * shares:
        group.append(group[-1] + (full >= 10) if group else 0)
        full = expected if full >= 10 else full + expected
    group = np.array(group)
    if full < 10:
        group[group == group[-1]] -= 1
    expected, counts = np.bincount(group, len(values) * shares), np.bincount(group, counts)
    return stats.chi2.sf(np.sum((counts - expected) ** 2 / expected), len(counts) - 1)


def assert_drawn_from(values, density, wrong, low, high):
    """Rows of n values each are draws, one from each n-th part, from a density between two limits.

    Parameters
    ----------
    values : ndarray, shape (rows, n)
    density : callable
        Of an array; of any scale.
    wrong : callable or None
        A density 3 % off in its parameter, which must fail.
    """
    middle = low + (high - low) * (np.arange(200_000) + 0.5) / 200_000

    def places(density):
        """Where between 0 and 1 each value lies in its n-th part of the density."""
        cdf = np.append(0.0, np.cumsum(density(middle)))
        ranks = np.sort(np.interp(values, np.linspace(low, high, 200_001), cdf / cdf[-1]))
        return (ranks * values.shape[1] - np.arange(values.shape[1])).ravel()

    assert values.min() >= low
    assert values.max() <= high
    # No more than the rounding of the sums above outside its part. Within it, values are uniform, and
    # independent of all others: chi^2 on coarse and fine bins.
    right = places(density)
    assert np.abs(right - 0.5).max() < 0.51
    for n in (8, 100):
        assert chi_squared_p(np.clip(right, 0, 1), np.linspace(0, 1, n + 1), np.ones(n)) > 1e-4
    if wrong is not None:
        off = places(wrong)
        assert np.abs(off - 0.5).max() > 0.6
        assert chi_squared_p(np.clip(off, 0, 1), np.linspace(0, 1, 9), np.ones(8)) < 1e-4


def assert_closed(tile):
    """Every edge of a mesh has two faces that run along it in opposite senses, over the period, to the bit.

    A vertex is known by its coordinates alone, those on the far faces of the tile by their twins': a gap of
    one rounding error, or a vertex within an edge, fails. Nothing may stand out of the tile.
    """
    vertices = tile.vertices.copy()
    assert (vertices[:, :2] >= 0).all()
    assert (vertices[:, :2] <= tile.size).all()
    for axis in (0, 1):
        vertices[vertices[:, axis] == tile.size[axis], axis] = 0.0
    index = np.unique(vertices + 0.0, axis=0, return_inverse=True)[1].reshape(-1)
    starts, ends = tile.faces.ravel(), tile.faces[:, [1, 2, 0]].ravel()
    # Two points of the period may be joined by several edges, in different directions: the direction
    # belongs to the edge. Off any round number, so that rounding decides nothing.
    way = (tile.vertices[ends] - tile.vertices[starts])[:, :2] / tile.size
    there, back = (
        np.column_stack((index[p], index[q], np.round(1000 * sign * way + 0.123)))
        for p, q, sign in ((starts, ends, 1), (ends, starts, -1))
    )
    assert len(np.unique(there, axis=0)) == len(there)
    np.testing.assert_array_equal(np.unique(there, axis=0), np.unique(back, axis=0))


def assert_height_field(tile):
    """Nothing faces down, and the facets cover the tile's rectangle exactly once."""
    normals, areas = tile.facets()
    assert (normals[:, 2] > 0).all()
    np.testing.assert_allclose(
        areas @ normals / (tile.size[0] * tile.size[1]), (0, 0, 1), rtol=1e-12, atol=1e-9
    )
