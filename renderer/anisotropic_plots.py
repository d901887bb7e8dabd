"""Plots of anisotropic tables: what the azimuth of incidence does to the highlight, and to the albedo."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gonio.core.directions import direction
from gonio.table.anisotropic import AnisotropicTable

Array = NDArray[np.float64]

_AZIMUTHS_DEG = (0, 30, 60, 90)
_DECADES = 4  # of the hemisphere's brightness


def azimuths(table: AnisotropicTable) -> list[int]:
    """The table's phi_i nearest to 0, 30, 60 and 90 degrees, each once."""
    turns = [np.argmin(abs(table.phi_i - np.radians(phi))) for phi in _AZIMUTHS_DEG]
    return sorted({int(turn) for turn in turns})


def lobes(table: AnisotropicTable, angles_deg: tuple[float, ...] = (10, 45, 75)) -> Figure:
    """Draw f in the plane of incidence, mean of the channels: a panel for each theta_i, a line for each phi_i."""
    rows = sorted({int(np.argmin(abs(table.theta_i - np.radians(angle)))) for angle in angles_deg})
    figure = Figure(figsize=(4.6 * len(rows), 3.8), layout="constrained")
    polar = np.radians(np.linspace(-89.5, 89.5, 717))
    for panel, row in zip(figure.subplots(1, len(rows), squeeze=False)[0], rows, strict=True):
        for turn in azimuths(table):
            theta, phi = table.theta_i[row], table.phi_i[turn]
            f = table.eval(direction(theta, phi), direction(polar, phi + np.pi)).mean(axis=-1)
            panel.semilogy(
                np.degrees(polar), np.maximum(f, 1e-12), lw=1.1, label=f"phi_i = {np.degrees(phi):.4g}°"
            )
        top = panel.get_ylim()[1]
        panel.set_ylim(top / 10**_DECADES, top)
        panel.set_title(f"theta_i = {np.degrees(table.theta_i[row]):.4g}°", fontsize=10)
        panel.set_xlabel("theta_r (degrees), mirror side positive")
        panel.legend(fontsize=8, frameon=False)
    figure.axes[0].set_ylabel("f_r (1/sr), mean of the channels")
    return figure


def hemispheres(table: AnisotropicTable, theta_i_deg: float = 45.0) -> Figure:
    """Draw f over the outgoing hemisphere, seen from above with the specimen's x to the right, for a few phi_i."""
    row, turns = int(np.argmin(abs(table.theta_i - np.radians(theta_i_deg)))), azimuths(table)
    figure = Figure(figsize=(3.6 * len(turns), 4.0), layout="constrained")
    axis = np.linspace(-1, 1, 400)
    x, y = np.meshgrid(axis, axis)
    inside = x * x + y * y < 1
    wo = np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0))], axis=-1)[inside]
    pictures = []
    for turn in turns:
        f = np.full(x.shape, np.nan)
        f[inside] = table.eval(direction(table.theta_i[row], table.phi_i[turn]), wo).mean(axis=-1)
        pictures.append(f)
    top = max(float(np.nanmax(pictures)), 1e-12)
    scale = LogNorm(top / 10**_DECADES, top, clip=True)
    panels = figure.subplots(1, len(turns), squeeze=False)[0]
    for panel, turn, picture in zip(panels, turns, pictures, strict=True):
        image = panel.imshow(picture, origin="lower", extent=(-1, 1, -1, 1), norm=scale, cmap="magma")
        light = direction(table.theta_i[row], table.phi_i[turn])
        panel.plot(light[0], light[1], "w+", ms=8)
        panel.set_title(f"phi_i = {np.degrees(table.phi_i[turn]):.4g}°", fontsize=10)
        panel.set_xticks([])
        panel.set_yticks([])
    figure.colorbar(image, ax=panels, shrink=0.75)
    figure.suptitle(
        f"theta_i = {np.degrees(table.theta_i[row]):.4g}°; + is the light; f_r (1/sr)", fontsize=10
    )
    return figure


def albedo(table: AnisotropicTable) -> Figure:
    """Draw directional albedo, mean of the channels, against theta_i for a few phi_i."""
    figure = Figure(figsize=(5.6, 3.8), layout="constrained")
    panel = figure.subplots()
    for turn in azimuths(table):
        panel.errorbar(
            np.degrees(table.theta_i), table.row_albedo[:, turn].mean(axis=-1),
            2 * table.albedo_std_error[:, turn].mean(axis=-1), fmt=".-", ms=3, lw=0.8,
            label=f"phi_i = {np.degrees(table.phi_i[turn]):.4g}° (± 2 standard errors)",
        )  # fmt: skip
    panel.set_xlabel("theta_i (degrees)")
    panel.set_ylabel("directional albedo")
    panel.set_xlim(0, 90)
    panel.set_ylim(0, 1.05 * max(1.0, float(table.row_albedo.max())))
    panel.legend(fontsize=8, frameon=False)
    return figure
