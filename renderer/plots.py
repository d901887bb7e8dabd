"""Plots of tables: lobes in the plane of incidence, albedo, and the hemisphere seen from above."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gonio.table.table import Table

Array = NDArray[np.float64]

_COLOURS = {"R": "#c8322b", "G": "#3a8f3a", "B": "#2b5fc8"}
_STYLES = ("--", ":", "-.")
_PLANE_DEG = 3.0  # azimuth that counts as in the plane of incidence, to either side


def plane_of_incidence(table: Table, row: int) -> tuple[Array, Array, Array]:
    """BRDF in the plane of incidence, averaged over the cells within 3 degrees of it.

    Parameters
    ----------
    table : Table
    row : int
        Index of theta_i.

    Returns
    -------
    theta_r : ndarray, shape (2 R,)
        Radians; negative on the light's side (delta phi = 0), positive on the mirror side.
    mean, std_error : ndarray, shape (2 R, C)
        In 1/sr; the error is NaN where the table has none.
    """
    phi = table.delta_phi
    near = np.radians(_PLANE_DEG)
    sides = (np.flatnonzero(phi <= max(near, phi[0])), np.flatnonzero(np.pi - phi <= max(near, np.pi - phi[-1])))
    means, errors = [], []
    for sectors in sides:
        weight = np.diff(table.delta_phi_edges)[sectors]
        weight = weight / weight.sum()
        means.append(np.einsum("rpc,p->rc", table.values[row][:, sectors], weight))
        if table.std_error is None:
            errors.append(np.full_like(means[-1], np.nan))
        else:
            errors.append(np.sqrt(np.einsum("rpc,p->rc", table.std_error[row][:, sectors] ** 2, weight**2)))
    theta = np.concatenate([-table.theta_r[::-1], table.theta_r])
    return theta, np.concatenate([means[0][::-1], means[1]]), np.concatenate([errors[0][::-1], errors[1]])


def lobes(table: Table, overlays: Mapping[str, Table] | None = None, angles_deg: Sequence[float] = (10, 45, 75)) -> Figure:
    """Draw the lobes in the plane of incidence, one panel an angle of incidence; overlays as lines.

    Parameters
    ----------
    table : Table
    overlays : mapping of str to Table, optional
        Fits, or compressed tables, on any grid.
    angles_deg : sequence of float
        Angles of incidence; the nearest rows are shown.
    """
    rows = sorted({int(np.argmin(abs(table.theta_i - np.radians(a)))) for a in angles_deg})
    figure = Figure(figsize=(4.6 * len(rows), 3.8), layout="constrained")
    panels = figure.subplots(1, len(rows), squeeze=False)[0]
    for panel, row in zip(panels, rows, strict=True):
        theta, mean, error = plane_of_incidence(table, row)
        for channel, name in enumerate(table.channels):
            colour = _colour(name, channel)
            panel.plot(np.degrees(theta), mean[:, channel], ".", ms=2.5, color=colour, label=name)
            low = np.maximum(mean[:, channel] - error[:, channel], 0)
            high = mean[:, channel] + error[:, channel]
            panel.fill_between(np.degrees(theta), low, high, color=colour, alpha=0.25, lw=0)
        for style, (label, other) in zip(_STYLES * 9, (overlays or {}).items(), strict=False):
            nearest = int(np.argmin(abs(other.theta_i - table.theta_i[row])))
            theta_other, mean_other, _ = plane_of_incidence(other, nearest)
            for channel, name in enumerate(other.channels):
                panel.plot(
                    np.degrees(theta_other), mean_other[:, channel], style, lw=1.1, color=_colour(name, channel),
                    label=label if channel == 0 else None,
                )  # fmt: skip
        panel.axvline(np.degrees(table.theta_i[row]), color="0.8", lw=0.8, zorder=0)
        panel.set_title(f"theta_i = {np.degrees(table.theta_i[row]):.1f}°", fontsize=10)
        panel.set_xlabel("theta_r (degrees); mirror side positive")
        panel.set_xlim(-90, 90)
        panel.set_ylim(bottom=0, top=1.15 * max(np.percentile(mean, 99.5), 1e-12))
    panels[0].set_ylabel("f_r (1/sr)")
    panels[0].legend(fontsize=8, frameon=False)
    return figure


def albedo(table: Table, overlays: Mapping[str, Table] | None = None) -> Figure:
    """Draw directional albedo against theta_i with its error bars; overlays as lines."""
    figure = Figure(figsize=(5.6, 3.8), layout="constrained")
    panel = figure.subplots()
    degrees = np.degrees(table.theta_i)
    for channel, name in enumerate(table.channels):
        colour = _colour(name, channel)
        panel.errorbar(
            degrees, table.albedo[:, channel], 2 * table.albedo_std_error[:, channel], fmt=".", ms=3, lw=0.8,
            color=colour, label=f"{name} (± 2 standard errors)",
        )  # fmt: skip
    for style, (label, other) in zip(_STYLES * 9, (overlays or {}).items(), strict=False):
        for channel, name in enumerate(other.channels):
            panel.plot(
                np.degrees(other.theta_i), other.albedo[:, channel], style, lw=1.1, color=_colour(name, channel),
                label=label if channel == 0 else None,
            )  # fmt: skip
    panel.set_xlabel("theta_i (degrees)")
    panel.set_ylabel("directional albedo")
    panel.set_xlim(0, 90)
    panel.set_ylim(0, 1.05)
    panel.legend(fontsize=8, frameon=False)
    return figure


def hemisphere(table: Table, theta_i_deg: float = 45.0) -> Figure:
    """Draw the BRDF over the hemisphere of outgoing directions, and its relative standard error beside it."""
    row = int(np.argmin(abs(table.theta_i - np.radians(theta_i_deg))))
    mean = table.values[row].mean(axis=-1)
    panels = [("f_r (1/sr), mean of the channels", mean, "magma")]
    if table.std_error is not None:
        error = table.std_error[row].mean(axis=-1)
        relative = np.divide(error, mean, out=np.full_like(mean, np.nan), where=mean > 0)
        panels.append(("relative standard error of a cell", np.minimum(relative, 1.0), "viridis"))
    figure = Figure(figsize=(4.6 * len(panels), 4.2), layout="constrained")
    # azimuth from the light: 0 is the light's side, pi the mirror side; the other half is its reflection
    edges = np.concatenate([table.delta_phi_edges, 2 * np.pi - table.delta_phi_edges[-2::-1]])
    for index, (title, data, colours) in enumerate(panels):
        panel = figure.add_subplot(1, len(panels), index + 1, projection="polar")
        whole = np.concatenate([data, data[:, ::-1]], axis=1)
        top = np.nanpercentile(whole, 99.5) if index == 0 else 1.0
        mesh = panel.pcolormesh(
            edges, np.degrees(table.theta_r_edges), whole, cmap=colours, vmin=0, vmax=max(top, 1e-12)
        )
        panel.set_title(title, fontsize=10)
        panel.set_yticklabels([])
        panel.set_xticks(np.radians([0, 90, 180, 270]), ["light", "90°", "mirror", "90°"])
        panel.grid(alpha=0.2)
        figure.colorbar(mesh, ax=panel, shrink=0.75)
    figure.suptitle(f"theta_i = {np.degrees(table.theta_i[row]):.1f}°", fontsize=10)
    return figure


def _colour(name: str, channel: int) -> str:
    return _COLOURS.get(name, ("#333333", "#b8660b", "#6b3fa0", "#0b7a75")[channel % 4])
