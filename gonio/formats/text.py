"""What the readers of text formats share: words and numbers with errors that name the file."""

from __future__ import annotations

import codecs
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from microgeometry.errors import InputError

Array = NDArray[np.float64]


def content(path: Path) -> bytes:
    """All of a text file but the mark of UTF-8 that spreadsheets and Windows' editors put in front."""
    return path.read_bytes().removeprefix(codecs.BOM_UTF8)


class Words:
    """The words of a text file, taken one after another.

    Parameters
    ----------
    path : Path
    comment : str
        Lines that begin with it are left out; empty for none.
    """

    def __init__(self, path: Path, comment: str = "#") -> None:
        self.path = path
        lines = content(path).decode("latin-1").splitlines()
        if comment:
            self.comments = [line for line in lines if line.lstrip().startswith(comment)]
            lines = [line for line in lines if not line.lstrip().startswith(comment)]
        self.words = " ".join(lines).split()
        self.at = 0

    def more(self) -> bool:
        """Whether words are left."""
        return self.at < len(self.words)

    def word(self, what: str) -> str:
        """The next word."""
        if not self.more():
            raise InputError(f"{self.path}: ends where {what} is expected; copy it again")
        self.at += 1
        return self.words[self.at - 1]

    def number(self, what: str) -> float:
        """The next word as a finite number."""
        return float(self.numbers(1, what)[0])

    def numbers(self, n: int, what: str) -> Array:
        """The next n words as finite numbers, shape (n,)."""
        found = self.words[self.at : self.at + n]
        if len(found) < n:
            raise InputError(f"{self.path}: ends after {len(found)} of {n} numbers of {what}; copy it again")
        self.at += n
        return to_numbers(found, what, self.path)

    def count(self, what: str) -> int:
        """The next word as a number of things that can still follow in the file."""
        number = self.number(f"the number of {what}")
        if not (1 <= number <= len(self.words) - self.at and number == int(number)):
            raise InputError(
                f"{self.path}: {number:g} {what}; a whole number that the file can hold is expected"
            )
        return int(number)


def to_numbers(words: Sequence[str], what: str, path: Path, infinite: bool = False) -> Array:
    """Words as finite numbers, or `infinite` ones too.

    Raises
    ------
    InputError
        One is no number or not allowed.
    """
    try:
        found = np.array(words, dtype=float)
    except ValueError as error:
        raise InputError(f"{path}: {what}: {str(error)[:80]}; numbers are expected") from error
    if np.any(np.isnan(found)) or not (infinite or np.all(np.isfinite(found))):
        raise InputError(f"{path}: {what} holds NaN or infinity; finite numbers are expected")
    return found


def angles(degrees: Array, what: str, path: Path, last: float) -> Array:
    """A list of angles that must increase from 0 or more to at most `last` degrees, in radians."""
    if not np.all(np.diff(degrees) > 0) or degrees[0] < 0 or degrees[-1] > last + 1e-6:
        raise InputError(
            f"{path}: {what} from {degrees[0]:g} to {degrees[-1]:g}; angles that increase within 0 to {last:g} "
            "degrees are expected"
        )
    return np.radians(np.minimum(degrees, last))
