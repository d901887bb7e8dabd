"""The tree's blocks fill a table of any shape, once, and children their parents; rows that ask for more."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from gonio.formats.hdf5_content import stored_bytes
from gonio.table.compress import row_bounds, tree
from gonio.table.compress.frame import Frame
from gonio.table.compress.metric import excess
from gonio.table.compress.search import hold, suit_most
from tests.table.tables import asymmetric, ggx, grid, lambert, make

pytestmark = pytest.mark.compiled

FIELDS = ("theta_i", "theta_r_edges", "delta_phi_edges", "channels", "row_albedo", "specular")
SHAPES = [(1, 1, 1), (2, 3, 5), (1, 91, 181), (13, 73, 146), (7, 1, 64), (90, 90, 180), (5, 97, 400)]


@pytest.mark.parametrize("shape", SHAPES)
def test_every_cell_is_in_one_block_of_each_level(shape):
    levels = tree.levels_of((*shape, 3))
    parents = None
    for level in levels:
        owner = np.full(shape, -1)
        numbers = np.arange(np.prod(level.grid)).reshape(level.grid)
        for group in level.groups:
            cells = numbers[np.ix_(*group.at)][..., None, None, None]
            places = tree._places(group)
            assert np.all(owner[places] == -1)
            owner[places] = np.broadcast_to(cells, np.broadcast_shapes(cells.shape, owner[places].shape))
            assert all(1 <= b <= most for b, most in zip(group.block, tree._LARGEST, strict=True))
        # all cells, and no block without any
        assert len(np.unique(owner)) == owner.max() + 1 == np.prod(level.grid)
        if parents is not None:
            pairs = np.unique(np.stack([owner.ravel(), parents.ravel()]), axis=1)
            assert pairs.shape[1] == owner.max() + 1  # each in one parent
        parents = owner
    assert max(max(group.block) for group in levels[-1].groups) <= 4


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 3, 5), (7, 1, 64), (13, 29, 46)])
def test_decodes_what_it_encoded(shape):
    """To a bound at which a block out of place would show."""
    table = make(asymmetric, grid(*shape))
    bounds = np.full((shape[0], 3), 1e-5)
    content = tree.encode(table, bounds)
    decoded = tree.decode(content, {name: getattr(table, name) for name in FIELDS})
    assert excess(table, decoded, bounds).max() <= 1.0


def test_a_step_that_holds_beyond_one_that_does_not_is_found():
    table = make(lambert, grid(6, 10, 12))
    task = task_of(table, row_bounds(table, 0.01))
    assert 0.24 < hold(*task, lambda frame: between(table)) < 0.27
    assert hold(*task, lambda frame: between(table), quick=True) < 0.2


def task_of(table, bounds):
    return Frame.of_table(table, bounds), partial(excess, table, bounds=bounds)


def between(table):
    """Decodes within the bound at steps below .2 and from .24 to .27."""
    return lambda step: (
        table.values * (1 + (0.005 if step < 0.2 or 0.24 < step < 0.27 else 0.02) * UP_AND_DOWN)
    )


UP_AND_DOWN = (-1.0) ** np.arange(12)[:, None]
"""Along delta phi: an error that means of rings of equal cells do not show."""


def test_rows_that_ask_for_more_are_stored_more_finely():
    """Of errors that one row in the middle has three times those of the others."""
    table = make(lambert, grid(60, 10, 12))
    bounds = row_bounds(table, 0.01)
    before, over = task_of(table, bounds)
    rough = np.where(np.arange(60) == 30, 3.0, 1.0)[:, None, None, None]

    def prepare(frame):
        coarse = (frame.scale.values / before.scale.values)[:, None, None]
        return lambda step: table.values * (1 + 0.01 * rough * coarse * step * UP_AND_DOWN)

    step = hold(before, over, prepare)
    assert step == pytest.approx(1 / 3, rel=0.1)
    found = suit_most(before, over, prepare, step)
    assert found is not None
    assert found[1] == pytest.approx(1.0, rel=0.15)
    assert excess(table, prepare(found[0])(found[1]), bounds).max() <= 1.0
    granted = found[0].scale.values / before.scale.values
    assert np.all(granted[30] < 0.4)
    np.testing.assert_allclose(granted[np.abs(np.arange(60) - 30) > 20], 1.0, rtol=0.1)


def test_the_smaller_of_both_is_taken(monkeypatch):
    table = make(ggx(0.1, 0.9), grid(30, 30, 45))
    bounds = row_bounds(table, 0.01)
    both = stored_bytes(tree.encode(table, bounds))
    monkeypatch.setattr(tree, "suit_most", lambda *_: None)
    one = stored_bytes(tree.encode(table, bounds))
    assert both <= one
    monkeypatch.setattr(tree, "suit_most", lambda frame, over, prepare, step: (frame, step / 9))
    assert stored_bytes(tree.encode(table, bounds)) == one
