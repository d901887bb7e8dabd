"""Random rough surface with Gaussian heights and Gaussian autocorrelation."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from pathlib import Path
from typing import ClassVar

import numpy as np
import scipy.fft

from microgeometry.keys import Keys
from microgeometry.tile import HeightField

# Below 4 samples per correlation length, facets cut the curvature of the surface (a facet then turns by
# more than half the rms slope from one to the next); below 8 correlation lengths per tile, a tile has
# too few independent hills and the period shows.
MIN_SAMPLES_PER_LENGTH = 4.0
MIN_LENGTHS_PER_TILE = 8.0


@dataclass(frozen=True)
class Gaussian:
    r"""Height field with autocorrelation :math:`\rho(r) = e^{-r^2/l^2}`.

    Keys of [surface]: either ``alpha`` (Beckmann roughness, 0.1 is satin, 0.5 rough), or ``rms_height``
    in ``units`` ("um"); ``correlation_length`` in units (1 if alpha is given: alpha alone fixes the BRDF
    in geometric optics, which knows no scale; required with rms_height); ``samples`` (512) along each side
    of the tile; and either ``samples_per_correlation_length`` (16) or ``size`` of the tile in units.

    On the continuous surface alpha = 2 rms_height / correlation_length. What is asked for is here the
    *expected* statistic of the *triangles*: the facets' slopes are finite differences, which see less
    than the derivative (0.2 % less variance at 16 samples per correlation length, 3 % at 4), so the
    spectrum is scaled by the exact expectation of ``HeightField.statistics().alpha ** 2`` (or
    ``rms_height ** 2``), not by the integral of the continuous spectrum. A single realisation scatters
    about it, as a piece of a real surface does; rescaling each to its own rms would take that scatter out
    of the error bars and bias everything that is not linear in it.

    The method is the usual one: white noise filtered by the square root of the power spectrum
    :math:`\propto e^{-k^2 l^2/4}`, so the tile is exactly periodic. The tile's mean height is zero.

    Attributes
    ----------
    alpha, rms_height : float or None
        Exactly one is set: the Beckmann roughness, or the rms height in metres.
    correlation_length : float
        Metres.
    samples : int
        Per side.
    size : float
        Period, metres.
    """

    kind: ClassVar[str] = "gaussian"
    is_random: ClassVar[bool] = True

    alpha: float | None
    rms_height: float | None
    correlation_length: float
    samples: int
    size: float

    @classmethod
    def from_keys(cls, keys: Keys, folder: Path) -> Gaussian:
        """Build from the [surface] table."""
        keys.allow(
            "kind",
            "alpha",
            "rms_height",
            "correlation_length",
            "units",
            "samples",
            "samples_per_correlation_length",
            "size",
        )
        unit = keys.metres_per_unit()
        if "alpha" in keys and "rms_height" in keys:
            raise keys.error(
                "rms_height",
                "give alpha or rms_height, not both: with the correlation length "
                "one follows from the other (alpha = 2 rms_height / length)",
            )
        alpha = rms_height = None
        if "rms_height" in keys:
            rms_height = keys.number("rms_height", at_least=0) * unit
            length = keys.number("correlation_length", above=0) * unit
        else:
            alpha = keys.number("alpha", at_least=0)
            length = keys.number("correlation_length", 1.0, above=0) * unit
        samples = keys.integer("samples", 512, at_least=32, at_most=8192)
        if "size" in keys and "samples_per_correlation_length" in keys:
            raise keys.error(
                "size",
                "give size or samples_per_correlation_length, not both: "
                "size = samples / samples_per_correlation_length lengths",
            )
        if "size" in keys:
            size = keys.number("size", above=0) * unit
            cls._check_sampling(keys, "size", samples, samples * length / size)
        else:
            per_length = keys.number("samples_per_correlation_length", 16.0, above=0)
            cls._check_sampling(keys, "samples_per_correlation_length", samples, per_length)
            size = samples * length / per_length
        return cls(alpha, rms_height, length, samples, size)

    @staticmethod
    def _check_sampling(keys: Keys, key: str, samples: int, per_length: float) -> None:
        # A millionth of slack: 512 samples over a size of 64 lengths must not fail by rounding.
        if per_length < MIN_SAMPLES_PER_LENGTH * (1 - 1e-6):
            raise keys.error(
                key,
                f"{per_length:.3g} samples per correlation length do not resolve the "
                f"surface; at least {MIN_SAMPLES_PER_LENGTH:g} are needed: raise samples "
                "or make the tile smaller",
            )
        lengths = samples / per_length
        if lengths < MIN_LENGTHS_PER_TILE * (1 - 1e-6):
            raise keys.error(
                key,
                f"the tile of {samples} samples is {lengths:.3g} correlation lengths wide; "
                f"at least {MIN_LENGTHS_PER_TILE:g} are needed: raise samples or make the "
                "tile larger (fewer samples per correlation length)",
            )

    def realise(self, seed: int) -> HeightField:
        """Return the realisation of a seed, shape (samples, samples)."""
        n = self.samples
        # Square root of the power spectrum along one axis (the spectrum is a product), modes in FFT order.
        k = 2.0 * np.pi * scipy.fft.fftfreq(n, d=self.size / n)
        root = np.exp(-0.125 * (k * self.correlation_length) ** 2)
        amplitude = n * self._scale(root**2, 2.0 * np.pi * scipy.fft.fftfreq(n))
        noise = np.random.Generator(np.random.PCG64(seed)).standard_normal((n, n))
        spectrum = scipy.fft.rfft2(noise, workers=2, overwrite_x=True)
        spectrum *= root[:, None]
        spectrum *= amplitude * root[: n // 2 + 1]
        spectrum[0, 0] = 0.0
        heights = scipy.fft.irfft2(spectrum, s=(n, n), workers=2, overwrite_x=True)
        return HeightField(heights, (self.size, self.size))

    def _scale(self, power: np.ndarray, phase: np.ndarray) -> float:
        """Factor on unit-variance modes that gives the statistic asked for in expectation.

        `power` (n,) is the spectrum of one axis, `phase` (n,) the mode's phase step k dx between samples.
        With P = sum power, C = sum power cos(phase), mode (a, b) has variance scale^2 p_a p_b.
        """
        total, cosine = power.sum(), (power * np.cos(phase)).sum()
        if self.alpha is not None:
            # Forward difference along x: |e^{i phase} - 1|^2 = 2 (1 - cos phase); the same along y.
            step = self.size / self.samples
            return self.alpha / sqrt(4.0 * (total - cosine) * total) * step
        assert self.rms_height is not None
        # Mean of z^2 over a triangle, (3 + cos along x + cos along y + cos along the diagonal) / 6 of the
        # samples' variance; in the diagonal's cos(x - y) the sines cancel over +-k. Less the mean (0, 0).
        return self.rms_height / sqrt((3.0 * total**2 + 2.0 * total * cosine + cosine**2) / 6.0 - 1.0)
