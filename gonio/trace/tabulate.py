"""From what a measurement has learned to its table, with all that must be said about it."""

from __future__ import annotations

import importlib.metadata
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio.table.anisotropic import AnisotropicTable
from gonio.table.checks import relative_noise
from gonio.table.parts import TRANSMISSION, order_names
from gonio.table.peak import Peak
from gonio.table.table import Table
from gonio.trace.anisotropic import tabulate_anisotropic
from gonio.trace.batch import BatchTracer
from gonio.trace.reciprocal import reciprocal
from gonio.trace.sheets import Sheet
from microgeometry.specimen import Specimen

if TYPE_CHECKING:
    from gonio.trace.measurement import Measurement

_GIVEN = ("heightmap", "mesh")  # surfaces that are one piece, as measured
_ONE_REALISATION = (
    "the surface is one given piece, not drawn anew for every batch: the error bars hold the noise of the rays "
    "alone and say how well this piece is known; another piece of the same material would differ, also where "
    "these bars are small, and by how much one piece cannot tell: measure several"
)


def tabulate(measurement: Measurement) -> Table | AnisotropicTable:
    """The table of a measurement's batches so far, at least one."""
    grid, tally = measurement.specimen.grid, measurement.tally
    ledger = {n: energy for n, energy in tally.ledger.items() if n not in measurement.tracer.empty_columns}
    if measurement.batches.anisotropic is not None:
        return tabulate_anisotropic(
            measurement, measurement.batches.anisotropic, _provenance(measurement), ledger
        )
    hemispheres: list[tuple[Sheet, dict[str, Table]]] = []
    for total, orders in zip(*measurement.light(), strict=True):
        names = order_names(grid.orders)
        peaks = not hemispheres  # what is transmitted has none
        parts = {name: _sheet(measurement, sheet, peaks) for name, sheet in zip(names, orders, strict=True)}
        hemispheres.append((total, parts))
    (total, parts), *below = hemispheres
    if below:
        parts = {TRANSMISSION: _sheet(measurement, below[0][0], False, below[0][1]), **parts}
    table = _sheet(measurement, total, True, parts, ledger).replace(provenance=_provenance(measurement))
    if measurement.averages:
        table = reciprocal(table, tally.rows.paths)
    variance = float(np.median(relative_noise(table))) ** 2
    merit = 1.0 / (variance * measurement.seconds) if variance > 0 else None
    return table.replace(provenance={**table.provenance, "figure_of_merit": merit})


def _sheet(
    measurement: Measurement,
    sheet: Sheet,
    peaks: bool,
    parts: dict[str, Table] | None = None,
    ledger: dict[str, float] | None = None,
) -> Table:
    """The table of one sheet, or of a hemisphere's sum of them."""
    grid, axes = measurement.specimen.grid, measurement.batches
    values, std_error = sheet.cells(axes.areas)
    albedo, albedo_error, specular, specular_error = sheet.energies()
    return Table(
        values=values,
        std_error=std_error,
        hits=None if sheet.hits is None else sheet.hits[:, : axes.areas.size].reshape(values.shape[:3]),
        theta_i=axes.theta_i,
        theta_i_edges=axes.theta_i_edges,
        theta_r_edges=axes.theta_edges,
        delta_phi_edges=axes.phi_edges,
        channels=grid.channels,
        wavelengths_nm=grid.wavelengths_nm,
        row_albedo=albedo,
        albedo_std_error=albedo_error,
        specular=specular,
        specular_std_error=specular_error,
        peak=_peak(axes, sheet) if peaks else None,
        ledger=ledger or {},
        parts=parts or {},
    )


def _peak(axes: BatchTracer, sheet: Sheet) -> Peak | None:
    if axes.peak is None:
        return None
    values, std_error = sheet.cells(axes.peak.areas, axes.areas.size)
    return Peak(values, *axes.peak, std_error)


def _provenance(measurement: Measurement) -> dict[str, Any]:
    specimen, tally = measurement.specimen, measurement.tally
    paths = tally.ledger["paths"]
    surfaces = measurement.tracer.statistics(tally.batches)
    return {
        "name": specimen.name,
        "specimen": specimen.text,
        "seed": measurement.job.seed,
        "estimator": measurement.job.estimator,
        "batches": tally.batches,
        "planned_batches": measurement.planned_batches,
        "realisations": tally.batches if specimen.is_random else 1,
        **_one_realisation(specimen),
        "paths": int(paths),
        "paths_of_rows": tally.rows.paths.tolist(),
        "rays": tally.rays + (measurement.half_vector.rays if measurement.half_vector else 0),
        "seconds": measurement.seconds,
        "paths_per_second": paths / measurement.seconds,
        **_target(measurement),
        **_colour(specimen),
        "surface": surfaces[0],
        "surfaces": surfaces,
        "versions": {
            name: importlib.metadata.version(name) for name in ("gonio", "embreex", "numba", "numpy")
        },
    }


def _target(measurement: Measurement) -> dict[str, Any]:
    target = measurement.target_error
    if target is None:
        return {"target_error": None, "target_met": None}
    verdict = measurement.judge()
    return {
        "target_error": target,
        "target_met": verdict.met(target),
        "target_reached": verdict.describe(target),
    }


def _one_realisation(specimen: Specimen) -> dict[str, str]:
    given = any(layer.surface.kind in _GIVEN for layer in specimen.layers)
    return {"one_realisation": _ONE_REALISATION} if given else {}


def _colour(specimen: Specimen) -> dict[str, Any]:
    """What the channels are where they are sums over wavelengths."""
    grid = specimen.grid
    if grid.to_channels is None:
        return {}
    colour = {
        "channels": "linear sRGB, CIE 1931 2-degree observer",
        "samples_nm": grid.samples_nm,
        "to_channels": grid.to_channels,
        "luminance": grid.luminance,
    }
    return {"colour": colour}
