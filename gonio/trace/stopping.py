"""When a measurement is good enough, and which rows of incidence its next rays go to.

Whatever is decided depends on the tally alone, after batches whose numbers follow from it: not on time, nor on
who traced them. Rows that lack accuracy get the passes of those that do not, so a batch costs the same from
first to last, realisation included. What a row still lacks is judged by the row as a whole, on a few
occasions; its share of any one cell's luck is too small to bias it (tested).
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.trace.batch import MAX_PASSES
from gonio.trace.sheets import RowCounts, Sheet
from gonio.trace.tally import Tally
from microgeometry.errors import InputError

Array = NDArray[np.float64]

FIRST_ROUND = 32
"""Batches before the first decision."""
MIN_BATCHES = 30
"""Batches of a row below which no error is believed."""

_ALBEDO = 0.1  # part of the target the albedo must be known to
_ENERGY = 0.99  # of a row's light: the cells that hold it count, and what holds the rest does not
_PERCENTILE = 0.95  # of these cells have errors below the target
_MAX_VOV = 0.1  # MCNP's limit for the variance of the variance; 32 normal batches have 0.065
_CLEAR = 0.1  # part of the error allowed below which its variance is not asked for
_PATTERN = 8  # batches after which the passes of rows repeat: a row that needs 1.4 gets 1, 1, 2, 1, 2, ...
_KEPT = 16.0  # batches of a row's new size that its old ones must amount to; see `gonio.trace.sheets`


def check_target(target: float) -> float:
    """Return the relative standard error asked for.

    Raises
    ------
    InputError
        Not between 0 and 1.
    """
    if not 0.0 < target < 1.0:
        raise InputError(
            f"target_error: {target:g}; a relative standard error between 0 and 1 is needed, as 0.05"
        )
    return target


@dataclass(frozen=True)
class Verdict:
    """How well a measurement is known, row by row.

    Attributes
    ----------
    albedo : ndarray, shape (rows,)
        Relative standard error of the directional albedo; the worst of channels, and of the transmittance.
    cells : ndarray, shape (rows,)
        The same of the cells that hold 99 % of the row's light, at the 95th percentile.
    vov : ndarray, shape (2, rows)
        Variance of the variance, of albedo and cells; see `SheetTally.variance_of_variance`.
    batches : ndarray of int, shape (rows,)
    """

    albedo: Array
    cells: Array
    vov: Array
    batches: NDArray[np.int64]

    def lack(self, target: float) -> Array:
        """How many times its paths each row needs to meet the target, shape (rows,); 1 or less if it does."""
        part = self._part(target)
        batches = MIN_BATCHES / np.maximum(self.batches, 1)
        return np.maximum.reduce([*part**2, *self._doubt(part) / _MAX_VOV, batches])

    def _part(self, target: float) -> Array:
        """Errors in units of what is allowed, of albedo and cells, shape (2, rows)."""
        return np.stack([self.albedo / _ALBEDO, self.cells]) / target

    def _doubt(self, part: Array) -> Array:
        """Variance of the variance, where it matters: not of an error that might be ten times what it seems."""
        return np.where(part > _CLEAR, self.vov, 0.0)

    def met(self, target: float) -> bool:
        """Every row is known to the target."""
        return bool(np.all(self.lack(target) <= 1.0))

    def describe(self, target: float) -> str:
        """What was reached and what was asked, in the worst row."""
        words = (
            f"cells within {self.cells.max():.2%} of {target:.2%} (95th percentile, worst row), albedo within "
            f"{self.albedo.max():.3%} of {_ALBEDO * target:.3%}"
        )
        doubt = self._doubt(self._part(target)).max()
        if doubt > _MAX_VOV:
            words += f", variance of the variance {doubt:.2g} of {_MAX_VOV:g}"
        if np.any(self.batches < MIN_BATCHES):
            words += f", {self.batches.min()} batches of {MIN_BATCHES}"
        return words


def judge(
    totals: Sequence[Sheet], rows: RowCounts, projected_solid_angles: Array, peak: Array | None = None
) -> Verdict:
    """How well the light that left is known so far.

    Parameters
    ----------
    totals : sequence of Sheet
        All light of each hemisphere.
    rows : RowCounts
    projected_solid_angles : ndarray, shape (rings, sectors)
        Of the cells, in sr.
    peak : ndarray, shape (S, Q), optional
        Areas of the peak's cells, which follow the others and are judged with them: they hold the same light.
    """
    grids = [(projected_solid_angles, 0)]
    if peak is not None:
        grids.append((peak, projected_solid_angles.size))
    energies = [sheet.energies() for sheet in totals]
    energy = np.stack([e[0] for e in energies])  # (hemispheres, rows, channels)
    error = np.stack([e[1] for e in energies])
    specular = np.sum([e[2] for e in energies], axis=0)
    # light of a channel or hemisphere that holds next to nothing of the row's is not waited for
    bright = np.abs(energy.sum(axis=0)).max(axis=-1)
    counts = (np.abs(energy) > (1.0 - _ENERGY) * bright[:, None]) & (bright[:, None] > 0)
    albedo = np.max(np.where(counts, error, 0.0) / np.where(counts, np.abs(energy), 1.0), axis=(0, 2))
    cells = np.zeros(len(bright))
    for row in range(len(bright)):
        total = energy[:, row].sum(axis=0)
        channels = np.flatnonzero(np.abs(total) > (1.0 - _ENERGY) * bright[row])
        if len(channels):
            cells[row] = _cells_error(totals, row, grids, total, specular[row], channels)
    vov = np.max([sheet.variance_of_variance() for sheet in totals], axis=0)
    return Verdict(albedo, cells, np.where(bright > 0, vov, 0.0), rows.batches.copy())


def _cells_error(
    sheets: Sequence[Sheet],
    row: int,
    grids: Sequence[tuple[Array, int]],
    total: Array,
    specular: Array,
    channels: NDArray[np.intp],
) -> float:
    """95th percentile of the relative errors of a row's cells that hold its light, worst of the channels."""
    found = [
        [np.reshape(a * areas[..., None], (-1, len(total))) for a in sheet.row_cells(row, areas, first)]
        for sheet in sheets
        for areas, first in grids
    ]
    light, error = (np.concatenate(column) for column in zip(*found, strict=True))
    light = np.abs(light)
    worst = 0.0
    for channel in channels:
        order = np.argsort(-light[:, channel], kind="stable")
        sums = abs(specular[channel]) + np.cumsum(light[order, channel])
        if abs(specular[channel]) >= _ENERGY * abs(total[channel]):
            continue  # the delta term, whose error is the albedo's, holds it all
        held = order[: int(np.searchsorted(sums, _ENERGY * sums[-1])) + 1]
        held = held[light[held, channel] > 0]
        relative = error[held, channel] / light[held, channel]
        worst = max(worst, float(np.quantile(relative, _PERCENTILE, method="higher")))
    return worst


