import numpy as np
import pytest

from microgeometry.surfaces.spectral import mesh_scale
from microgeometry.tile import HeightField


@pytest.mark.parametrize("samples", [6, 7])
@pytest.mark.parametrize("statistic", ["alpha", "rms_height"])
def test_scale_is_exact(samples, statistic):
    # The expected square of a statistic is the sum over modes of each one's own: a wave exp(i phase), that
    # is its cosine and its sine, each of half the mode's variance (the mean of a cosine's square).
    step = (0.3, 0.7)
    rng = np.random.default_rng(1)
    fold = np.minimum(np.arange(samples), samples - np.arange(samples))
    power = rng.uniform(size=(samples, samples))[np.ix_(fold, fold)]  # even along each axis
    n, expected = np.arange(samples), 0.0
    for a in range(samples):
        for b in range(samples):
            phase = 2 * np.pi * (a * n[:, None] + b * n) / samples
            for wave in (np.cos(phase), np.sin(phase)):
                if a or b:
                    tile = HeightField(wave, (samples * step[0], samples * step[1]))
                    expected += power[a, b] * getattr(tile.statistics(), statistic) ** 2
    wanted = {"alpha": None, "rms_height": None, statistic: 0.5}
    scale = mesh_scale(*wanted.values(), power[:, : samples // 2 + 1], step)
    assert scale**2 * expected == pytest.approx(0.25, rel=1e-12)
