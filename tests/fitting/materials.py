"""Models with known numbers, and tables of them, for the tests of fitting."""

from __future__ import annotations

import math

import numpy as np

from fitting import Fit
from fitting.models import LOBES
from fitting.models.dispatch import lobe_terms
from fitting.result import FittedLobe
from gonio.table.table import Table

RGB = ("R", "G", "B")


def polar(theta_deg: float, phi_deg: float = 0.0) -> tuple[float, float, float]:
    theta, phi = math.radians(theta_deg), math.radians(phi_deg)
    return math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)


def terms(lobe: str, wi: tuple[float, float, float], wo: tuple[float, float, float], **shape: float):
    return lobe_terms(LOBES[lobe].kind, LOBES[lobe].pack(shape), wi, wo)


def material(model: str, *lobes: tuple[str, dict[str, float], dict[str, tuple[float, ...]]]) -> Fit:
    return Fit(
        model,
        tuple(
            FittedLobe(n, p, {k: dict(zip(RGB, v, strict=True)) for k, v in c.items()}) for n, p, c in lobes
        ),
        RGB,
    )


def gold(alpha: float = 0.5, lobe: str = "beckmann") -> Fit:
    """Rough gold as a tracer sees it: single scattering, and a smooth 6 % of multiple scattering."""
    return material(
        f"cook_torrance_{lobe}",
        (lobe, {"alpha": alpha}, {"f0": (0.9, 0.7, 0.3), "f90": (1.0, 1.0, 1.0)}),
        ("lambert", {}, {"albedo": (0.06, 0.05, 0.03)}),
    )


def grid(rows: int, rings: int, sectors: int, theta_i_deg: list[float] | None = None) -> Table:
    edges = np.linspace(0.0, np.pi / 2, rows + 1)
    theta_i = 0.5 * (edges[1:] + edges[:-1]) if theta_i_deg is None else np.radians(theta_i_deg)
    return Table(
        values=np.zeros((len(theta_i), rings, sectors, 3)),
        theta_i=theta_i,
        theta_r_edges=np.linspace(0.0, np.pi / 2, rings + 1),
        delta_phi_edges=np.linspace(0.0, np.pi, sectors + 1),
        channels=RGB,
        row_albedo=np.zeros((len(theta_i), 3)),
        theta_i_edges=edges if theta_i_deg is None else None,
    )


def counted(table: Table, paths: float, rng: np.random.Generator) -> Table:
    """The table as a tracer of so many paths in all would have counted it, each channel for itself.

    Standard errors are what a tracer knows: estimated from the cell's own hits, a bound where it has none.
    """
    per_hit = 1.0 / (paths / len(table.theta_i) * table.projected_solid_angles[None, :, :, None])
    hits = rng.poisson(table.values / per_hit)
    return table.replace(
        values=hits * per_hit,
        std_error=np.sqrt(np.where(hits > 0, hits, 9.0)) * per_hit,
        hits=hits.sum(axis=-1),
    )
