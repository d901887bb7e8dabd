"""What a format cannot keep, in sentences."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.table.parts import is_transmission
from gonio.table.table import Table

Array = NDArray[np.float64]


def stated_reflectance(stated: Array, integral: Array, what: str, scaled_by: str) -> list[str]:
    """What is lost where a file states reflectances that its values do not add up to, by more than a hundredth.

    Parameters
    ----------
    stated, integral : ndarray, of one shape
    what : str
        How the file calls them.
    scaled_by : str
        The programs that scale the values to them.
    """
    lit = integral > 0
    ratio = stated[lit] / integral[lit]
    if len(ratio) == 0 or np.all(np.abs(ratio - 1) < 0.01):
        return []
    return [
        f"{what}, {ratio.min():.3g} to {ratio.max():.3g} times what the values add up to: they are read as f, as they "
        f"stand, where {scaled_by} them to it"
    ]


def common_losses(table: Table, name: str, keeps: tuple[str, ...] = ()) -> list[str]:
    """What most formats lose of a table.

    Parameters
    ----------
    table : Table
    name : str
        Of the format.
    keeps : tuple of str
        Which of "error bars", "delta", "wavelengths", "parts", "gaps", "transmission" (that part), "side" (whether
        light is reflected or transmitted), "peak" (it is evaluated on the highlight's own grid), "rows" (only those
        of the table) the format does keep.
    """
    losses = []
    if table.std_error is not None and "error bars" not in keeps:
        losses.append("error bars")
    if np.any(table.specular > 0) and "delta" not in keeps:
        losses.append(f"the delta (mirror) term: {name} cannot hold it")
    if table.wavelengths_nm is not None and "wavelengths" not in keeps:
        losses.append(f"wavelengths: {name} has no place for them{_as_rgb(table)}")
    if table.peak is not None and "peak" not in keeps:
        losses.append("the fine grid of the highlight: its light is averaged over the table's cells")
    parts = [p for p in table.parts if not (p == "transmission" and "transmission" in keeps)]
    if parts and "parts" not in keeps:
        losses.append(f"the parts {', '.join(parts)}: {name} holds no such tables")
    if is_transmission(table) and "side" not in keeps:
        losses.append(f"that the light is transmitted: {name} has it for reflected")
    if table.gaps is not None and "gaps" not in keeps:
        losses.append("the marks of gaps: they are written as 0")
    if "rows" not in keeps:
        edges = table.theta_i if table.theta_i_edges is None else table.theta_i_edges
        first, last = np.degrees(edges[0]), np.degrees(edges[-1])
        if first > 0.01 or last < 89.99:
            losses.append(
                f"that light falls in from {first:.4g} to {last:.4g} degrees only: beyond, the nearest row stands"
            )
    return losses


def _as_rgb(table: Table) -> str:
    if table.wavelengths_nm is None or len(table.wavelengths_nm) != 3:
        return ""
    long, middle, short = sorted(table.wavelengths_nm, reverse=True)
    return f"; {long:g}, {middle:g} and {short:g} nm are written as R, G and B"
