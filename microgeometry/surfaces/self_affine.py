"""Self-affine random surface: a power law between two lengths."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from microgeometry.keys import Keys
from microgeometry.surfaces.spectral import SLACK, filtered_noise, mesh_scale, read_lengths, read_roughness
from microgeometry.tile import HeightField

# A wave of fewer samples is not a wave on triangles; a tile of fewer roll-off lengths has too few
# independent hills (about pi 4^2 / 2 modes below the roll-off) and the period shows.
MIN_SAMPLES_PER_CUTOFF = 4.0
MIN_ROLLOFFS_PER_TILE = 4.0


@dataclass(frozen=True)
class SelfAffine:
    r"""Gaussian heights whose power spectrum is a power law: polished, fractured, worn surfaces.

    With q = 2 pi / wavelength the spectrum is constant up to the roll-off, falls as
    :math:`q^{-2(1+H)}` down to the cut-off, and is zero for shorter waves: the spectrum of Persson et al.,
    J. Phys.: Condens. Matter 17, R1 (2005), equation 8, isotropic, or stretched along y.

    Brushed metal: waves some tens of times longer along y than across, ``rolloff_length = [1, 30]``, and an
    alpha of 0.1 to 0.3, almost all of which is alpha_x = sqrt(2) alpha. The scratches of a brush are of many
    widths, which a power law has and a Gaussian spectrum has not; `Exponential` is the case H = 1/2 with no
    cut-off but the sampling.

    Keys of [surface]:

    - ``hurst``: the exponent H, above 0 and at most 1 (0.8 is usual; smaller is more jagged).
    - ``rms_height`` in ``units`` ("um"), or ``alpha``.
    - ``rolloff_length`` in units (1 if alpha is given: alpha alone fixes the scale-free BRDF; required with
      rms_height): the longest wavelength of the power law. Two lengths [along x, along y] stretch the
      surface and its tile along y.
    - ``cutoff_length`` in units, along x: the shortest wavelength on the surface; by default 4 samples. The
      slopes come from the shortest waves: alpha^2 goes as cutoff_length^(2 H - 2), so state it with a result.
    - ``size`` of the tile along x in units (8 roll-off lengths), ``samples`` (512) along each side.

    What is asked for, alpha or rms_height, is the expected statistic of the triangles (see `Gaussian`).
    The tile's mean height is zero.

    Attributes
    ----------
    hurst : float
    alpha, rms_height : float or None
        Exactly one is set: the roughness sqrt(<hx^2 + hy^2>), or the rms height in metres.
    rolloff_length, cutoff_length : float
        Wavelengths along x, metres.
    samples : int
        Per side.
    size : float
        Period along x, metres.
    stretch : float
        Wavelengths, and period, along y in units of those along x.
    """

    kind: ClassVar[str] = "self_affine"
    is_random: ClassVar[bool] = True

    hurst: float
    alpha: float | None
    rms_height: float | None
    rolloff_length: float
    cutoff_length: float
    samples: int
    size: float
    stretch: float = 1.0

    @classmethod
    def from_keys(cls, keys: Keys, folder: Path) -> SelfAffine:
        """Build from the [surface] table."""
        keys.allow(
            "kind",
            "hurst",
            "alpha",
            "rms_height",
            "rolloff_length",
            "cutoff_length",
            "units",
            "size",
            "samples",
        )
        unit = keys.metres_per_unit()
        hurst = keys.number("hurst", above=0, at_most=1)
        alpha, rms_height = read_roughness(keys, unit)
        lengths = read_lengths(keys, "rolloff_length", alpha is None)
        rolloff = lengths[0] * unit
        samples = keys.integer("samples", 512, at_least=32, at_most=8192)
        size = keys.number("size", 8.0 * rolloff / unit, above=0) * unit
        if size < MIN_ROLLOFFS_PER_TILE * rolloff * SLACK:
            raise keys.error(
                "size",
                f"the tile is {size / rolloff:.3g} roll-off lengths wide; at least "
                f"{MIN_ROLLOFFS_PER_TILE:g} are needed: make it larger",
            )
        shortest = MIN_SAMPLES_PER_CUTOFF * size / samples
        cutoff = keys.number("cutoff_length", shortest / unit, above=0) * unit
        if cutoff < shortest * SLACK:
            raise keys.error(
                "cutoff_length",
                f"{samples} samples resolve no wave below {shortest / unit:.4g} units "
                f"({MIN_SAMPLES_PER_CUTOFF:g} samples): raise samples, or make the tile smaller",
            )
        if cutoff > rolloff:
            raise keys.error(
                "cutoff_length",
                f"must be at most rolloff_length ({rolloff / unit:g}): raise samples, or lower it",
            )
        return cls(hurst, alpha, rms_height, rolloff, cutoff, samples, size, lengths[-1] / lengths[0])

    def realise(self, seed: int) -> HeightField:
        """Return the realisation of a seed, shape (samples, samples)."""
        heights = filtered_noise(self.samples, seed, self._filter)
        return HeightField(heights, (self.size, self.size * self.stretch))

    @cached_property
    def _filter(self) -> NDArray[np.float64]:
        """Amplitudes of the modes, shape (n, n // 2 + 1)."""
        n, step = self.samples, self.size / self.samples
        # Waves per roll-off length; in units of the period both axes are the same.
        x, y = scipy.fft.fftfreq(n, step)[:, None], scipy.fft.rfftfreq(n, step)
        waves = np.hypot(x, y) * self.rolloff_length
        power = np.maximum(waves, 1.0) ** (-2.0 * (1.0 + self.hurst))
        # A mode at the cut-off itself is kept, whatever rounding makes of it.
        power[waves * self.cutoff_length * SLACK > self.rolloff_length] = 0.0
        scale = mesh_scale(self.alpha, self.rms_height, power, (step, step * self.stretch))
        return n * scale * np.sqrt(power)
