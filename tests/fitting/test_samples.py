"""Which cells of a table a fit looks at."""

from __future__ import annotations

import numpy as np

from fitting.samples import Samples
from gonio.table.checks.reciprocity import AVERAGED

from .materials import gold, grid


def test_of_two_cells_that_hold_the_same_light_one_is_looked_at() -> None:
    """A table averaged by reciprocity has every value twice: as two, they would halve the variances of a fit."""
    table = gold(0.4).table(grid(18, 18, 4))
    whole = Samples.of_table(table)
    said = {**table.provenance, AVERAGED: "averaged"}
    halved = Samples.of_table(table.replace(provenance=said))
    pairs = {tuple(cell) for cell in halved.cells.tolist()}
    assert len(pairs) == len(halved.cells) < len(whole.cells)
    for row, ring, sector in whole.cells.tolist():
        assert ((row, ring, sector) in pairs) + ((ring, row, sector) in pairs) == 1 + (row == ring)
    left = [n for reason, n in halved.left_out.items() if "repeats" in reason]
    assert left == [len(whole.cells) - len(halved.cells)]
    # neither half of the table weighs more
    row, ring, _ = halved.cells.T
    assert abs(np.mean(row < ring) - np.mean(row > ring)) < 0.1
