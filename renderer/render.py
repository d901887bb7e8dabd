"""Rendering: a scene in, an image with error bars out."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from gonio.core.parallel import check_threads, for_each
from gonio.progress import Report
from microgeometry.errors import InputError
from renderer.image import Image
from renderer.integrator import BLOCK, new_scratch, render_blocks
from renderer.pack import Packed, pack
from renderer.scene import Scene

_SECONDS_PER_PASS = 1.0
_BLOCKS_PER_TASK = 64


def render(
    scene: Scene,
    *,
    spp: int | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: Report | None = None,
    stop: Callable[[], bool] | None = None,
    strategy: str = "mis",
) -> Image:
    """Take the picture of a scene.

    Parameters
    ----------
    scene : Scene
    spp : int, optional
        Samples a pixel; the scene's own number by default.
    seed : int
        Pictures of different seeds are independent; the same seed gives the same bits, whatever the
        number of threads.
    threads : int, optional
        One a processor by default.
    progress : callable, optional
        Called about every second with the fraction done and a few words.
    stop : callable, optional
        Asked after every pass (about a second); when it says True, what there is is returned.
    strategy : {"mis", "material", "light"}
        How paths find light; for tests.

    Returns
    -------
    Image
        Mean and standard error of every pixel.

    Raises
    ------
    InputError
        `spp`, `threads` or the scene is out of range.
    """
    spp = scene.spp if spp is None else spp
    if not 1 <= spp < 2**31:
        raise InputError(f"spp is {spp}; at least 1 sample a pixel is needed")
    threads = check_threads(threads)
    packed = pack(scene, strategy)
    film = _Film(scene)
    film.run(packed, 0, 0, seed, threads)  # compiles, if need be, before the clock starts
    start = time.perf_counter()
    done, size = 0, 1
    while done < spp:
        begin = time.perf_counter()
        last = min(spp, done + size)
        film.run(packed, done, last, seed, threads)
        per_sample = (time.perf_counter() - begin) / (last - done)
        size, done = max(1, min(4 * size, int(_SECONDS_PER_PASS / per_sample))), last
        if progress is not None:
            rate = done * film.n_pixels / (time.perf_counter() - start)
            progress(done / spp, f"{done} of {spp} spp, {rate / 1e6:.2f} M paths/s")
        if stop is not None and stop():
            break
    return film.image(done, time.perf_counter() - start, seed)


class _Film:
    """Sums of the samples of every pixel, and how to get more."""

    def __init__(self, scene: Scene) -> None:
        self.width, self.height = scene.camera.width, scene.camera.height
        self.n_pixels = self.width * self.height
        self.sums = np.zeros((self.height, self.width, 3))
        self.squares = np.zeros_like(self.sums)
        self.n_rays = self.n_dropped = 0

    def run(self, packed: Packed, first: int, last: int, seed: int, threads: int) -> None:
        """Take samples [first, last) of every pixel."""
        n_blocks = -(-self.width // BLOCK) * -(-self.height // BLOCK)
        # A block is one thread's, whichever comes; kernels run without the interpreter's lock.
        edges = np.arange(0, n_blocks + _BLOCKS_PER_TASK, _BLOCKS_PER_TASK).clip(max=n_blocks).tolist()

        def task(span: tuple[int, int]) -> tuple[int, int]:
            return render_blocks(
                packed.world, (self.sums, self.squares), new_scratch(), *span, first, last, seed
            )

        if first == last:
            task((0, 0))
            return
        spans = list(pairwise(edges))
        for n_rays, n_dropped in for_each(lambda unit: task(spans[unit]), len(spans), threads):
            self.n_rays += n_rays
            self.n_dropped += n_dropped

    def image(self, spp: int, seconds: float, seed: int) -> Image:
        """Mean and standard error of the mean after `spp` samples."""
        mean = self.sums / spp
        if spp > 1:
            variance = np.maximum(self.squares / spp - mean**2, 0.0) / (spp - 1)
        else:
            variance = np.full_like(mean, np.inf)
        provenance = {
            "spp": spp,
            "seed": seed,
            "seconds": round(seconds, 3),
            "paths_per_second": round(spp * self.n_pixels / seconds),
            "rays_per_second": round(self.n_rays / seconds),
            "dropped": self.n_dropped,
        }
        return Image(mean, np.sqrt(variance), provenance)
