"""`gonio bench trace`: complete paths per second on a rough mirror, beside other loops; then the estimators.

The surface is a Gaussian height field, alpha 0.5, 512 x 512 samples at 16 samples a correlation length,
lossless mirror facets. All trace the same periodic tile, follow every path to its exit and bin it on a
1-degree grid: the instrument; a plain loop of embreex and numpy, as one would write it in an afternoon; and
the bare loop of `gonio.bench.bare`, compiled as well, that keeps the same books and knows mirrors only. Against the
latter it shows what the presence of all other materials costs a mirror.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.bench import beside_mitsuba, estimators
from gonio.bench.bare import trace_mirror
from gonio.core.directions import direction
from gonio.core.lookup import axis
from gonio.core.parallel import for_each
from gonio.trace.estimators import ANALOG
from gonio.trace.measurement import Measurement
from gonio.trace.scene import TraceScene, periodic_vertices
from microgeometry.specimen import parse_specimen
from microgeometry.tile import HeightField

THETA_I_DEG = (0, 30, 60, 80, 88)
_PATHS = 1 << 20  # of the compiled tracer, per angle
_PLAIN_PATHS = 1 << 18  # of the plain loop
_MITSUBA_DEG = (0, 30, 60, 80)
_REPEATS = 5  # the fastest counts: whatever else the machine does only slows


def run(say: Callable[[str], None]) -> dict[str, Any]:
    """Measure both at each angle; returns paths/s, their ratio, and DHR (1 for both, or one is wrong)."""
    plain_loop = _PlainLoop(_specimen(0).surface.realise(0))
    results = []
    heads = (
        f"{'theta_i':>8} {'M paths/s':>10} {'bare loop':>10} {'ratio':>6}",
        f"{'embreex+numpy':>14} {'ratio':>6}",
    )
    say(" ".join((*heads, f"{'albedo':>8}")))
    for theta in THETA_I_DEG:
        fast, bare, albedo, lost = _compiled(theta)
        slow, plain_albedo = plain_loop.paths_per_second(theta)
        # both bin one path as one count: at equal paths their errors are equal, so this is the ratio of FOMs
        results.append(
            {
                "theta_i_deg": theta,
                "paths_per_second": fast,
                "bare_paths_per_second": bare,
                "bare_ratio": fast / bare,
                "plain_paths_per_second": slow,
                "ratio": fast / slow,
                "albedo": albedo,
                "plain_albedo": plain_albedo,
                "lost": lost,
            }
        )
        say(
            f"{theta:8d} {fast / 1e6:10.2f} {bare / 1e6:10.2f} {fast / bare:6.2f} {slow / 1e6:14.3f} "
            f"{fast / slow:6.1f} {albedo:8.4f} {plain_albedo:6.4f}"
        )
    mean = float(np.mean([r["paths_per_second"] for r in results]))
    ratio = float(np.exp(np.mean([np.log(r["ratio"]) for r in results])))
    bare_ratio = float(np.exp(np.mean([np.log(r["bare_ratio"]) for r in results])))
    say(f"{'mean':>8} {mean / 1e6:10.2f} {'':10} {bare_ratio:6.2f} {'':14} {ratio:6.1f}  (ratios: geometric)")
    ours = {r["theta_i_deg"]: r["paths_per_second"] for r in results if r["theta_i_deg"] in _MITSUBA_DEG}
    return {
        "angles": results,
        "mean_paths_per_second": mean,
        "ratio": ratio,
        "bare_ratio": bare_ratio,
        "mitsuba": beside_mitsuba.run(_specimen(0).surface.realise(0), ours, _PATHS, say),
        "estimators": estimators.run(say),
    }


def _specimen(theta_i_deg: float) -> Any:
    return parse_specimen(
        {
            "surface": {"kind": "gaussian", "alpha": 0.5, "samples": 512},
            "material": {"kind": "mirror"},
            "grid": {"theta_i_deg": [theta_i_deg]},
        }
    )


def _compiled(theta_i_deg: float) -> tuple[float, float, float, float]:
    """Paths/s of the instrument's own batches, and of the bare loop; albedo and lost paths of the instrument.

    Realisations of the surface and statistics are not counted. The two take turns, so that what else the
    machine does slows both.
    """
    measurement = Measurement(_specimen(theta_i_deg), rays=32 * _PATHS, estimator=ANALOG)
    measurement.add_batch()  # compiles, and fills caches
    _bare(0, theta_i_deg)
    best = bare = 0.0
    for repeat in range(_REPEATS):
        before = measurement.trace_seconds
        measurement.add_batch()
        best = max(best, measurement.paths_per_batch / (measurement.trace_seconds - before))
        bare = max(bare, _bare(repeat, theta_i_deg))
    ledger = measurement.tally.ledger
    return best, bare, ledger["reflected"] / ledger["paths"], ledger["lost"]


def _bare(seed: int, theta_i_deg: float) -> float:
    """Paths/s of the bare loop over a realisation, as many and in as many pieces as the instrument's batch.

    A new realisation each time, as the instrument has: one traced before is still in the caches, and up
    to 10 % faster.
    """
    scene = TraceScene([_specimen(0).surface.realise(seed)], horizon=True)
    strata, pieces = 256, 32
    packets = strata * strata
    theta = axis(np.sin(np.radians(np.arange(91))) ** 2)
    phi = axis(-np.cos(np.radians(np.arange(181))))
    cells, ledger = np.zeros((pieces, 90 * 180, 2)), np.zeros((pieces, 5))
    sin_i = float(np.sin(np.radians(theta_i_deg)))

    def trace(piece: int) -> None:
        first, last = piece * packets // pieces, (piece + 1) * packets // pieces
        trace_mirror(
            scene.embree, scene.box, scene.horizon, theta, phi, sin_i, strata, first, last, 0,
            cells[piece], ledger[piece],
        )  # fmt: skip

    started = time.perf_counter()
    for_each(trace, pieces, None)
    return 16 * packets / (time.perf_counter() - started)


class _PlainLoop:
    """The same loop as one would write it in an afternoon: embreex's own run() and numpy arrays of rays."""

    def __init__(self, tile: HeightField) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        scale = 1.0 / max(tile.size)
        z = tile.heights * scale
        grid = periodic_vertices(z - 0.5 * (z.min() + z.max()), 1.0, 1.0).astype(np.float32)
        i, j = (a.ravel() for a in np.meshgrid(*(np.arange(n) for n in z.shape), indexing="ij"))
        a, b, c, d = (grid[i + p, j + q] for p, q in ((0, 0), (1, 0), (1, 1), (0, 1)))
        triangles = np.concatenate([np.stack([a, b, d], axis=1), np.stack([c, d, b], axis=1)])
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        self._normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        self._top = float(grid[..., 2].max()) + 1e-4
        self._scene = EmbreeScene(robust=True)
        self._mesh = TriangleMesh(self._scene, triangles)

    def paths_per_second(self, theta_i_deg: float) -> tuple[float, float]:
        """Paths/s, and the fraction of them that left above."""
        best, albedo = 0.0, 0.0
        for repeat in range(_REPEATS):
            started = time.perf_counter()
            albedo = self._trace(np.radians(theta_i_deg), np.random.default_rng(repeat))
            best = max(best, _PLAIN_PATHS / (time.perf_counter() - started))
        return best, albedo

    def _trace(self, theta_i: float, rng: np.random.Generator) -> float:
        n = _PLAIN_PATHS
        origins = np.column_stack([rng.random((n, 2)), np.full(n, self._top)]).astype(np.float32)
        phi = rng.uniform(0, 2 * np.pi, n)
        wi = direction(theta_i, phi)
        directions = (-wi).astype(np.float32)
        bounces = np.zeros(n, int)
        histogram = np.zeros((90, 180))
        alive = np.arange(n)
        for _ in range(10_000):
            if not len(alive):
                break
            o, d = origins[alive], directions[alive]
            answer = self._scene.run(o, d, output=True)
            hit = answer["primID"] >= 0
            o, d = o.copy(), d.copy()
            normal = self._normals[answer["primID"][hit]]
            o[hit] += d[hit] * answer["tfar"][hit, None] + 5e-7 * normal
            d[hit] -= 2 * np.sum(d[hit] * normal, axis=1, keepdims=True) * normal
            gone = self._cross(o, d, ~hit)
            origins[alive], directions[alive] = o, d
            bounces[alive[hit]] += 1
            self._bin(histogram, directions[alive[gone]], phi[alive[gone]])
            alive = alive[~gone & (bounces[alive] < 256)]
        return histogram.sum() / n

    def _cross(self, o: NDArray, d: NDArray, miss: NDArray) -> NDArray:
        """Wrap rays that hit nothing to the opposite face, in place; returns those that left above."""
        with np.errstate(divide="ignore", invalid="ignore"):
            to_face = np.where(d[:, :2] > 0, (1 - o[:, :2]) / d[:, :2], -o[:, :2] / d[:, :2])
            up = np.where(d[:, 2] > 0, (self._top - o[:, 2]) / d[:, 2], np.inf)
        to_face = np.where(d[:, :2] == 0, np.inf, to_face)
        axis = np.argmin(to_face, axis=1)
        distance = to_face[np.arange(len(o)), axis]
        gone = miss & (up <= distance)
        wrap = np.flatnonzero(miss & ~gone)
        o[wrap] += d[wrap] * distance[wrap, None]
        o[wrap, axis[wrap]] = np.where(d[wrap, axis[wrap]] > 0, 0.0, 1.0)
        return gone

    @staticmethod
    def _bin(histogram: NDArray, d: NDArray, phi: NDArray) -> None:
        theta = np.degrees(np.arccos(np.clip(d[:, 2], -1, 1)))
        delta = np.degrees(np.abs(np.angle(np.exp(1j * (np.arctan2(d[:, 1], d[:, 0]) - phi)))))
        cells = (np.minimum(theta.astype(int), 89), np.minimum(delta.astype(int), 179))
        np.add.at(histogram, cells, 1.0)
