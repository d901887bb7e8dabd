"""Random height fields from a power spectrum: what the surfaces of this kind share.

White noise is filtered by the square root of the spectrum, so a tile is exactly periodic. A spectrum is a
table of mode variances in the layout of a real FFT: shape (n, n // 2 + 1), the second axis the half that
determines the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import TypeVar

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from microgeometry.keys import Keys

# Below 4 samples per correlation length, facets cut the curvature of the surface (a facet then turns by
# more than half the rms slope from one to the next); below 8 correlation lengths per tile, a tile has
# too few independent hills and the period shows.
MIN_SAMPLES_PER_LENGTH = 4.0
MIN_LENGTHS_PER_TILE = 8.0
# Rounding must not refuse a size that says the limit: 512 samples over 64 lengths.
SLACK = 1 - 1e-6


def filtered_noise(samples: int, seed: int, *filters: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the realisation of a seed, without its mean.

    Parameters
    ----------
    samples : int
        n, per side.
    seed : int
    *filters : ndarray, broadcast to (n, n // 2 + 1)
        Their product is the amplitude of each mode times n: the variance of the heights, over
        realisations, is the sum of its square over all n^2 modes but (0, 0), divided by n^2.

    Returns
    -------
    ndarray, shape (n, n)
    """
    noise = np.random.Generator(np.random.PCG64(seed)).standard_normal((samples, samples))
    spectrum = scipy.fft.rfft2(noise, workers=2, overwrite_x=True)
    for factor in filters:
        spectrum *= factor
    spectrum[0, 0] = 0.0
    return scipy.fft.irfft2(spectrum, s=(samples, samples), workers=2, overwrite_x=True)


def mesh_scale(
    alpha: float | None,
    rms_height: float | None,
    power: NDArray[np.float64],
    step: tuple[float, float],
) -> float:
    """Factor on modes of variance `power` that gives the statistic asked for, in expectation.

    The statistic is that of the *triangles*, ``HeightField.statistics()``, squared.

    Parameters
    ----------
    alpha, rms_height : float or None
        Exactly one is not None; metres.
    power : ndarray, shape (n, n // 2 + 1)
        Mode variances; even along each axis. That of mode (0, 0) is ignored.
    step : tuple of float
        Distance of the samples along x and y, metres.

    Returns
    -------
    float
        0 where 0 was asked for.
    """
    samples = len(power)
    east = np.cos(2.0 * np.pi * scipy.fft.fftfreq(samples))[:, None]
    north = np.cos(2.0 * np.pi * scipy.fft.rfftfreq(samples))[None, :]
    # Every column but the first, and the last of an even n, stands for its mirror image too.
    weight = np.full(power.shape[1], 2.0)
    weight[0] = 1.0
    if samples % 2 == 0:
        weight[-1] = 1.0
    modes = power * weight
    modes[0, 0] = 0.0
    if alpha is not None:
        # Forward difference: |e^{i phase} - 1|^2 = 2 (1 - cos phase), along x and along y.
        differences = (2.0 - 2.0 * east) / step[0] ** 2 + (2.0 - 2.0 * north) / step[1] ** 2
        return alpha / sqrt(np.sum(modes * differences))
    assert rms_height is not None
    # Mean of z^2 over a triangle, (3 + cos along x + cos along y + cos along the diagonal) / 6 of the
    # samples' variance; in the diagonal's cos(x - y) the sines cancel over +-k.
    return rms_height / sqrt(np.sum(modes * (3.0 + east + north + east * north)) / 6.0)


Field = TypeVar("Field", bound="CorrelatedField")


@dataclass(frozen=True)
class CorrelatedField:
    """Keys and attributes of a height field given by its roughness and correlation length.

    Attributes
    ----------
    alpha, rms_height : float or None
        Exactly one is set: the roughness sqrt(<hx^2 + hy^2>), or the rms height in metres.
    correlation_length : float
        Along x, metres.
    samples : int
        Per side.
    size : float
        Period along x, metres.
    stretch : float
        Correlation length, and period, along y in units of those along x.
    """

    alpha: float | None
    rms_height: float | None
    correlation_length: float
    samples: int
    size: float
    stretch: float = 1.0

    @property
    def periods(self) -> tuple[float, float]:
        """Periods (Lx, Ly) of the tile, metres."""
        return self.size, self.size * self.stretch

    @classmethod
    def read(cls: type[Field], keys: Keys) -> Field:
        """Build from the [surface] table. Raises `InputError`."""
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
        alpha, rms_height = read_roughness(keys, unit)
        lengths = read_lengths(keys, "correlation_length", alpha is None)
        length = lengths[0] * unit
        samples = keys.integer("samples", 512, at_least=32, at_most=8192)
        if "size" in keys and "samples_per_correlation_length" in keys:
            raise keys.error(
                "size",
                "give size or samples_per_correlation_length, not both: "
                "size = samples / samples_per_correlation_length lengths",
            )
        if "size" in keys:
            size = keys.number("size", above=0) * unit
            _check_sampling(keys, "size", samples, samples * length / size)
        else:
            per_length = keys.number("samples_per_correlation_length", 16.0, above=0)
            _check_sampling(keys, "samples_per_correlation_length", samples, per_length)
            size = samples * length / per_length
        return cls(alpha, rms_height, length, samples, size, lengths[-1] / lengths[0])


def read_roughness(keys: Keys, unit: float) -> tuple[float | None, float | None]:
    """Read ``alpha``, or ``rms_height`` in metres: one is a number, the other None."""
    if "alpha" in keys and "rms_height" in keys:
        raise keys.error(
            "rms_height",
            "give alpha or rms_height, not both: with the lengths of the surface one follows from the other",
        )
    if "rms_height" in keys:
        return None, keys.number("rms_height", at_least=0) * unit
    return keys.number("alpha", at_least=0), None


def read_lengths(keys: Keys, key: str, required: bool) -> tuple[float, ...]:
    """Read a length, or two: [along x, along y]. Where it is not required, 1."""
    if key not in keys and not required:
        return (1.0,)
    lengths = keys.numbers(key, above=0)
    if len(lengths) > 2:
        raise keys.error(key, "must be one number, or two: [along x, along y]")
    return lengths


def _check_sampling(keys: Keys, key: str, samples: int, per_length: float) -> None:
    if per_length < MIN_SAMPLES_PER_LENGTH * SLACK:
        raise keys.error(
            key,
            f"{per_length:.3g} samples per correlation length do not resolve the "
            f"surface; at least {MIN_SAMPLES_PER_LENGTH:g} are needed: raise samples "
            "or make the tile smaller",
        )
    lengths = samples / per_length
    if lengths < MIN_LENGTHS_PER_TILE * SLACK:
        raise keys.error(
            key,
            f"the tile of {samples} samples is {lengths:.3g} correlation lengths wide; "
            f"at least {MIN_LENGTHS_PER_TILE:g} are needed: raise samples or make the "
            "tile larger (fewer samples per correlation length)",
        )
