"""What is in a table, as the one dictionary that `gonio info --json` prints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gonio.table.table import Table


def summary(table: Table, path: Path) -> dict[str, Any]:
    """Describe a table in plain Python types.

    Parameters
    ----------
    table : Table
    path : Path
        The file it came from.

    Returns
    -------
    dict
        Albedo, specular and transmittance are nested [theta_i][channel]; ledger in units of incident
        energy, mean over channels. What a table does not know is None.
    """
    provenance = dict(table.provenance)
    names = (
        "estimator", "batches", "seconds", "paths_per_second", "figure_of_merit", "target_met", "surface",
    )  # fmt: skip
    known = {name: provenance.get(name) for name in names}
    return {
        "file": str(path),
        "bytes": path.stat().st_size,
        "shape": list(table.values.shape),
        "theta_i_deg": np.degrees(table.theta_i).tolist(),
        "theta_i_are_cells": table.theta_i_edges is not None,
        "channels": list(table.channels),
        "wavelengths_nm": table.wavelengths_nm,
        "albedo": table.row_albedo.tolist(),
        "albedo_std_error": table.albedo_std_error.tolist(),
        "specular": table.specular.tolist(),
        "transmittance": np.zeros_like(table.row_albedo).tolist(),
        "ledger": dict(table.ledger),
        **known,
        "provenance": provenance,
    }
