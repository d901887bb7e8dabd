"""What is in a table, as the one dictionary that `gonio info --json` prints, and in words."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gonio.table.anisotropic import AnisotropicTable
from gonio.table.parts import TRANSMISSION
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
        Albedo, specular, transmittance and their errors are nested [theta_i][channel]; ledger in units of
        incident energy, mean over channels. Under "parts", by name, each part's albedo, its error, specular
        and "parts" of its own; under "peak" the shape and largest slope of a highlight's own cells; under "gaps" the
        share of the projected solid angle that nobody measured. What a table does not know is None.
    """
    transmission = table.parts.get(TRANSMISSION)
    dark = np.zeros_like(table.row_albedo)
    return {
        "file": str(path),
        "bytes": path.stat().st_size,
        "shape": list(table.values.shape),
        "theta_i_deg": np.degrees(table.theta_i).tolist(),
        "theta_i_are_cells": table.theta_i_edges is not None,
        "channels": list(table.channels),
        "peak": None
        if table.peak is None
        else {"shape": list(table.peak.values.shape), "slope": table.peak.extent},
        "wavelengths_nm": table.wavelengths_nm,
        "gaps": 0.0
        if table.gaps is None
        else float((table.gaps * table.projected_solid_angles).sum(axis=(1, 2)).mean() / np.pi),
        **_rows(table),
        "transmittance": (dark if transmission is None else transmission.row_albedo).tolist(),
        "transmittance_std_error": (dark if transmission is None else transmission.albedo_std_error).tolist(),
        **_history(table),
    }


def anisotropic_summary(table: AnisotropicTable, path: Path) -> dict[str, Any]:
    """Describe an anisotropic table in plain Python types; as `summary`, but nested [theta_i][phi_i][channel]."""
    return {
        "file": str(path),
        "bytes": path.stat().st_size,
        "anisotropic": True,
        "shape": list(table.energy.shape),
        "bytes_in_memory": table.nbytes,
        "theta_i_deg": np.degrees(table.theta_i).tolist(),
        "phi_i_deg": np.degrees(table.phi_i).tolist(),
        "channels": list(table.channels),
        "wavelengths_nm": table.wavelengths_nm,
        **_rows(table),
        **_history(table),
    }


def anisotropic_summary_text(data: Mapping[str, Any]) -> str:
    """What `anisotropic_summary` found, for people: of the channels' mean, six azimuths across."""
    n_theta, n_phi, *cells, _ = data["shape"]
    lines = [
        f"{data['file']}: {data['bytes'] / 1e6:.1f} MB, anisotropic, {n_theta} theta_i x {n_phi} phi_i x "
        f"{cells[0]} x {cells[1]} cells ({data['bytes_in_memory'] / 1e6:.1f} MB in memory)",
        *_history_lines(data),
    ]
    columns = np.unique(np.linspace(0, n_phi, 6, endpoint=False).astype(int))
    azimuths = "".join(f"{data['phi_i_deg'][b]:9.4g}" for b in columns)
    for name, whole in _with_transmission(data):
        lines.append(f"theta_i  {name}, mean over channels, at phi_i, degrees: {azimuths.strip()}")
        albedo = np.mean(whole["albedo"], axis=2)
        lines += [
            f"{theta:7.2f}  " + "".join(f"{value:9.5f}" for value in albedo[a, columns])
            for a, theta in enumerate(data["theta_i_deg"])
        ]
    return "\n".join(lines)


def _history(table: Table | AnisotropicTable) -> dict[str, Any]:
    """How a table came to be."""
    provenance = dict(table.provenance)
    names = (
        "estimator", "batches", "seconds", "paths_per_second", "figure_of_merit", "target_met", "surface",
    )  # fmt: skip
    known = {name: provenance.get(name) for name in names}
    return {"ledger": dict(table.ledger), **known, "provenance": provenance}


