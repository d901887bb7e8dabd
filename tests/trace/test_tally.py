"""Tallies of synthetic batches against numpy's mean and standard error, sheet by sheet."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from gonio.trace import sheets
from gonio.trace.binning import LEDGER, LEDGER_COLUMNS, RAYS
from gonio.trace.tally import Tally
from gonio.validation import seed_from

ROWS, CELLS, CHANNELS, BATCHES, PATHS = 3, 7, 2, 5, 100
OMEGA = np.linspace(0.1, 0.7, CELLS)
RING = OMEGA[None, :]  # all cells are sectors of one ring
NAMES = ("absorbed: layer 1 surface", "absorbed: layer 2 medium")


@pytest.fixture(autouse=True)
def _errors_are_the_scatter(monkeypatch):
    """What else goes into the error of a cell has tests of its own, in test_coverage."""
    monkeypatch.setattr(sheets, "cell_errors", lambda mean, variance, *_: np.sqrt(variance))


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
        tally.close_batch(np.ones(ROWS), PATHS, threads=2)
    return tally, [np.array(a) for a in zip(*given, strict=True)]


def assert_statistics(sheet, cells, specular, energy):
    """The sheet's numbers are numpy's; `cells`, `specular`, `energy` of shape (batches, rows, ...), summed."""
    estimates = cells[..., :-1] / PATHS / OMEGA[:, None]
    values, std_error = (a[:, 0] for a in sheet.cells(RING))
    np.testing.assert_allclose(values, estimates.mean(axis=0), rtol=1e-13)
    np.testing.assert_allclose(std_error, estimates.std(axis=0, ddof=1) / np.sqrt(BATCHES), rtol=1e-10)
    np.testing.assert_array_equal(sheet.hits, cells[..., -1].sum(axis=0))
    for (mean, error), sums in zip(
        (sheet.energies()[:2], sheet.energies()[2:]), (energy / PATHS, specular / PATHS), strict=True
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
        np.testing.assert_allclose(sum(o.cells(RING)[0] for o in orders), total.cells(RING)[0], rtol=1e-15)
        for quantity in (0, 2):
            np.testing.assert_allclose(
                sum(o.energies()[quantity] for o in orders), total.energies()[quantity], rtol=1e-15
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


def test_albedo_error_is_that_of_the_worse_hemisphere():
    tally, _ = filled(chunks=1, hemispheres=2, orders=1)
    worst = [np.max(error / energy) for energy, error, _, _ in (s.energies() for s in tally.totals)]
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


def uneven(plan, noise, rows=320, traced=80):
    """A tally of one cell and channel whose first rows have so many passes in each batch of the plan."""
    rng = np.random.default_rng(seed_from(f"uneven {plan} {noise}"))
    tally = Tally(rows, 1, 1, 1)
    totals = np.zeros(traced)
    for passes in plan:
        of_rows = np.where(np.arange(rows) < traced, passes, 0)
        cells, _, energy, _ = tally.accumulators
        if noise == "rays":
            sums = 10 * PATHS + rng.normal(size=(traced, passes))
        else:  # of the realisation: all passes of a batch share it
            sums = np.repeat(10 * PATHS + rng.normal(size=(traced, 1)), passes, axis=1)
        used = traced * passes
        cells[:used, 0, 0, 0] = np.stack([sums.ravel(), np.full(used, PATHS)], axis=1)
        energy[:used, 0, 0, 0] = sums.ravel()
        totals += sums.sum(axis=1)
        tally.close_batch(of_rows, PATHS)
    return tally, totals / (sum(plan) * PATHS)


@pytest.mark.parametrize("noise", ["rays", "realisations"])
@pytest.mark.parametrize(
    "plan", [[1] * 40 + [4] * 40 + [2] * 20, [3] * 64 + [1] * 64, [1] * 64 + [2, 4] * 16]
)
def test_rows_may_have_any_number_of_passes(plan, noise):
    """The mean is over paths; the variance claimed is on average the one between like rows."""
    tally, means = uneven(plan, noise)
    np.testing.assert_array_equal(tally.rows.paths[:80], sum(plan) * PATHS)
    np.testing.assert_array_equal(tally.rows.batches[:80], len(plan))
    assert not tally.rows.paths[80:].any()
    assert tally.ledger["paths"] == 80 * sum(plan) * PATHS
    values, std_error = (a[:80, 0, 0, 0] for a in tally.totals[0].cells(np.ones((1, 1))))
    energy, error, _, _ = (a[:80, 0] for a in tally.totals[0].energies())
    np.testing.assert_allclose(values, means, rtol=1e-12)
    np.testing.assert_allclose(energy, means, rtol=1e-12)
    np.testing.assert_allclose(error, std_error, rtol=1e-9)
    variance = 1 / PATHS**2
    if noise == "rays":
        expected = variance / sum(plan)
    else:
        expected = variance * sum(p**2 for p in plan) / sum(plan) ** 2
    # 80 rows of about 50 degrees of freedom; the old batches' part is right to one over their number
    assert np.mean(std_error**2) == pytest.approx(expected, rel=0.1)
    assert means.var(ddof=1) == pytest.approx(expected, rel=0.6)


def test_a_row_that_is_left_out_stays_as_it_was():
    tally, _ = filled(chunks=2, hemispheres=1, orders=2)
    before = [a[1].copy() for a in (*tally.totals[0].cells(RING), tally.totals[0].hits)]
    rng = np.random.default_rng(seed_from("left out"))
    for _ in range(3):
        cells = tally.accumulators[0]
        cells[:2] = rng.random(cells[:2].shape)
        tally.close_batch([1, 0, 1], PATHS)
        assert not any(a.any() for a in tally.accumulators)
    after = (*tally.totals[0].cells(RING), tally.totals[0].hits)
    for a, b in zip(before, after, strict=True):
        np.testing.assert_array_equal(a, b[1])
    np.testing.assert_array_equal(tally.rows.batches, [BATCHES + 3, BATCHES, BATCHES + 3])


def test_a_batch_larger_than_all_before_is_refused():
    tally = Tally(4, 1, 1, 1)
    for _ in range(2):
        tally.close_batch([1, 1, 1, 1], PATHS)
    with pytest.raises(ValueError, match="outgrow"):
        tally.close_batch([4, 0, 0, 0], PATHS)


def test_variance_of_variance():
    """Two over the number of batches where these are normal; near 1 where one of them makes up the variance."""
    rng = np.random.default_rng(seed_from("variance of variance"))
    sums = 100 + rng.normal(size=(200, 40))
    sums[-1, 17] += 100
    tally = Tally(200, 1, 1, 1)
    for batch in sums.T:
        cells, _, energy, _ = tally.accumulators
        cells[:, 0, 0, 0, 0], cells[:, 0, 0, 0, 1] = batch, 1
        energy[:, 0, 0, 0] = batch
        tally.close_batch(np.ones(200), PATHS)
    vov = tally.totals[0].variance_of_variance()
    for of in vov:  # the row's energy, and all its cells, here one
        assert of[:-1].mean() == pytest.approx(2 / 39, rel=0.15)
        assert of[-1] > 0.8
    assert not Tally(3, 1, 1, 1).totals[0].variance_of_variance().any()


def test_a_tally_goes_on_from_its_state():
    straight, _ = filled(chunks=2, hemispheres=2, orders=2)
    first = Tally(ROWS, CELLS, CHANNELS, 2, 2, 2, NAMES)
    second = Tally(ROWS, CELLS, CHANNELS, 2, 2, 2, NAMES)
    for number, batch in enumerate(batches(2, 4)):
        tally = first if number < 2 else second
        if number == 2:
            second.restore({name: array.copy() for name, array in first.state().items()})
        for accumulator, sums in zip(tally.accumulators, batch, strict=True):
            accumulator += sums
        tally.close_batch(np.ones(ROWS), PATHS)
    assert second.ledger == straight.ledger
    for name, array in straight.state().items():
        np.testing.assert_array_equal(array, second.state()[name], err_msg=name)
    with pytest.raises(ValueError, match="of shape"):
        Tally(ROWS + 1, CELLS, CHANNELS, 2, 2, 2, NAMES).restore(straight.state())