class Schedule:
    """Which rows the batches trace, and when they end.

    Parameters
    ----------
    rows : int
    paths_per_pass : int
    batches : int or None
        At most so many; None: until the target is met, or for ever.
    target : float or None
        Relative standard error asked for; None: all batches, every row one pass.

    Attributes
    ----------
    until : int
        Batches after which this round ends.
    goal : int
        Paths that the measurement is thought to need in all, where it ends by a target; 0: not known.
    over : bool
        Nothing is left to do.
    """

    def __init__(self, rows: int, paths_per_pass: int, batches: int | None, target: float | None) -> None:
        self._paths_per_pass = paths_per_pass
        self._batches = batches
        self._target = target
        # passes of the batches from `_begun` on, again and again
        self._plan: NDArray[np.int64] = np.ones((1, rows), np.int64)
        self._begun = 0
        last = sys.maxsize if batches is None else batches
        self.until = last if target is None else min(FIRST_ROUND, last)
        self.goal = 0
        self.over = False

    def passes(self, batch: int) -> NDArray[np.int64]:
        """Of each row in a batch of this round, shape (rows,)."""
        return self._plan[(batch - self._begun) % len(self._plan)]

    def advance(self, tally: Tally, verdict: Callable[[], Verdict]) -> None:
        """To be called after every batch: plans the next round where one has ended; asks for the verdict then."""
        if tally.batches < self.until or self.over:
            return
        if self._target is None or tally.batches == self._batches:
            self.over = True
            return
        lack = verdict().lack(self._target)
        if np.all(lack <= 1.0):
            self.over = True
            return
        paths = tally.rows.paths
        needed = np.ceil(paths * np.maximum(lack - 1.0, 0.0))
        self.goal = int(paths.sum() + needed.sum())
        full = len(paths) * self._paths_per_pass
        # errors of errors: look again before the paths have grown by half; but looking takes time as well
        fewest, most = max(1, tally.batches // 16), max(8, tally.batches // 2)
        length = int(np.clip(np.ceil(needed.sum() / full), fewest, most))
        if self._batches is not None:
            length = min(length, self._batches - tally.batches)
        self._begun, self.until = tally.batches, tally.batches + length
        self._plan = self._deal(needed / (self._paths_per_pass * length), min(length, _PATTERN), tally)

    def _deal(self, needed: Array, batches: int, tally: Tally) -> NDArray[np.int64]:
        """Passes of so many batches, for rows that would like `needed` of them in each; shape (batches, rows)."""
        rows = len(needed)
        most = np.minimum(tally.rows.paths / (self._paths_per_pass * _KEPT), np.ceil(needed))
        most = np.minimum(most, MAX_PASSES).astype(np.int64)
        ideal = needed * min(1.0, rows / needed.sum())
        plan = np.zeros((batches, rows), np.int64)
        for number, passes in enumerate(plan):
            due = np.maximum(ideal * (number + 1) - plan[:number].sum(axis=0), 0.0)
            passes[:] = np.minimum(np.floor(due), most)
            # the rest to those to whom most is due, where they may have more
            for row in np.argsort(passes - due, kind="stable"):
                more = min(1, int(most[row] - passes[row]), rows - int(passes.sum()))
                passes[row] += max(0, more)
        return plan

    def state(self) -> dict[str, NDArray]:
        """For `restore`."""
        numbers = [self._begun, self.until, self.goal, self.over]
        return {"plan": self._plan, "round": np.array(numbers, np.int64)}

    def restore(self, state: dict[str, NDArray]) -> None:
        """Go on from a `state` of a schedule with the same arguments."""
        self._plan = state["plan"].astype(np.int64)
        self._begun, self.until, self.goal, over = (int(n) for n in state["round"])
        self.over = bool(over)
