"""Random rough surface with Gaussian heights and Gaussian autocorrelation."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from pathlib import Path
from typing import ClassVar

import numpy as np
import scipy.fft

from microgeometry.keys import Keys
from microgeometry.surfaces.spectral import CorrelatedField, filtered_noise
from microgeometry.tile import HeightField


@dataclass(frozen=True)
class Gaussian(CorrelatedField):
    r"""Height field with autocorrelation :math:`\rho(r) = e^{-r^2/l^2}`.

    Keys of [surface]:

    - ``alpha`` (Beckmann roughness, 0.1 is satin, 0.5 rough), or ``rms_height`` in ``units`` ("um").
    - ``correlation_length`` in units: 1 if alpha is given (alpha alone fixes the BRDF in geometric optics,
      which knows no scale), required with rms_height. Two lengths [along x, along y] stretch the surface and
      its tile along y; alpha_x / alpha_y is then ly / lx.
    - ``samples`` (512) along each side of the tile, and ``samples_per_correlation_length`` (16) or ``size`` of
      the tile along x in units.

    On the continuous surface alpha^2 = 2 rms_height^2 (1 / lx^2 + 1 / ly^2), so alpha = 2 rms_height / l if
    the lengths are equal. What is asked for is here the
    *expected* statistic of the *triangles*: the facets' slopes are finite differences, which see less
    than the derivative (0.2 % less variance at 16 samples per correlation length, 3 % at 4), so the
    spectrum is scaled by the exact expectation of ``HeightField.statistics().alpha ** 2`` (or
    ``rms_height ** 2``), not by the integral of the continuous spectrum. A single realisation scatters
    about it, as a piece of a real surface does; rescaling each to its own rms would take that scatter out
    of the error bars and bias everything that is not linear in it.

    The method is the usual one: white noise filtered by the square root of the power spectrum
    :math:`\propto e^{-k^2 l^2/4}`, so the tile is exactly periodic. The tile's mean height is zero.

    Attributes: see `CorrelatedField`.
    """

    kind: ClassVar[str] = "gaussian"
    is_random: ClassVar[bool] = True

    @classmethod
    def from_keys(cls, keys: Keys, folder: Path) -> Gaussian:
        """Build from the [surface] table."""
        return cls.read(keys)

    def realise(self, seed: int) -> HeightField:
        """Return the realisation of a seed, shape (samples, samples)."""
        n = self.samples
        # Square root of the power spectrum along one axis (the spectrum is a product), modes in FFT order.
        # In units of the period both axes are the same, however the tile is stretched.
        k = 2.0 * np.pi * scipy.fft.fftfreq(n, d=self.size / n)
        root = np.exp(-0.125 * (k * self.correlation_length) ** 2)
        amplitude = n * self._scale(root**2, 2.0 * np.pi * scipy.fft.fftfreq(n))
        heights = filtered_noise(n, seed, root[:, None], amplitude * root[: n // 2 + 1])
        return HeightField(heights, self.periods)

    def _scale(self, power: np.ndarray, phase: np.ndarray) -> float:
        """Factor on unit-variance modes that gives the statistic asked for in expectation.

        `spectral.mesh_scale` for a spectrum that is a product, in n steps instead of n^2: `power` (n,) is
        the spectrum of one axis, `phase` (n,) the mode's phase step k dx between samples. With
        P = sum power, C = sum power cos(phase), mode (a, b) has variance scale^2 p_a p_b.
        """
        total, cosine = power.sum(), (power * np.cos(phase)).sum()
        if self.alpha is not None:
            # Forward difference along x: |e^{i phase} - 1|^2 = 2 (1 - cos phase); the same along y, over
            # a longer step.
            step = self.size / self.samples
            along_y = 1.0 / self.stretch**2
            return self.alpha / sqrt(2.0 * (1.0 + along_y) * (total - cosine) * total) * step
        assert self.rms_height is not None
        # Mean of z^2 over a triangle, (3 + cos along x + cos along y + cos along the diagonal) / 6 of the
        # samples' variance; in the diagonal's cos(x - y) the sines cancel over +-k. Less the mean (0, 0).
        return self.rms_height / sqrt((3.0 * total**2 + 2.0 * total * cosine + cosine**2) / 6.0 - 1.0)
