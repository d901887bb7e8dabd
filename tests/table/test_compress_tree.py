"""The tree's blocks fill a table of any shape, once, and children their parents; the search for the step."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.table.compress import row_bounds, tree
from gonio.table.compress.frame import hold
from gonio.table.compress.metric import excess
from tests.table.tables import asymmetric, ggx, grid, make

pytestmark = pytest.mark.compiled

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
    fields = {
        name: getattr(table, name) for name in ("theta_i", "theta_r_edges", "delta_phi_edges", "channels")
    }
    decoded = tree.decode(content, {**fields, "row_albedo": table.row_albedo, "specular": table.specular})
    assert excess(table, decoded, bounds).max() <= 1.0


def test_a_step_that_holds_beyond_one_that_does_not_is_found():
    table = make(ggx(0.5, 0.9), grid(6, 10, 12))
    bounds = row_bounds(table, 0.01)

    def jumping(frame):
        # fails from .2 on, but for .24 to .27
        def decoded(step):
            error = 0.5 if step < 0.2 or 0.24 < step < 0.27 else 2.0
            return table.values * (1.0 + 0.01 * error)

        return decoded

    assert 0.24 < hold(table, bounds, jumping)[1] < 0.27
    assert hold(table, bounds, jumping, quick=True)[1] < 0.2
