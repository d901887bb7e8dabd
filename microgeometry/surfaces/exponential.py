"""Random rough surface with Gaussian heights and exponential autocorrelation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from microgeometry.keys import Keys
from microgeometry.surfaces.spectral import CorrelatedField, filtered_noise, mesh_scale
from microgeometry.tile import HeightField

# Periods on either side whose correlation reaches into a tile: the next is at least 2.5 * 8 correlation
# lengths away, where e^-r is 2e-9.
_IMAGES = 2


@dataclass(frozen=True)
class Exponential(CorrelatedField):
    r"""Height field with autocorrelation :math:`\rho(r) = e^{-r/l}`: ground, etched and worn surfaces.

    Keys of [surface]: those of `Gaussian`. With two correlation lengths, r^2 / l^2 is
    x^2 / lx^2 + y^2 / ly^2.

    The continuous surface has no slope: its slope variance is infinite, and what facets see depends on
    their size. Samples dx apart have a difference quotient of variance 2 rms^2 (1 - e^{-dx/l}) / dx^2, so

        alpha^2 = 4 rms_height^2 (1 - e^{-dx/l}) / dx^2, about 4 rms_height^2 / (l dx)

    for equal lengths. ``alpha`` therefore means: of the triangles, in expectation, at this sampling, as for
    `Gaussian`; with ``rms_height`` given, alpha grows as the square root of
    ``samples_per_correlation_length``. A result stated without the sampling says little.

    The modes' variances are the transform of the sampled, periodic autocorrelation, not samples of the
    continuous spectrum (1 + k^2 l^2)^{-3/2}: so the samples have the autocorrelation asked for at every
    distance, and nothing is cut off at the highest frequency. The tile's mean height is zero.

    Attributes: see `CorrelatedField`.
    """

    kind: ClassVar[str] = "exponential"
    is_random: ClassVar[bool] = True

    @classmethod
    def from_keys(cls, keys: Keys, folder: Path) -> Exponential:
        """Build from the [surface] table."""
        return cls.read(keys)

    def realise(self, seed: int) -> HeightField:
        """Return the realisation of a seed, shape (samples, samples)."""
        return HeightField(filtered_noise(self.samples, seed, self._filter), self.periods)

    @cached_property
    def _filter(self) -> NDArray[np.float64]:
        """Amplitudes of the modes, shape (n, n // 2 + 1)."""
        n = self.samples
        # Distances in correlation lengths, the same along both axes. One quarter says it all.
        steps = np.arange(n // 2 + 1)[:, None] + n * np.arange(-_IMAGES, _IMAGES + 1)
        squares = (steps * (self.size / n / self.correlation_length)) ** 2
        quarter = np.zeros((n // 2 + 1, n // 2 + 1))
        for x_squared in squares.T:
            for y_squared in squares.T:
                quarter += np.exp(-np.sqrt(x_squared[:, None] + y_squared))
        mirror = np.minimum(np.arange(n), n - np.arange(n))
        power = scipy.fft.rfft2(quarter[np.ix_(mirror, mirror)], workers=2).real
        step = (self.periods[0] / n, self.periods[1] / n)
        # A correlation's transform is not negative, but for rounding.
        return n * mesh_scale(self.alpha, self.rms_height, power, step) * np.sqrt(np.maximum(power, 0.0))
