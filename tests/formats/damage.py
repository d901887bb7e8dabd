"""What every reader owes to a damaged file: one line that names it once and says what is wrong."""

from __future__ import annotations

import pytest

from gonio.table.table import Table
from microgeometry.errors import InputError


def refused(path, message):
    """Reading the file fails with a message that matches."""
    with pytest.raises(InputError, match=message) as caught:
        Table.load(path)
    assert str(caught.value).count(str(path)) == 1
    assert "\n" not in str(caught.value)


def refused_after(damage, path, message):
    """The same, of a text file that `damage` was done to, a function from its text to another."""
    path.write_text(damage(path.read_text()))
    refused(path, message)
