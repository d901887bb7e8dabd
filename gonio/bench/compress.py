"""`gonio bench compress`: size against error against speed, for all methods and an RGL tensor file.

Two tables of 90 x 90 x 180 cells and three channels: rough gold as the instrument measures it, whose noise is
more than the error asked for, and the formula of such a surface (Cook & Torrance 1982: Beckmann facets of
gold, first bounce), which has none. Each is written by every method for the same bound, read again, compared,
and evaluated and sampled at random directions by the kernels that the renderer uses, in turns with the table
itself. Compressed tables are decoded when they are loaded, into the layout of any table: what is compared is
whether that costs time. The plain file, first, holds the same numbers: how far its speeds are from 1 is how well
the machine tells them apart. The RGL file is what `gonio convert` writes of the same table; it holds no bound.

Where the environment's GONIO_TEST_DATA names a folder of measured BRDFs, every isotropic one in it is written by the
method that packs it smallest. What a file takes besides (axes, albedos, where it is from: the column `frame`), of
which HDF5's own 511 bytes, does not shrink with the table: at 1 % tables of 65 000 numbers on 1-degree cells came to
108:1 and 123:1, of 17 000 to 140 000 numbers on coarser or interpolated cells to 28:1 to 88:1, of 2 300 and 4 700
numbers to 6:1 and 7:1, which is 1.5 and 2.8 kB.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import direction, projected_solid_angles
from gonio.formats import FORMATS
from gonio.resources import data_folder
from gonio.table.compress import compress, methods, row_errors, row_noise
from gonio.table.table import Table
from gonio.trace.measure import measure
from microgeometry.errors import InputError
from microgeometry.specimen import load_specimen

Array = NDArray[np.float64]

_MAX_ERROR = 0.01
_PATHS = 20_000_000
_ALPHA = 0.5
_GOLD = np.array([[0.18, 3.1], [0.42, 2.35], [1.37, 1.77]])  # n and k at 630, 532, 467 nm
_LOOKS = 200_000
_REPEATS = 7  # the fastest counts: whatever else the machine does only slows
_PLAIN, _RGL = "plain file", "RGL file"


def run(say: Callable[[str], None]) -> dict[str, Any]:
    """Measure; returns per table and method size, ratio, errors, and speeds relative to the plain table."""
    gold = measure(load_specimen(data_folder() / "specimens" / "gold.toml"), rays=_PATHS)
    results = {}
    for name, table in (("gold, traced", gold), ("gold, formula", _formula())):
        say(
            f"{name}: asked {_MAX_ERROR:g}, its own noise {np.median(row_noise(table)):.3g} (median), "
            f"float32 {4 * table.values.size / 1e6:.1f} MB"
        )
        say(
            f"  {'method':10} {'kB':>8} {'ratio':>7} {'error':>8} {'worst':>8} {'write s':>8} {'load s':>7} "
            f"{'eval':>6} {'sample':>6}"
        )
        results[name] = _compare(table, say)
    if folder := os.environ.get("GONIO_TEST_DATA"):
        results["measured"] = _measured(Path(folder), say)
    return results


def _measured(folder: Path, say: Callable[[str], None]) -> dict[str, Any]:
    """Size and error of every isotropic BRDF in a folder, each by the method that packs it smallest."""
    say("measured: the smallest of all methods")
    say(
        f"  {'file':44} {'numbers':>9} {'method':10} {'kB':>7} {'frame':>6} {'ratio':>6} {'error':>8} {'worst':>8} "
        f"{'write s':>8}"
    )
    results = {}
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() not in FORMATS or path.suffix.lower() == ".npz":
            continue
        with tempfile.TemporaryDirectory() as to:
            try:
                table = Table.load(path)
                if not isinstance(table, Table):
                    continue
                begun = time.perf_counter()
                report = compress(table, Path(to, "table.h5"), _MAX_ERROR)
                seconds = time.perf_counter() - begun
            except InputError as refusal:
                say(f"  {path.name:44.44} {refusal}")
                continue
        results[path.name] = {
            "numbers": table.values.size,
            "method": report.method,
            "bytes": report.bytes,
            "frame": report.bytes - report.content,
            "ratio": report.ratio,
            "error_median": report.error_median,
            "error_worst": report.error_worst,
            "write_seconds": seconds,
        }
        say(
            f"  {path.name:44.44} {table.values.size:9} {report.method:10} {report.bytes / 1e3:7.1f} "
            f"{(report.bytes - report.content) / 1e3:6.1f} {report.ratio:6.0f} {report.error_median:8.4f} "
            f"{report.error_worst:8.4f} {seconds:8.1f}"
        )
    return results


def _compare(table: Table, say: Callable[[str], None]) -> dict[str, Any]:
    results: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        for method in (_PLAIN, *methods(), _RGL):
            path = Path(folder, "table.bsdf" if method == _RGL else "table.h5")
            begun = time.perf_counter()
            try:
                if method in (_PLAIN, _RGL):
                    table.save(path)
                else:
                    compress(table, path, _MAX_ERROR, method)
            except InputError as refusal:
                say(f"  {method:10} {refusal}")
                continue
            written = time.perf_counter()
            decoded = Table.load(path)
            loaded = time.perf_counter()
            error = _errors(table, decoded)
            speeds = _speeds(decoded, table)
            size = path.stat().st_size
            found = {
                "bytes": size,
                "ratio": 4 * table.values.size / size,
                "error_median": float(np.median(error)),
                "error_worst": float(error.max()),
                "write_seconds": written - begun,
                "load_seconds": loaded - written,
                "eval_speed": speeds[0],
                "sample_speed": speeds[1],
            }
            results[method] = found
            say(
                f"  {method:10} {size / 1e3:8.1f} {found['ratio']:7.0f} {found['error_median']:8.4f} "
                f"{found['error_worst']:8.4f} {found['write_seconds']:8.1f} {found['load_seconds']:7.2f} "
                f"{found['eval_speed']:6.2f} {found['sample_speed']:6.2f}"
            )
    return results


def _errors(table: Table, decoded: Table) -> Array:
    """Error of rows; of a format on a grid of its own, at the cells' centres."""
    if decoded.values.shape == table.values.shape:
        return row_errors(table, decoded.values)
    wo = direction(table.theta_r[:, None], table.delta_phi)
    values = np.stack([decoded.eval(direction(theta), wo) for theta in table.theta_i])
    return row_errors(table, values)


