"""The loop of `gonio bench trace` as one writes it with Mitsuba 3 and its LLVM backend.

A program of its own, for a Python that has Mitsuba and nothing of ours: reads an .npz (vertices, faces of one
period, widths, top, angles of incidence, paths) and prints paths/s and albedo of each angle as JSON. The whole
path, from its origin to the cell it is counted in, is one fused kernel; origins are stratified in Morton order. Twice:
with an azimuth for every path, as one writes it, and with one for every 16 paths, as the instrument has it,
which keeps the packets that Mitsuba gives to Embree coherent.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")

_MAX_SEGMENTS = 10_000
_LIFT = 1e-6  # of the tile's width, off the facet
_REPEATS = 5
_SHARED = 4  # log2 of the paths of one azimuth


def _even_bits(x: Any) -> Any:
    """Every other bit of a word, moved together: a coordinate of a Morton number."""
    x = x & 0x55555555
    for shift, mask in ((1, 0x33333333), (2, 0x0F0F0F0F), (4, 0x00FF00FF), (8, 0x0000FFFF)):
        x = (x | (x >> shift)) & mask
    return x


@dr.syntax
def _follow(scene: Any, o: Any, d: Any, width: float, top: float) -> Any:
    """Follow rays over a periodic tile of mirrors; returns their last directions."""
    active = mi.Bool(True)
    segments = mi.UInt32(0)
    while active:
        ray = mi.Ray3f(o, d)
        hit = scene.ray_intersect_preliminary(ray, coherent=True, active=active)
        n = hit.compute_surface_interaction(ray, mi.RayFlags.Minimal, active).n
        met = active & hit.is_valid()
        to_x = (dr.select(d.x > 0, width, 0.0) - o.x) / d.x
        to_y = (dr.select(d.y > 0, width, 0.0) - o.y) / d.y
        to_z = dr.select(d.z > 0, (top - o.z) / d.z, dr.inf)
        wraps = ~met & (dr.minimum(to_x, to_y) < to_z)
        away = o + d * dr.minimum(to_x, to_y)
        by_x = to_x < to_y
        away.x = dr.select(by_x, dr.select(d.x > 0, 0.0, width), away.x)
        away.y = dr.select(by_x, away.y, dr.select(d.y > 0, 0.0, width))
        there = o + d * hit.t + n * (_LIFT * width)
        along = dr.dot(d, n)
        o = dr.select(met, there, dr.select(wraps, away, o))
        d = dr.select(met & (along < 0), d - 2 * along * n, d)
        segments += 1
        active &= (met | wraps) & (segments < _MAX_SEGMENTS)
    return d


def _batch(
    scene: Any, width: float, top: float, theta: float, side: int, seed: int, shared: int, cells: Any
) -> None:
    """Trace side^2 paths, 2^shared of which have one azimuth, and count them in 90 x 180 cells."""
    index = dr.arange(mi.UInt32, side * side)
    i, j = _even_bits(index >> 1), _even_bits(index)
    seed = dr.opaque(mi.UInt32, seed)  # else each seed is another kernel to compile
    phi = 2 * dr.pi * mi.sample_tea_float32(index >> shared, seed)
    random = mi.PCG32(size=side * side, initstate=seed)
    x, y = (i + random.next_float32()) * (width / side), (j + random.next_float32()) * (width / side)
    sine, cosine = float(np.sin(theta)), float(np.cos(theta))
    start = mi.Vector3f(-sine * dr.cos(phi), -sine * dr.sin(phi), -cosine)
    d = _follow(scene, mi.Point3f(x, y, top), mi.Vector3f(start), width, top)
    ring = mi.UInt32(dr.minimum(dr.rad2deg(dr.acos(dr.clip(d.z, -1, 1))), 89))
    across = dr.rsqrt(dr.maximum(d.x * d.x + d.y * d.y, 1e-30))
    turn = dr.acos(dr.clip((d.x * dr.cos(phi) + d.y * dr.sin(phi)) * across, -1, 1))
    sector = mi.UInt32(dr.minimum(dr.rad2deg(turn), 179))
    dr.scatter_reduce(dr.ReduceOp.Add, cells, mi.UInt32(1), ring * 180 + sector, d.z > 0)
    dr.eval(cells)
    dr.sync_thread()


def main(path: str) -> None:
    """Measure every angle."""
    given = np.load(path)
    mesh = mi.Mesh("tile", len(given["vertices"]), len(given["faces"]))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.ravel(given["vertices"]).astype(np.float32)
    parameters["faces"] = np.ravel(given["faces"]).astype(np.uint32)
    parameters.update()
    scene = mi.load_dict({"type": "scene", "tile": mesh})
    side = 1 << (int(given["paths"]).bit_length() // 2)
    results = []
    for theta in np.radians(given["theta_i_deg"]):
        result = {}
        for name, shared in (("paths_per_second", 0), ("coherent_paths_per_second", _SHARED)):
            best = 0.0
            for seed in range(_REPEATS + 1):  # the first compiles
                cells = dr.zeros(mi.UInt32, 90 * 180)
                dr.eval(cells)
                started = time.perf_counter()
                _batch(
                    scene, float(given["width"]), float(given["top"]), float(theta), side, seed, shared, cells
                )
                if seed:
                    best = max(best, side * side / (time.perf_counter() - started))
            result[name] = best
            result["albedo"] = float(np.sum(cells.numpy())) / side**2
        results.append(result)
    print(json.dumps(results))


if __name__ == "__main__":
    main(sys.argv[1])
