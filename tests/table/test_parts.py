"""Parts of a table: on its grid, by name, and as tables of their own."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.table.parts import extract, order_names, orders_of, walk
from microgeometry.errors import InputError
from tests.table.tables import asymmetric, grid, lambert, make, share, with_parts

EDGES = grid(4, 5, 6)


def bare(**fields):
    return make(asymmetric, EDGES, **fields)


def test_a_table_has_no_parts_unless_given():
    assert bare().parts == {}


def test_parts_stay_when_other_fields_change():
    table = with_parts(bare())
    changed = table.replace(provenance={"seed": 1})
    assert list(changed.parts) == ["transmission", "L1", "L2", "L3+"]
    assert all(changed.parts[name] is part for name, part in table.parts.items())
    assert table.replace(parts={}).parts == {}


def test_parts_are_copied_from_the_mapping_given():
    given = {"L1": share(bare(), 0.5)}
    table = bare().replace(parts=given)
    given.clear()
    assert list(table.parts) == ["L1"]


OTHERS = {
    "theta_i": lambda: make(asymmetric, EDGES, theta_i=np.array([0.1, 0.2, 0.3, 0.4])),
    "theta_i_edges": lambda: bare().replace(theta_i_edges=None),
    "theta_r_edges": lambda: make(asymmetric, grid(4, 6, 6)),
    "delta_phi_edges": lambda: make(asymmetric, grid(4, 5, 7)),
    "channels": lambda: bare().replace(channels=("B", "G", "R")),
    "wavelengths_nm": lambda: bare(wavelengths_nm=(600.0, 500.0, 400.0)),
}


@pytest.mark.parametrize("name", OTHERS)
def test_a_part_on_another_grid_is_refused(name):
    with pytest.raises(InputError, match=f"parts/transmission: {name} is not the table's; .* same grid"):
        bare().replace(parts={"transmission": OTHERS[name]()})


@pytest.mark.parametrize("name", ["", ".", "a/b", 3])
def test_names_that_no_path_can_hold(name):
    with pytest.raises(InputError, match=r"parts: the name .*without slashes"):
        bare().replace(parts={name: bare()})


def test_a_part_is_a_table():
    with pytest.raises(InputError, match="parts/L1: ndarray; a Table is expected"):
        bare().replace(parts={"L1": np.zeros(3)})


def test_names_of_orders():
    assert order_names(1) == ()
    assert order_names(2) == ("L1", "L2+")
    assert order_names(4) == ("L1", "L2", "L3", "L4+")


def test_orders_come_by_number_and_only_as_a_full_set():
    table, part = bare(), share(bare(), 0.1)
    names = order_names(11)
    shuffled = table.replace(parts={name: part for name in ("transmission", *sorted(names))})
    assert tuple(orders_of(shuffled)) == names
    for some in (("L1", "L2"), ("L2", "L3+"), ("transmission",), ("L1", "L3+")):
        assert orders_of(table.replace(parts={name: part for name in some})) == {}


def test_walk_goes_through_parts_of_parts():
    names = [path for path, _ in walk(with_parts(bare()))]
    below = [f"transmission/{n}" for n in ("L1", "L2", "L3+")]
    assert names == ["transmission", *below, "L1", "L2", "L3+"]


def test_a_part_as_a_table_of_its_own():
    table = with_parts(make(lambert, EDGES)).replace(ledger={"paths": 5.0}, provenance={"seed": 7})
    part = extract(table, "transmission")
    np.testing.assert_array_equal(part.values, 0.25 * table.values)
    assert part.provenance == {"seed": 7, "part": "transmission"}
    assert part.ledger == {"paths": 5.0}
    inner = extract(table, "transmission/L2")
    np.testing.assert_array_equal(inner.values, 0.125 * 0.25 * table.values)
    assert inner.provenance["part"] == "transmission/L2"
    again = extract(part, "L2")
    np.testing.assert_array_equal(again.values, inner.values)
    assert again.provenance == inner.provenance


def test_an_unknown_part_is_told_the_known_ones():
    with pytest.raises(InputError, match=r"no 'L4'; its parts are: transmission, transmission/L1, .*, L3\+"):
        extract(with_parts(bare()), "L4")
    with pytest.raises(InputError, match="its parts are: none"):
        extract(bare(), "transmission")
