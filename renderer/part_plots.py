"""Plots of a table's parts: where the light goes, and how many bounces it takes."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gonio.table.parts import TRANSMISSION, orders_of
from gonio.table.table import Table
from renderer.plots import label_plane, plane_of_incidence, rows_near, scale_plane

Array = NDArray[np.float64]

_ENERGY_COLOURS = {
    "reflected, delta term": "#e8b94a",
    "reflected": "#f3dc9b",
    "transmitted, delta term": "#4f86c6",
    "transmitted": "#a8c8e8",
    "absorbed": "#5b5b5b",
}


def energy_shares(table: Table) -> dict[str, Array]:
    """What becomes of the light, mean over channels, per row: shares that add up to 1.

    Returns
    -------
    dict of str to ndarray, shape (I,)
        By name, in the order to stack them. What is neither reflected nor transmitted counts as absorbed;
        where noise makes those two more than 1, that is below 0.
    """
    shares = {
        "reflected": (table.row_albedo - table.specular).mean(axis=1),
        "reflected, delta term": table.specular.mean(axis=1),
    }
    transmission = table.parts.get(TRANSMISSION)
    if transmission is not None:
        shares["transmitted, delta term"] = transmission.specular.mean(axis=1)
        shares["transmitted"] = (transmission.row_albedo - transmission.specular).mean(axis=1)
    shares["absorbed"] = 1.0 - sum(shares.values())
    return shares


def energy(table: Table) -> Figure:
    """Draw what is reflected, transmitted and absorbed over theta_i, one upon the other up to 1."""
    figure = Figure(figsize=(7.2, 3.8), layout="constrained")
    panel = figure.subplots()
    shares = {name: share for name, share in energy_shares(table).items() if np.any(share > 1e-6)}
    panel.stackplot(
        np.degrees(table.theta_i),
        [np.maximum(share, 0.0) for share in shares.values()],
        labels=list(shares),
        colors=[_ENERGY_COLOURS[name] for name in shares],
    )
    panel.set_xlabel("theta_i (degrees)")
    panel.set_ylabel("share of the light, mean of the channels")
    panel.set_xlim(*np.degrees(table.theta_i[[0, -1]]).tolist())
    panel.set_ylim(0, 1)
    handles, labels = panel.get_legend_handles_labels()
    panel.legend(
        handles[::-1], labels[::-1], fontsize=8, frameon=False, loc="center left", bbox_to_anchor=(1, 0.5)
    )
    return figure


def orders_albedo(table: Table, transmitted: bool = False) -> Figure:
    """Draw what light of each number of bounces adds to the albedo, one upon the other."""
    orders = _lit_orders(table)
    figure = Figure(figsize=(7.2, 3.8), layout="constrained")
    panel = figure.subplots()
    degrees = np.degrees(table.theta_i)
    layers = [part.row_albedo.mean(axis=1) for part in orders.values()]
    panel.stackplot(degrees, layers, labels=list(orders), colors=_order_colours(len(orders)))
    panel.plot(degrees, table.row_albedo.mean(axis=1), "k:", lw=1, label="all")
    panel.set_xlabel("theta_i (degrees)")
    panel.set_ylabel(f"{'transmittance' if transmitted else 'albedo'}, mean of the channels")
    panel.set_xlim(*degrees[[0, -1]].tolist())
    panel.set_ylim(0, 1.05 * max(float(table.row_albedo.mean(axis=1).max()), 1e-12))
    handles, labels = panel.get_legend_handles_labels()
    panel.legend(
        handles[::-1], labels[::-1], fontsize=8, frameon=False, loc="center left", bbox_to_anchor=(1, 0.5)
    )
    return figure


def orders_lobes(
    table: Table, angles_deg: Sequence[float] = (10, 45, 75), transmitted: bool = False
) -> Figure:
    """Draw the lobes in the plane of incidence by number of bounces, mean of the channels."""
    rows = rows_near(table, angles_deg)
    orders = _lit_orders(table)
    figure = Figure(figsize=(4.6 * len(rows), 3.8), layout="constrained")
    panels = figure.subplots(1, len(rows), squeeze=False)[0]
    for panel, row in zip(panels, rows, strict=True):
        theta, whole, _ = plane_of_incidence(table, row)
        panel.plot(np.degrees(theta), whole.mean(axis=1), "k:", lw=1.2, label="all")
        for (name, part), colour in zip(orders.items(), _order_colours(len(orders)), strict=True):
            _, mean, error = plane_of_incidence(part, row)
            mean, error = mean.mean(axis=1), error.mean(axis=1)
            panel.plot(np.degrees(theta), mean, lw=1.4, color=colour, label=name)
            low = np.maximum(mean - error, 0)
            # an empty cell's error is a bound that would hide the orders which are there
            lit = mean > 0
            panel.fill_between(
                np.degrees(theta), low, mean + error, where=lit, color=colour, alpha=0.25, lw=0
            )
        label_plane(panel, table, row, transmitted)
        scale_plane(panel, whole.mean(axis=1))
    panels[0].set_ylabel("f_t (1/sr)" if transmitted else "f_r (1/sr)")
    panels[0].legend(fontsize=8, frameon=False)
    return figure


def _lit_orders(table: Table) -> dict[str, Table]:
    """The parts by number of bounces that hold any light: none is transmitted in one bounce by two surfaces."""
    return {name: part for name, part in orders_of(table).items() if np.any(part.row_albedo > 0)}


def _order_colours(count: int) -> list[str]:
    return [to_hex(matplotlib.colormaps["viridis"](x)) for x in np.linspace(0.05, 0.9, count)]