def _rows(table: Table | AnisotropicTable) -> dict[str, Any]:
    """A table's row quantities, and those of its parts."""
    error: list = table.albedo_std_error.tolist()
    if table.std_error is None and not np.any(table.albedo_std_error):
        error = np.full(table.row_albedo.shape, None).tolist()
    return {
        "albedo": table.row_albedo.tolist(),
        "albedo_std_error": error,
        "specular": table.specular.tolist(),
        "parts": {name: _rows(part) for name, part in table.parts.items()},
    }


def summary_text(data: Mapping[str, Any]) -> str:
    """What `summary` found, for people; at most ten rows of incidence."""
    lines = [f"{data['file']}: {data['bytes'] / 1e6:.1f} MB, {' x '.join(map(str, data['shape']))} cells"]
    lines += _history_lines(data)
    theta_i = data["theta_i_deg"]
    rows = np.unique(np.linspace(0, len(theta_i) - 1, 10).round().astype(int)).tolist()
    for name, whole in _with_transmission(data):
        known = whole["albedo_std_error"][0][0] is not None
        lines.append(f"theta_i  {name}{' (+- standard error)' if known else ''} [specular] in each channel")
        for i in rows:
            cells = (
                f"{a:.5f} +- {e:.1e} [{s:.4f}]" if known else f"{a:.5f} [{s:.4f}]"
                for a, e, s in zip(
                    whole["albedo"][i], whole["albedo_std_error"][i], whole["specular"][i], strict=True
                )
            )
            lines.append(f"{theta_i[i]:7.2f}  {'   '.join(cells)}")
        if orders := {n: part for n, part in whole["parts"].items() if n != TRANSMISSION}:
            lines.append(f"theta_i  {name} by number of bounces, mean over channels")
            lines.append((" " * 9 + "".join(f"{n:10s}" for n in orders)).rstrip())
            for i in rows:
                cells = (f"{np.mean(part['albedo'][i]):<10.5f}" for part in orders.values())
                lines.append(f"{theta_i[i]:7.2f}  {''.join(cells)}".rstrip())
    return "\n".join(lines)


def _history_lines(data: Mapping[str, Any]) -> list[str]:
    """How it came to be, in words."""
    lines = []
    if part := data["provenance"].get("part"):
        lines.append(f"part          {part}")
    lines.append(f"channels      {', '.join(data['channels'])}")
    if peak := data.get("peak"):
        lines.append(
            f"highlight     {' x '.join(map(str, peak['shape']))} cells of its own, half-vector slopes up to "
            f"{peak['slope']:.3g}"
        )
    if gaps := data.get("gaps"):
        lines.append(
            f"gaps          {100 * gaps:.3g} % of the projected solid angle: the albedo is of the rest"
        )
    if data["estimator"]:
        lines.append(
            f"traced        {data['ledger']['paths'] / 1e6:.1f} M paths, {data['batches']} batches, "
            f"{data['seconds']:.1f} s, {data['paths_per_second'] / 1e6:.2f} M paths/s ({data['estimator']})"
        )
    if data["surface"]:
        surface = data["surface"]
        lines.append(
            f"surface       alpha {surface['alpha']:.4f}, rms height {surface['rms_height']:.3g} m (measured)"
        )
    if data["figure_of_merit"]:
        lines.append(f"merit         {data['figure_of_merit']:.3g} / (relative variance x s)")
    if data["target_met"] is not None:
        met = "met" if data["target_met"] else "NOT met"
        lines.append(f"target        {met}: {data['provenance'].get('target_reached', '')}")
    if one := data["provenance"].get("one_realisation"):
        lines.append(f"realisation   {one}")
    width = max(map(len, data["ledger"]), default=0)
    lines += [f"  {name:{width}}  {energy:.6g}" for name, energy in data["ledger"].items()]
    return lines


def _with_transmission(data: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """What the table itself holds, and its transmission, each with the name of its row quantity."""
    found: list[tuple[str, Mapping[str, Any]]] = [("albedo", data)]
    if TRANSMISSION in data["parts"]:
        found.append(("transmittance", data["parts"][TRANSMISSION]))
    return found
