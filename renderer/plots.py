"""Plots of tables: lobes in the plane of incidence, albedo, and the hemisphere seen from above."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fitting.result import Fit
from gonio.table.parts import TRANSMISSION
from gonio.table.table import Table

Array = NDArray[np.float64]

_COLOURS = {"R": "#c8322b", "G": "#3a8f3a", "B": "#2b5fc8"}
_STYLES = ("--", ":", "-.")
_PLANE_DEG = 5.0  # azimuth that counts as in the plane of incidence, to either side
_STEP_DEG = 3.0
_MOST_CHANNELS = 6  # lines in a plot, more cannot be told apart


def overlay(fit: Fit) -> Table:
    """A fit as a table of 3-degree cells: enough for a line in a plot, and quickly made."""
    polar, azimuth = np.linspace(0, np.pi / 2, 31), np.linspace(0, np.pi, 61)
    channels = len(fit.channels)
    grid = Table(
        values=np.zeros((30, 30, 60, channels)),
        theta_i=0.5 * (polar[1:] + polar[:-1]),
        theta_i_edges=polar,
        theta_r_edges=polar,
        delta_phi_edges=azimuth,
        channels=fit.channels,
        row_albedo=np.zeros((30, channels)),
    )
    return fit.table(grid)


def plane_of_incidence(table: Table, row: int) -> tuple[Array, Array, Array]:
    """BRDF in the plane of incidence: means over the cells within 5 degrees of it, in steps of 3 degrees.

    Parameters
    ----------
    table : Table
    row : int
        Index of theta_i.

    Returns
    -------
    theta_r : ndarray, shape (2 N,)
        Radians; negative on the light's side (delta phi = 0), positive on the mirror side.
    mean, std_error : ndarray, shape (2 N, C)
        In 1/sr, weighted by projected solid angle. The error is NaN where the table has none, and the
        bound of its empty cells where all cells of a mean are empty.
    """
    near, step = np.radians(_PLANE_DEG), np.radians(_STEP_DEG)
    phi, areas = table.delta_phi, table.projected_solid_angles
    starts = np.unique(np.searchsorted(table.theta_r, np.arange(0.0, np.pi / 2, step)))
    starts = starts[starts < len(table.theta_r)]
    theta = np.add.reduceat(table.theta_r, starts) / np.diff([*starts, len(table.theta_r)])
    means, errors = [], []
    for angle in (phi, np.pi - phi):
        sectors = np.flatnonzero(angle <= max(near, angle.min()))
        weight = areas[:, sectors]
        total = np.add.reduceat(weight.sum(axis=1), starts)[:, None]
        means.append(
            np.add.reduceat(np.einsum("rpc,rp->rc", table.values[row][:, sectors], weight), starts) / total
        )
        errors.append(_merged_error(table, row, sectors, starts, weight, total))
    theta = np.concatenate([-theta[::-1], theta])
    return theta, *(np.concatenate([side[0][::-1], side[1]]) for side in (means, errors))  # type: ignore[return-value]


def _merged_error(
    table: Table, row: int, sectors: NDArray, starts: NDArray, weight: Array, total: Array
) -> Array:
    """Standard error of means over blocks of cells, shape (N, C)."""
    if table.std_error is None:
        return np.full((len(starts), len(table.channels)), np.nan)
    error = table.std_error[row][:, sectors] * weight[:, :, None]
    lit = table.values[row][:, sectors] > 0
    variance = np.add.reduceat(np.where(lit, error**2, 0.0).sum(axis=1), starts)
    # an empty cell's error is a bound of three paths in it; a block of empty cells has the same three paths
    bound = np.add.reduceat(error.max(axis=1), starts)
    return np.where(variance > 0, np.sqrt(variance), bound) / total


def rows_near(table: Table, angles_deg: Sequence[float]) -> list[int]:
    """The rows nearest to some angles of incidence, each once, in order."""
    return sorted({int(np.argmin(abs(table.theta_i - np.radians(a)))) for a in angles_deg})


def label_plane(panel: Axes, table: Table, row: int, transmitted: bool) -> None:
    """Title and axes of a plot over theta_r in the plane of incidence."""
    panel.axvline(np.degrees(table.theta_i[row]), color="0.8", lw=0.8, zorder=0)
    delta = float(table.specular[row].mean())
    and_delta = f"; and a delta term of {delta:.3g}" if delta > 0 else ""
    panel.set_title(f"theta_i = {np.degrees(table.theta_i[row]):.1f}°{and_delta}", fontsize=10)
    side = "straight on" if transmitted else "mirror side"
    panel.set_xlabel(f"{'theta_t' if transmitted else 'theta_r'} (degrees); {side} positive")
    panel.set_xlim(-90, 90)


def scale_plane(panel: Axes, mean: Array) -> None:
    """Scale f up to its largest values but one in a hundred, which noise may have raised."""
    top = 1.1 * float(np.percentile(mean, 99))
    panel.set_ylim(0, top if top > 0 else 1.0)


def lobes(
    table: Table,
    overlays: Mapping[str, Table] | None = None,
    angles_deg: Sequence[float] = (10, 45, 75),
    transmitted: bool = False,
) -> Figure:
    """Draw the lobes in the plane of incidence, one panel an angle of incidence; overlays as lines.

    Parameters
    ----------
    table : Table
    overlays : mapping of str to Table, optional
        Fits, or compressed tables, on any grid.
    angles_deg : sequence of float
        Angles of incidence; the nearest rows are shown.
    transmitted : bool
        The table is of light that left below.
    """
    rows = rows_near(table, angles_deg)
    figure = Figure(figsize=(4.6 * len(rows), 3.8), layout="constrained")
    panels = figure.subplots(1, len(rows), squeeze=False)[0]
    for panel, row in zip(panels, rows, strict=True):
        theta, mean, error = plane_of_incidence(table, row)
        for channel, name in _shown(table):
            colour = _colour(name, channel)
            panel.plot(np.degrees(theta), mean[:, channel], ".", ms=4, color=colour, label=name)
            low = np.maximum(mean[:, channel] - error[:, channel], 0)
            high = mean[:, channel] + error[:, channel]
            panel.fill_between(np.degrees(theta), low, high, color=colour, alpha=0.25, lw=0)
        for style, (label, other) in zip(_STYLES * 9, (overlays or {}).items(), strict=False):
            nearest = int(np.argmin(abs(other.theta_i - table.theta_i[row])))
            theta_other, mean_other, _ = plane_of_incidence(other, nearest)
            for channel, name in _shown(other):
                panel.plot(
                    np.degrees(theta_other), mean_other[:, channel], style, lw=1.1, color=_colour(name, channel),
                    label=label if channel == 0 else None,
                )  # fmt: skip
        label_plane(panel, table, row, transmitted)
        scale_plane(panel, mean)
    panels[0].set_ylabel("f_t (1/sr)" if transmitted else "f_r (1/sr)")
    panels[0].legend(fontsize=8, frameon=False)
    return figure


def albedo(table: Table, overlays: Mapping[str, Table] | None = None) -> Figure:
    """Draw directional albedo against theta_i with its error bars, overlays as lines; and transmittance."""
    transmission = table.parts.get(TRANSMISSION)
    figure = Figure(figsize=(5.6 if transmission is None else 10.4, 3.8), layout="constrained")
    panels = figure.subplots(1, 1 if transmission is None else 2, squeeze=False)[0]
    _albedo_panel(panels[0], table, overlays or {})
    panels[0].set_ylabel("directional albedo")
    if transmission is not None:
        _albedo_panel(panels[1], transmission, {})
        panels[1].set_ylabel("directional transmittance")
    return figure


def _albedo_panel(panel: Axes, table: Table, overlays: Mapping[str, Table]) -> None:
    degrees = np.degrees(table.theta_i)
    for channel, name in _shown(table):
        colour = _colour(name, channel)
        panel.errorbar(
            degrees, table.row_albedo[:, channel], 2 * table.albedo_std_error[:, channel], fmt=".", ms=3, lw=0.8,
            color=colour, label=f"{name} (± 2 standard errors)",
        )  # fmt: skip
    for style, (label, other) in zip(_STYLES * 9, overlays.items(), strict=False):
        for channel, name in _shown(other):
            panel.plot(
                np.degrees(other.theta_i), other.row_albedo[:, channel], style, lw=1.1, color=_colour(name, channel),
                label=label if channel == 0 else None,
            )  # fmt: skip
    panel.set_xlabel("theta_i (degrees)")
    panel.set_xlim(0, 90)
    # red of a colour outside sRGB's gamut, as gold's, may be above 1
    panel.set_ylim(0, 1.05 * max(1.0, float(table.row_albedo.max())))
    panel.legend(fontsize=8, frameon=False)


def hemisphere(table: Table, theta_i_deg: float = 45.0, transmitted: bool = False) -> Figure:
    """Draw the BRDF over the hemisphere of outgoing directions, and its relative standard error beside it.

    `transmitted`: the table is of light that left below; the hemisphere is then the lower one, seen as the
    upper one is, from above.
    """
    row = int(np.argmin(abs(table.theta_i - np.radians(theta_i_deg))))
    mean = table.values[row].mean(axis=-1)
    panels = [(f"{'f_t' if transmitted else 'f_r'} (1/sr), mean of the channels", mean, "magma")]
    if table.std_error is not None:
        error = table.std_error[row].mean(axis=-1)
        relative = np.divide(error, mean, out=np.full_like(mean, np.nan), where=mean > 0)
        panels.append(("relative standard error of a cell", np.minimum(relative, 1.0), "viridis"))
    figure = Figure(figsize=(4.6 * len(panels), 4.2), layout="constrained")
    # azimuth from the light: 0 is the light's side, pi the mirror side; the other half is its reflection
    edges = np.concatenate([table.delta_phi_edges, 2 * np.pi - table.delta_phi_edges[-2::-1]])
    far = "straight\non" if transmitted else "mirror"
    for index, (title, data, colours) in enumerate(panels):
        panel = figure.add_subplot(1, len(panels), index + 1, projection="polar")
        whole = np.concatenate([data, data[:, ::-1]], axis=1)
        top = np.nanpercentile(whole, 99.5) if index == 0 else 1.0
        mesh = panel.pcolormesh(
            edges, np.degrees(table.theta_r_edges), whole, cmap=colours, vmin=0, vmax=max(top, 1e-12)
        )
        panel.set_title(title, fontsize=10)
        panel.set_yticklabels([])
        panel.tick_params(pad=10)
        panel.set_xticks(np.radians([0, 90, 180, 270]), ["light", "90°", far, "90°"])
        panel.grid(alpha=0.2)
        figure.colorbar(mesh, ax=panel, shrink=0.75)
    figure.suptitle(f"theta_i = {np.degrees(table.theta_i[row]):.1f}°", fontsize=10)
    return figure


def _shown(table: Table) -> list[tuple[int, str]]:
    """Number and name of the channels to draw: all, or of very many a few evenly spread."""
    count = len(table.channels)
    chosen = np.unique(np.linspace(0, count - 1, min(count, _MOST_CHANNELS)).round().astype(int))
    return [(channel, table.channels[channel]) for channel in chosen.tolist()]


def _colour(name: str, channel: int) -> str:
    """Of a channel: what its name says, or its place in the visible spectrum from blue to red."""
    if name.endswith(" nm"):
        place = (float(name.removesuffix(" nm")) - 400) / 300
        return to_hex(matplotlib.colormaps["turbo"](float(np.clip(place, 0.05, 0.95))))
    return _COLOURS.get(name, ("#333333", "#b8660b", "#6b3fa0", "#0b7a75")[channel % 4])
