"""Anisotropic tables: which rows and cells are traced, and the table of what was found.

Rows are exact directions (theta_i, phi_i) on the specimen as it lies; it is not turned, and no symmetry is assumed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gonio.table.anisotropic import AnisotropicTable
from gonio.table.checks.anisotropic import anisotropic_noise
from gonio.table.parts import TRANSMISSION, order_names
from gonio.table.tilts import tilt_edges
from microgeometry.errors import InputError
from microgeometry.materials import Lambert, TableMaterial
from microgeometry.specimen import Specimen

if TYPE_CHECKING:
    from gonio.trace.measurement import Measurement
    from gonio.trace.sheets import Sheet
    from gonio.trace.tracer import Tracer

Array = NDArray[np.float64]


class AnisotropicLayout:
    """Rows and cells of a specimen's anisotropic table.

    Attributes
    ----------
    n_phi : int
        Azimuths of each theta_i.
    theta_i, phi_i : ndarray, shape (T * P,)
        Of every row, radians; phi_i runs fastest.
    cells : int
        Along each tilt.
    x_edges, y_edges : ndarray, shape (cells + 1,)
        Of the tilts, radians: as fine as the widest slopes of any layer along that axis, or coarse where light is
        scattered diffusely, or nothing has slopes.

    Raises
    ------
    InputError
        The specimen is of grooves of any orientation.
    """

    def __init__(self, specimen: Specimen, tracer: Tracer) -> None:
        grid = specimen.grid
        assert grid.theta_i_deg is not None
        for layer in specimen.layers:
            if getattr(layer.surface, "orientation", "fixed") == "random":
                raise InputError(
                    '[surface] orientation = "random": an anisotropic table is of one orientation; leave it out, or '
                    "leave out anisotropic = true"
                )
        self.n_phi = round(360 / grid.phi_i_step_deg)
        theta, phi = np.radians(grid.theta_i_deg), 2.0 * np.pi / self.n_phi * np.arange(self.n_phi)
        self.theta_i, self.phi_i = np.repeat(theta, self.n_phi), np.tile(phi, len(theta))
        self.cells = grid.tilt_cells
        diffuse = tracer.stack.scatters or any(
            isinstance(material, Lambert | TableMaterial)
            for layer in specimen.layers
            for material in (layer.material, layer.plane)
        )
        surfaces = tracer.statistics(1)
        widths = [max(surface[name] for surface in surfaces) for name in ("alpha_x", "alpha_y")]
        if diffuse or max(widths) == 0.0:
            widths = [1.0, 1.0]
        self.x_edges, self.y_edges = (tilt_edges(width, self.cells) for width in widths)


def tabulate_anisotropic(
    measurement: Measurement, layout: AnisotropicLayout, provenance: dict[str, Any], ledger: dict[str, float]
) -> AnisotropicTable:
    """The anisotropic table of a measurement's batches so far, at least one."""
    names = order_names(measurement.specimen.grid.orders)
    hemispheres = []
    for total, orders in zip(*measurement.light(), strict=True):
        parts = {
            name: _sheet(measurement, layout, sheet, {}) for name, sheet in zip(names, orders, strict=True)
        }
        hemispheres.append(_sheet(measurement, layout, total, parts))
    table, *below = hemispheres
    parts = ({TRANSMISSION: below[0]} if below else {}) | dict(table.parts)
    table = table.replace(parts=parts, ledger=ledger)
    variance = float(np.median(anisotropic_noise(table))) ** 2
    merit = 1.0 / (variance * measurement.seconds) if variance > 0 else None
    return table.replace(provenance={**provenance, "figure_of_merit": merit})


def _sheet(
    measurement: Measurement, layout: AnisotropicLayout, sheet: Sheet, parts: dict[str, AnisotropicTable]
) -> AnisotropicTable:
    grid = measurement.specimen.grid
    n_phi, n_theta = layout.n_phi, len(layout.theta_i) // layout.n_phi
    shape = n_theta, n_phi, layout.cells, layout.cells, len(grid.channels)
    energy, std_error = np.empty((2, *shape), np.float32)
    for row in range(n_theta * n_phi):
        place = divmod(row, n_phi)
        energy[place], std_error[place] = sheet.row_cells(row, measurement.batches.areas)
    rows = [a.reshape(n_theta, n_phi, -1).copy() for a in sheet.energies()]
    theta = layout.theta_i[::n_phi]
    if theta[0] == 0.0:  # these rows are one direction, seen n_phi times
        for a in (energy, rows[0], rows[2]):
            a[0] = a[0].mean(axis=0)
        for a in (std_error, rows[1], rows[3]):
            a[0] = np.sqrt(np.mean(a[0].astype(float) ** 2, axis=0) / n_phi)
    albedo, albedo_error, specular, specular_error = rows
    return AnisotropicTable(
        energy=energy,
        std_error=std_error,
        theta_i=theta,
        phi_i=layout.phi_i[:n_phi],
        tilt_x_edges=layout.x_edges,
        tilt_y_edges=layout.y_edges,
        channels=grid.channels,
        wavelengths_nm=grid.wavelengths_nm,
        row_albedo=albedo,
        albedo_std_error=albedo_error,
        specular=specular,
        specular_std_error=specular_error,
        parts=parts,
    )