def _speeds(table: Table, plain: Table) -> tuple[float, float]:
    """Evaluations and samples of the kernels in a time, relative to those of the plain table; one thread."""
    rng = np.random.default_rng(0)
    theta, phi = np.arccos(rng.random((2, _LOOKS))), rng.uniform(0, 2 * np.pi, (2, _LOOKS))
    wi, wo = direction(theta[0], phi[0]), direction(theta[1], phi[1])
    u = rng.random((_LOOKS, 3))
    best = np.full((2, 2), np.inf)
    # in turns: what slows the machine for a while slows both
    for turn in range(_REPEATS + 1):
        for which, one in enumerate((table, plain)):
            works: tuple[Callable[[], object], ...] = partial(one.eval, wi, wo), partial(one.sample, wi, u)
            for k, work in enumerate(works):
                begun = time.perf_counter()
                work()
                if turn > 0:  # the first lays the table out, and compiles
                    best[which, k] = min(best[which, k], time.perf_counter() - begun)
    return float(best[1, 0] / best[0, 0]), float(best[1, 1] / best[0, 1])


def _formula() -> Table:
    """Cook & Torrance's reflectance of gold with Beckmann's distribution and Smith's shadowing."""
    edges, edges_phi = np.linspace(0, np.pi / 2, 91), np.linspace(0, np.pi, 181)
    theta, phi = 0.5 * (edges[1:] + edges[:-1]), 0.5 * (edges_phi[1:] + edges_phi[:-1])
    wi, wo = direction(theta)[:, None, None], direction(theta[:, None], phi)
    half = wi + wo
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    tan2 = 1 / half[..., 2] ** 2 - 1
    d = np.exp(-tan2 / _ALPHA**2) / (np.pi * _ALPHA**2 * half[..., 2] ** 4)
    shadow = d / (1 + _lambda(wi) + _lambda(wo)) / (4 * wi[..., 2] * wo[..., 2])
    cosine = np.sum(wi * half, axis=-1)[..., None]
    n, k = _GOLD.T
    s = ((n - cosine) ** 2 + k**2) / ((n + cosine) ** 2 + k**2)
    p = ((n * cosine - 1) ** 2 + (k * cosine) ** 2) / ((n * cosine + 1) ** 2 + (k * cosine) ** 2)
    values = shadow[..., None] * 0.5 * (s + p)
    areas = projected_solid_angles(edges, edges_phi)
    return Table(
        values=values,
        theta_i=theta,
        theta_i_edges=edges,
        theta_r_edges=edges,
        delta_phi_edges=edges_phi,
        channels=("R", "G", "B"),
        row_albedo=np.einsum("irpc,rp->ic", values, areas),
    )


def _lambda(w: Array) -> Array:
    """Walter's rational fit of Smith's function for Beckmann facets (Walter et al. 2007)."""
    a = w[..., 2] / (_ALPHA * np.sqrt(np.maximum(1 - w[..., 2] ** 2, 1e-12)))
    return np.where(a < 1.6, (1 - 1.259 * a + 0.396 * a**2) / (3.535 * a + 2.181 * a**2), 0.0)
