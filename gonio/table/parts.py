"""The names of a table's parts, and a part as a table of its own.

A part is light of one kind on its table's own grid: TRANSMISSION, what left the specimen below, and one
part for every number of bounces that was asked for. The latter add up to the table they are parts of;
transmission has such parts of its own. A part of a part is written transmission/L1.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, TypeVar

from microgeometry.errors import InputError

if TYPE_CHECKING:
    from gonio.table.anisotropic import AnisotropicTable
    from gonio.table.table import Table

    AnyTable = TypeVar("AnyTable", Table, AnisotropicTable)

TRANSMISSION = "transmission"


def order_names(orders: int) -> tuple[str, ...]:
    """Names of the parts by bounces: L1, L2, ... for exactly so many, the last, as L3+, for that many or more.

    Parameters
    ----------
    orders : int
        How many parts; below 2 there are none.
    """
    if orders < 2:
        return ()
    return (*(f"L{n}" for n in range(1, orders)), f"L{orders}+")


def orders_of(table: Table) -> dict[str, Table]:
    """The table's parts by number of bounces, in that order; empty where there is no full set of them."""
    for name in table.parts:
        if last := re.fullmatch(r"L(\d{1,4})\+", name):
            names = order_names(int(last[1]))
            if all(n in table.parts for n in names):
                return {n: table.parts[n] for n in names}
    return {}


def walk(table: AnyTable, path: str = "") -> Iterator[tuple[str, AnyTable]]:
    """All parts and their parts with their paths, such as "transmission/L1", each before its own."""
    for name, part in table.parts.items():
        yield path + name, part
        yield from walk(part, f"{path}{name}/")


def is_transmission(table: Table | AnisotropicTable) -> bool:
    """Whether a table of its own is (a part of) the transmission of another, as `extract` makes it."""
    return TRANSMISSION in str(table.provenance.get("part", "")).split("/")


def extract(table: AnyTable, path: str) -> AnyTable:
    """A part as a table of its own, which says in its provenance which part of what it is.

    Parameters
    ----------
    table : Table or AnisotropicTable
    path : str
        Name of the part; of a part's part after a slash: "transmission/L1".

    Returns
    -------
    Table or AnisotropicTable
        With the ledger and provenance of the whole, and the latter's ``part``.

    Raises
    ------
    InputError
        The table has no such part.
    """
    parts = dict(walk(table))
    if path not in parts:
        known = ", ".join(parts) or "none"
        raise InputError(f"part: the table has no {path!r}; its parts are: {known}")
    before = table.provenance.get("part")
    provenance = {
        **table.provenance,
        **parts[path].provenance,
        "part": f"{before}/{path}" if before else path,
    }
    return parts[path].replace(ledger=table.ledger, provenance=provenance)
