"""Compression by an analytic fit and a compressed residual.

The model gives each cell its average of the lobe; what the table has beyond that is stored by the adaptive
tree of `gonio.table.compress.tree`. A residual needs no more digits than the error asked for; where the model
is good to that error, nothing is stored but its parameters. Importing this module registers the method in
`gonio.table.compress.METHODS`.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting.fit import fit
from fitting.result import fit_from_json
from fitting.tabulate import tabulate
from gonio.table.compress import METHODS, tree
from gonio.table.table import Table
from microgeometry.errors import InputError

Array = NDArray[np.float64]

MODEL = "cook_torrance_ggx"
"""Of the models, the one that comes closest to most measured materials (Burley 2012)."""

_SECONDS = 20.0
_NEEDED = ("schema", "model", "lobes", "channels")


def encode(table: Table, bounds: Array, quick: bool = False) -> dict[str, Any]:
    """As `gonio.table.compress.dct.encode`.

    Raises
    ------
    InputError
        The bounds cannot be held, or no cell is left to fit.
    """
    found = fit(table, MODEL, max_seconds=_SECONDS)
    text = json.dumps({key: value for key, value in found.to_json().items() if key in _NEEDED})
    base = _base(text, table)
    return {"model": np.frombuffer(text.encode(), np.uint8), **tree.encode(table, bounds, quick, base)}


def decode(content: Mapping[str, Any], fields: Mapping[str, Any]) -> Array:
    """As `gonio.table.compress.dct.decode`."""
    shape = (len(fields["theta_i"]), len(fields["theta_r_edges"]) - 1, len(fields["delta_phi_edges"]) - 1)
    axes = ("theta_i", "theta_r_edges", "delta_phi_edges", "channels", "theta_i_edges")
    grid = Table(
        values=np.zeros((*shape, len(fields["channels"]))),
        row_albedo=np.zeros((shape[0], len(fields["channels"]))),
        **{name: fields[name] for name in axes if name in fields},
    )
    text = bytes(np.asarray(content["model"], np.uint8)).decode()
    return tree.decode(content, fields, _base(text, grid))


def _base(text: str, grid: Table) -> Array:
    """The model's averages over the table's cells, as any decoder will find them."""
    try:
        model = fit_from_json(json.loads(text))
    except InputError as error:
        raise ValueError(str(error)) from error
    if model.channels != grid.channels:
        raise ValueError(f"a model of the channels {model.channels} for {grid.channels}")
    return tabulate(model, grid).values


METHODS["residual"] = sys.modules[__name__]
