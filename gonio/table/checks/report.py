"""What a check says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Check:
    """One check.

    Parameters
    ----------
    name : str
    passed : bool or None
        None: for information, there is nothing to judge by.
    detail : str
        The finding in words.
    numbers : mapping of str to float
        The finding in numbers.
    rows : mapping of str to list
        The finding for every angle of incidence, or a map of it: lists, or lists of lists, of numbers.
    """

    name: str
    passed: bool | None
    detail: str
    numbers: Mapping[str, float] = field(default_factory=dict)
    rows: Mapping[str, list] = field(default_factory=dict)


@dataclass(frozen=True)
class CheckReport:
    """What `check` found."""

    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """Whether no check failed."""
        return all(check.passed is not False for check in self.checks)

    def to_json(self) -> dict[str, Any]:
        """JSON-ready: ``passed``, and under ``checks`` per check its verdict, detail, numbers and rows."""
        checks = {
            c.name: {
                "passed": c.passed,
                "detail": c.detail,
                **{name: float(number) for name, number in c.numbers.items()},
                **c.rows,
            }
            for c in self.checks
        }
        return {"passed": self.passed, "checks": checks}

    def lines(self) -> list[str]:
        """One readable line a check."""
        marks = {True: "ok  ", False: "FAIL", None: "info"}
        return [f"{marks[c.passed]} {c.name}: {c.detail}" for c in self.checks]
