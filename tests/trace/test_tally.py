"""Tallies of synthetic batches against numpy's mean and standard error, sheet by sheet."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from gonio.trace.analog import LEDGER, LEDGER_COLUMNS, RAYS
from gonio.trace.tally import Tally
from gonio.validation import seed_from

ROWS, CELLS, CHANNELS, BATCHES, PATHS = 3, 7, 2, 5, 100
OMEGA = np.linspace(0.1, 0.7, CELLS)
NAMES = ("absorbed: layer 1 surface", "absorbed: layer 2 medium")


def batches(chunks, sheets, dark=()):
    """What a tracer would leave in the accumulators, batch by batch; `dark` cells stay empty in all."""
    rng = np.random.default_rng(seed_from(f"tally {chunks} {sheets}"))
    for _ in range(BATCHES):
        cells = rng.random((ROWS, chunks, sheets, CELLS, CHANNELS + 1))
        cells[..., -1] = rng.integers(1, 5, cells.shape[:-1])
        cells[..., list(dark), :] = 0.0
        yield (
            cells,
            rng.random((ROWS, chunks, sheets, CHANNELS)),
            rng.random((ROWS, chunks, sheets, CHANNELS)),
            rng.random((ROWS, chunks, LEDGER_COLUMNS + len(NAMES))),
        )


def filled(chunks, hemispheres, orders, **options):
    """A tally of such batches, and the batches, stacked: four arrays with the batch as first axis."""
    tally = Tally(ROWS, CELLS, CHANNELS, chunks, hemispheres, orders, NAMES)
    given = list(batches(chunks, hemispheres * orders, **options))
    for batch in given:
        for accumulator, sums in zip(tally.accumulators, batch, strict=True):
            assert np.all(accumulator == 0)  # cleared by the batch before
            accumulator += sums
        tally.close_batch(PATHS, threads=2)
    return tally, [np.array(a) for a in zip(*given, strict=True)]


def assert_statistics(sheet, cells, specular, energy):
    """The sheet's numbers are numpy's; `cells`, `specular`, `energy` of shape (batches, rows, ...), summed."""
    estimates = cells[..., :-1] / PATHS / OMEGA[:, None]
    values, std_error = sheet.cells(OMEGA)
    np.testing.assert_allclose(values, estimates.mean(axis=0), rtol=1e-13)
    np.testing.assert_allclose(std_error, estimates.std(axis=0, ddof=1) / np.sqrt(BATCHES), rtol=1e-10)
    np.testing.assert_array_equal(sheet.hits, cells[..., -1].sum(axis=0))
    for (mean, error), sums in zip(
        (sheet.rows()[:2], sheet.rows()[2:]), (energy / PATHS, specular / PATHS), strict=True
    ):
        np.testing.assert_allclose(mean, sums.mean(axis=0), rtol=1e-13)
        np.testing.assert_allclose(error, sums.std(axis=0, ddof=1) / np.sqrt(BATCHES), rtol=1e-10)


@pytest.mark.parametrize("chunks", [1, 4])
@pytest.mark.parametrize(("hemispheres", "orders"), [(1, 1), (2, 1), (1, 3), (2, 3)])
def test_every_sheet_and_sum_has_the_mean_and_error_of_its_batches(chunks, hemispheres, orders):
    tally, (cells, specular, energy, _) = filled(chunks, hemispheres, orders)
    assert len(tally.totals) == len(tally.orders) == hemispheres
    cells, specular, energy = (a.sum(axis=2) for a in (cells, specular, energy))  # over chunks
    for h in range(hemispheres):
        mine = slice(h * orders, (h + 1) * orders)
        assert_statistics(tally.totals[h], *(a[:, :, mine].sum(axis=2) for a in (cells, specular, energy)))
        assert len(tally.orders[h]) == (orders if orders > 1 else 0)
        for n, sheet in enumerate(tally.orders[h]):
            assert_statistics(sheet, *(a[:, :, h * orders + n] for a in (cells, specular, energy)))


def test_orders_sum_to_the_total():
    tally, _ = filled(chunks=4, hemispheres=2, orders=3)
    for total, orders in zip(tally.totals, tally.orders, strict=True):
        assert sum(o.hits for o in orders) == pytest.approx(total.hits, abs=0)
        np.testing.assert_allclose(sum(o.cells(OMEGA)[0] for o in orders), total.cells(OMEGA)[0], rtol=1e-15)
        for quantity in (0, 2):
            np.testing.assert_allclose(
                sum(o.rows()[quantity] for o in orders), total.rows()[quantity], rtol=1e-15
            )


def test_ledger_by_name():
    tally, (*_, ledger) = filled(chunks=4, hemispheres=2, orders=3)
    columns = ledger.sum(axis=(0, 1, 2))
    assert list(tally.ledger) == ["paths", *LEDGER, *NAMES]
    assert tally.ledger["paths"] == BATCHES * PATHS * ROWS
    for column, name in [*enumerate(LEDGER), (6, NAMES[0]), (7, NAMES[1])]:
        assert tally.ledger[name] == pytest.approx(columns[column], rel=1e-13), name
    per_batch = ledger.sum(axis=(1, 2))[:, RAYS]
    assert tally.rays == sum(int(n) for n in per_batch)


def test_empty_cells_have_an_upper_bound_in_every_sheet():
    tally, _ = filled(chunks=4, hemispheres=2, orders=2, dark=[2])
    for sheet in (*tally.totals, *tally.orders[0], *tally.orders[1]):
        values, std_error = sheet.cells(OMEGA)
        assert np.all(values[:, 2] == 0)
        np.testing.assert_allclose(std_error[:, 2], 3 / (BATCHES * PATHS * OMEGA[2]), rtol=1e-15)
        assert np.all(std_error > 0)


def test_albedo_error_is_that_of_the_worse_hemisphere():
    tally, _ = filled(chunks=1, hemispheres=2, orders=1)
    worst = [np.max(error / energy) for energy, error, _, _ in (s.rows() for s in tally.totals)]
    assert tally.albedo_error() == pytest.approx(max(worst))
    assert Tally(ROWS, CELLS, CHANNELS, 1).albedo_error() == np.inf


def test_one_sheet_needs_no_second_tally_of_the_same():
    """A 1-degree RGB table: accumulators (C + 1), mean (C), variance (C), hits (1), and nothing more."""
    tracemalloc.start()
    try:
        tally = Tally(9, 16200, 3, 1)
        allocated, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert tally.orders == [[]]
    assert allocated < 1.01 * 8 * 9 * 16200 * (4 + 3 + 3 + 1)
