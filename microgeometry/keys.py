"""Reading one TOML table key by key, with one line of error for a bad one."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from microgeometry.errors import InputError

METRES = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9}
"""Length units a specimen may be given in, and what they are in metres."""


def suggest(word: str, known: Iterable[str]) -> str:
    """Return ``" (did you mean 'x'?)"`` for the known word closest to a misspelt one, or nothing.

    Capitals count for nothing in the comparison: the commonest slip in "Au" is "au".
    """
    by_lower = {k.lower(): k for k in known}
    close = difflib.get_close_matches(str(word).lower(), by_lower, n=1, cutoff=0.6)
    return f" (did you mean {by_lower[close[0]]!r}?)" if close else ""


def _is_number(value: Any) -> bool:
    # bool is an int in Python, but `alpha = true` is a mistake, not 1.
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def _bounds(above: float | None, at_least: float | None, below: float | None, at_most: float | None) -> str:
    named = (("above", above), ("at least", at_least), ("below", below), ("at most", at_most))
    text = " and ".join(f"{word} {limit:g}" for word, limit in named if limit is not None)
    return f", {text}" if text else ""


class Keys:
    """One table of a specimen, read with checks.

    Every method that reads a key raises `InputError` with one line that names the table, the key, the
    value found and what is allowed.

    Parameters
    ----------
    table : Mapping
        Keys and values, as TOML gives them.
    where : str
        Name of the table in error messages, for example ``"surface"``; empty for the whole file.
    """

    def __init__(self, table: Mapping[str, Any], where: str) -> None:
        if not isinstance(table, Mapping):
            raise InputError(
                f"{where} = {str(table)[:60]!r}: must be a table of keys, in braces or under a heading"
            )
        self.table = table
        self.where = where

    def __contains__(self, key: str) -> bool:
        return key in self.table

    def error(self, key: str, reason: str) -> InputError:
        """Return the error for a key: its table, name and value (if any), and the reason."""
        value = repr(self.table[key]) if key in self.table else ""
        value = f" = {value[:60]}{'...' if len(value) > 60 else ''}" if value else ""
        # One line, whatever stands in a key or an array.
        table = f"[{self.where}] " if self.where else ""
        return InputError(" ".join(f"{table}{key}{value}: {reason}".split()))

    def allow(self, *allowed: str) -> None:
        """Refuse every key that is not one of these."""
        for key in self.table:
            if key not in allowed:
                hint = suggest(key, allowed)
                raise self.error(key, f"unknown key{hint}; allowed here: {', '.join(allowed)}")

    def number(
        self,
        key: str,
        default: float | None = None,
        *,
        above: float | None = None,
        at_least: float | None = None,
        below: float | None = None,
        at_most: float | None = None,
        or_inf: bool = False,
    ) -> float:
        """Read one finite number within bounds, or inf if so said; without a default the key is required."""
        if key not in self.table and default is not None:
            return default
        value = self._get(key)
        if or_inf and _is_number(value) and value == math.inf:
            return math.inf
        return self._number(key, value, above, at_least, below, at_most, ", or inf" if or_inf else "")

    def integer(self, key: str, default: int, *, at_least: int, at_most: int) -> int:
        """Read a whole number within bounds (both included)."""
        value = self.table.get(key, default)
        if not _is_number(value) or value != value or value % 1 or not at_least <= value <= at_most:
            raise self.error(key, f"must be a whole number, at least {at_least} and at most {at_most}")
        return int(value)

    def flag(self, key: str) -> bool:
        """Read true or false; false where it is not given."""
        value = self.table.get(key, False)
        if not isinstance(value, bool):
            raise self.error(key, "must be true or false")
        return value

    def numbers(
        self,
        key: str,
        *,
        above: float | None = None,
        at_least: float | None = None,
        below: float | None = None,
        at_most: float | None = None,
    ) -> tuple[float, ...]:
        """Read a number or a list of numbers, each within bounds, as a tuple of at least one."""
        value = self._get(key)
        if isinstance(value, np.ndarray):
            value = value.tolist()  # one of no dimension becomes a number
        values = list(value) if isinstance(value, list | tuple) else [value]
        if not values:
            raise self.error(key, "the list is empty; give at least one number")
        return tuple(self._number(key, v, above, at_least, below, at_most) for v in values)

    def choice(self, key: str, default: str | None, allowed: Iterable[str]) -> str:
        """Read one of the allowed words; without a default the key is required."""
        allowed = tuple(allowed)
        value = self.table.get(key, default) if default is not None else self._get(key)
        if not isinstance(value, str) or value not in allowed:
            hint = suggest(value, allowed) if isinstance(value, str) else ""
            raise self.error(key, f"must be one of {', '.join(map(repr, allowed))}{hint}")
        return value

    def text(self, key: str) -> str:
        """Read a required, non-empty string."""
        value = self._get(key)
        if not isinstance(value, str) or not value.strip():
            raise self.error(key, "must be text in quotes, and not empty")
        return value

    def file(self, key: str, folder: Path) -> Path:
        """Read the name of a file that must exist, relative to `folder`; return its absolute path."""
        file = (folder / self.text(key)).absolute()
        if not file.is_file():
            raise self.error(key, f"there is no file {file}; paths are relative to the specimen's folder")
        return file

    def subtable(self, key: str) -> Keys:
        """Read a required table within this one."""
        return Keys(self._get(key), f"{self.where} {key}".strip())

    def subtables(self, key: str) -> tuple[Keys, ...]:
        """Read a required, non-empty list of tables within this one; they are counted from 1."""
        tables = self._get(key)
        if not isinstance(tables, list | tuple) or not tables:
            raise self.error(key, "must be a list of at least one table")
        return tuple(Keys(table, f"{self.where} {key} {i}".strip()) for i, table in enumerate(tables, 1))

    def metres_per_unit(self) -> float:
        """Read ``units`` ("um" if absent): the factor from lengths in this table to metres."""
        return METRES[self.choice("units", "um", METRES)]

    def _get(self, key: str) -> Any:
        if key not in self.table:
            raise self.error(key, f"missing; add `{key} = ...`")
        return self.table[key]

    def _number(
        self,
        key: str,
        value: Any,
        above: float | None,
        at_least: float | None,
        below: float | None,
        at_most: float | None,
        or_else: str = "",
    ) -> float:
        good = _is_number(value)
        try:
            number = float(value) if good else math.nan
        except OverflowError:  # an integer of hundreds of digits
            number = math.inf
        good = (
            math.isfinite(number)
            and (above is None or number > above)
            and (at_least is None or number >= at_least)
            and (below is None or number < below)
            and (at_most is None or number <= at_most)
        )
        if not good:
            raise self.error(
                key, f"must be a finite number{_bounds(above, at_least, below, at_most)}{or_else}"
            )
        return number
