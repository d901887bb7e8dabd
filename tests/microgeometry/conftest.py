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
    """Independent values follow a density between two limits, by chi^2 on coarse and on fine bins.

    A wrong density, 3 % off in its parameter, must fail the coarse one: 16 bins that hold equal shares.
    """
    fine = np.linspace(low, high, 20001)
    middle, width = 0.5 * (fine[1:] + fine[:-1]), fine[1] - fine[0]
    cdf = np.append(0.0, np.cumsum(density(middle))) * width
    assert chi_squared_p(values, fine[::400], np.diff(cdf[::400])) > 1e-4
    coarse = np.interp(np.linspace(0, cdf[-1], 17)[1:-1], cdf, fine)
    coarse = np.concatenate(([low], coarse, [high]))
    assert chi_squared_p(values, coarse, np.diff(np.interp(coarse, fine, cdf))) > 1e-4
    if wrong is not None:
        wrong_cdf = np.append(0.0, np.cumsum(wrong(middle)))
        assert chi_squared_p(values, coarse, np.diff(np.interp(coarse, fine, wrong_cdf))) < 1e-4


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
