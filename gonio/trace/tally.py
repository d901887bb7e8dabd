"""Tallies: batches in, mean and standard error out.

Light is told apart into sheets, by the hemisphere it leaves into and the number of its bounces:
sheet = hemisphere * orders + order. Hemisphere 0 is reflected, 1 transmitted; order n has bounced n + 1
times, the last order that often or more. A specimen that lets nothing through has one hemisphere, and a
trace that asks for no orders has one order: its only sheet is then its total.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.core.parallel import for_each
from gonio.trace.binning import LEDGER, LEDGER_COLUMNS, RAYS
from gonio.trace.sheets import RowCounts, SheetTally, Slots

Array = NDArray[np.float64]

_UNITS = 16  # in which rows are closed: enough to share, few enough to cost nothing


class Tally:
    """Running mean and variance of every cell over batches.

    A batch is one independent estimate: fresh random numbers, and for a random surface a fresh
    realisation. The scatter between batches therefore holds the noise of the rays and that of the
    realisations alike. Memory does not grow with the number of paths.

    Parameters
    ----------
    rows, cells, channels : int
        Rows of incidence, cells of one row and hemisphere, channels.
    chunks : int
        Units into which the tracer cuts a pass, each with an accumulator of its own.
    hemispheres : int
        1: reflected light only; 2: transmitted light as well.
    orders : int
        Numbers of bounces told apart: 1, 2, ..., orders - 1, and as many as `orders` or more.
    ledger_names : sequence of str
        Names of the ledger's columns from LEDGER_COLUMNS on, such as "absorbed: layer 1 surface". The
        columns before are those of `gonio.trace.binning`: LEDGER, then RAYS.
    joint : bool
        As in `gonio.trace.sheets.SheetTally`.

    Attributes
    ----------
    batches, rays : int
    rows : RowCounts
    totals : list of SheetTally
        All light of each hemisphere.
    orders : list of list of SheetTally
        For each hemisphere its orders, which add up to its total; empty where there is one only.
    ledger : dict of str to float
        Paths, LEDGER and `ledger_names`, in units of incident energy (mean over channels).
    """

    def __init__(
        self,
        rows: int,
        cells: int,
        channels: int,
        chunks: int,
        hemispheres: int = 1,
        orders: int = 1,
        ledger_names: Sequence[str] = (),
        joint: bool = False,
    ) -> None:
        self.batches = 0
        self.rays = 0
        self.rows = RowCounts(rows)
        self.ledger: dict[str, float] = dict.fromkeys(("paths", *LEDGER, *ledger_names), 0.0)
        # energies by the column of the ledger that holds them
        self._columns = dict(enumerate(LEDGER)) | dict(enumerate(ledger_names, LEDGER_COLUMNS))
        shape = rows, cells, channels
        self.totals = [SheetTally(self.rows, *shape, h * orders, orders, joint) for h in range(hemispheres)]
        self.orders: list[list[SheetTally]] = [
            [
                SheetTally(self.rows, *shape, h * orders + n, 1, joint)
                for n in range(orders if orders > 1 else 0)
            ]
            for h in range(hemispheres)
        ]
        sheets = hemispheres * orders
        self._cells, self._specular, self._energy, self._ledger = new_accumulators(
            rows, cells, channels, chunks, sheets, len(ledger_names)
        )

    @property
    def accumulators(self) -> tuple[Array, Array, Array, Array]:
        """Where a batch is summed, a slot and chunk for each unit of work.

        There are as many slots as rows, each for one pass of some row; the passes of row 0 take the first
        slots, then come those of row 1, and so on.

        Returns
        -------
        cells : ndarray, shape (slots, chunks, sheets, cells, channels + 1)
            Sums of weights, and in the last column the number of paths; without the delta term.
        specular : ndarray, shape (slots, chunks, sheets, channels)
            The delta term.
        energy : ndarray, shape (slots, chunks, sheets, channels)
            All energy of the sheet, the delta term included.
        ledger : ndarray, shape (slots, chunks, LEDGER_COLUMNS + len(ledger_names))
        """
        return self._cells, self._specular, self._energy, self._ledger

    def close_batch(self, passes: ArrayLike, paths_per_pass: int, threads: int | None = None) -> None:
        """Take the sums in the accumulators as one batch, and clear them.

        Parameters
        ----------
        passes : array_like of int, shape (rows,)
            Of each row; no more than there are rows in all.
        paths_per_pass : int
        threads : int, optional
        """
        passes = np.asarray(passes, np.int64)
        last = np.cumsum(passes)
        self.batches += 1
        rescale = self.rows.begin_batch(passes, paths_per_pass)
        rows = np.flatnonzero(passes)
        slots = Slots(rows, last[rows] - passes[rows], last[rows], 1.0 / (passes[rows] * paths_per_pass))
        # orders first: totals add up their sums
        sheets = [*self._order_sheets(), *self.totals]
        for sheet in sheets:
            for row in np.flatnonzero(rescale != 1.0):
                sheet.rescale(int(row), float(rescale[row]))
            sheet.add_energies(slots, self._specular, self._energy)
        units = min(len(rows), _UNITS)

        def close(unit: int) -> None:
            some = slots.part(unit * len(rows) // units, (unit + 1) * len(rows) // units)
            for sheet in sheets:
                sheet.add_cells(some, self._cells)
            self._cells[some.first, 0] = 0.0

        for_each(close, units, threads)
        ledger = self._ledger.sum(axis=(0, 1))
        self.ledger["paths"] += paths_per_pass * int(last[-1])
        for column, name in self._columns.items():
            self.ledger[name] += float(ledger[column])
        self.rays += int(ledger[RAYS])
        for sums in (self._specular, self._energy, self._ledger):
            sums[:] = 0.0

    def albedo_error(self) -> float:
        """Largest relative standard error of any row's albedo or transmittance; infinite before batch 2."""
        if self.batches < 2:
            return float("inf")
        worst = 0.0
        for sheet in self.totals:
            energy, error, _, _ = sheet.energies()
            relative = error / np.maximum(energy, 1e-300)
            worst = max(worst, float(np.max(relative, initial=0.0, where=energy > 0)))
        return worst

    def state(self) -> dict[str, NDArray]:
        """All that was learned so far, as arrays by name; not copies."""
        ledger = np.array([self.batches, self.rays, *self.ledger.values()], float)
        found: dict[str, NDArray] = {"ledger": ledger}
        for name, holder in self._holders():
            for field, array in vars(holder).items():
                if isinstance(array, np.ndarray):
                    found[f"{name}{field}"] = array
        return found

    def restore(self, state: dict[str, NDArray]) -> None:
        """Go on from a `state` of a tally with the same arguments.

        Raises
        ------
        ValueError
            An array is missing or of another shape.
        """
        own = self.state()
        for name, array in own.items():
            if name not in state or state[name].shape != array.shape or state[name].dtype != array.dtype:
                raise ValueError(f"{name}: {array.dtype} of shape {array.shape} is expected")
        for name, array in own.items():
            array[...] = state[name]
        batches, rays, *energies = state["ledger"].tolist()
        self.batches, self.rays = int(batches), int(rays)
        self.ledger = dict(zip(self.ledger, energies, strict=True))

    def _order_sheets(self) -> list[SheetTally]:
        return [sheet for hemisphere in self.orders for sheet in hemisphere]

    def _holders(self) -> Iterator[tuple[str, object]]:
        yield "rows.", self.rows
        for number, sheet in enumerate((*self._order_sheets(), *self.totals)):
            yield f"sheet{number}.", sheet


def new_accumulators(
    rows: int, cells: int, channels: int, chunks: int, sheets: int, names: int
) -> tuple[Array, Array, Array, Array]:
    """Empty `Tally.accumulators`; arguments as `Tally`, and the numbers of sheets and of ledger names."""
    return (
        np.zeros((rows, chunks, sheets, cells, channels + 1)),
        np.zeros((rows, chunks, sheets, channels)),
        np.zeros((rows, chunks, sheets, channels)),
        np.zeros((rows, chunks, LEDGER_COLUMNS + names)),
    )
