"""Images with error bars, as OpenEXR and as PNG to look at. The only module that knows OpenEXR."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import OpenEXR
from numpy.typing import ArrayLike, NDArray

from gonio.files import atomic
from microgeometry.errors import InputError

_ERROR = "std_error"
_PROVENANCE = "gonio_provenance"


@dataclass(frozen=True, eq=False)
class Image:
    """Radiance of every pixel and how sure it is.

    Parameters
    ----------
    pixels : ndarray, shape (H, W, 3)
        Linear RGB (BT.709), mean over the samples of the pixel (box filter).
    std_error : ndarray, shape (H, W, 3)
        Standard error of that mean, from the samples' variance; infinite after a single sample.
    provenance : mapping
        spp, seed, seconds, paths_per_second, rays_per_second, dropped (samples that were not finite).
    """

    pixels: NDArray[np.float64]
    std_error: NDArray[np.float64]
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def noise(self) -> float:
        """Root mean square of the standard errors over the root mean square of the pixels."""
        power = np.sqrt(np.mean(self.pixels**2))
        return float(np.sqrt(np.mean(self.std_error**2)) / power) if power > 0 else 0.0

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an EXR (radiance and ``std_error`` layer, float32) or, by suffix, a tone-mapped PNG.

        Raises
        ------
        InputError
            The suffix is neither .exr nor .png.
        OSError
            The file cannot be written; what stood there before is kept.
        """
        suffix = Path(path).suffix.lower()
        if suffix == ".png":
            write_png(path, tone_map(self.pixels))
        elif suffix == ".exr":
            layers = {"RGB": self.pixels, _ERROR: np.minimum(self.std_error, np.finfo(np.float32).max)}
            write_exr(path, layers, self.provenance)
        else:
            raise InputError(
                f"{path}: images are written as .exr or .png, not {suffix or 'without suffix'!r}"
            )

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Image:
        """Read an EXR of radiance; without a ``std_error`` layer the error is unknown (NaN).

        Raises
        ------
        InputError
            The file is missing or no EXR with R, G and B (or Y).
        """
        pixels = read_exr(path)
        header, channels = _read(Path(path))
        names = [f"{_ERROR}.{c}" for c in "RGB"]
        std_error = np.full_like(pixels, np.nan)
        if all(n in channels for n in names):
            std_error = np.stack([channels[n] for n in names], axis=-1).astype(np.float64)
        try:
            provenance = json.loads(header.get(_PROVENANCE, "{}"))
        except (TypeError, ValueError):
            provenance = {}
        return cls(pixels, std_error, provenance)


def write_exr(
    path: str | os.PathLike[str], layers: Mapping[str, ArrayLike], provenance: Mapping[str, Any] | None = None
) -> None:
    """Write RGB layers of one size, float32, ZIP-compressed, atomically.

    Parameters
    ----------
    path : path
    layers : mapping of str to array_like, shape (H, W, 3)
        "RGB" is the picture; other names become layers.
    provenance : mapping, optional
        Kept as JSON in the header.
    """
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        _PROVENANCE: json.dumps(dict(provenance or {})),
    }
    arrays = {name: np.ascontiguousarray(layer, np.float32) for name, layer in layers.items()}
    with atomic(path) as temporary:
        try:
            OpenEXR.File(header, arrays).write(str(temporary))
        except RuntimeError as error:
            raise OSError(None, str(error)) from None


def read_exr(path: str | os.PathLike[str]) -> NDArray[np.float64]:
    """Read the picture of an EXR: R, G and B, or Y as grey; shape (H, W, 3).

    Raises
    ------
    InputError
        The file is missing or no EXR with these channels.
    """
    path = Path(path)
    _, channels = _read(path)
    names = "RGB" if all(c in channels for c in "RGB") else "YYY"
    if names[0] not in channels:
        found = ", ".join(sorted(channels)) or "none"
        raise InputError(f"{path}: has channels {found}; R, G and B, or Y, are needed")
    return np.stack([channels[c] for c in names], axis=-1).astype(np.float64)


def _read(path: Path) -> tuple[dict[str, Any], dict[str, NDArray]]:
    try:
        with open(path, "rb") as file:
            magic = file.read(4)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    if magic != b"\x76\x2f\x31\x01":
        raise InputError(f"{path}: is not an OpenEXR file; a lat-long or rendered .exr is needed")
    try:
        file_exr = OpenEXR.File(str(path), separate_channels=True)
        return file_exr.header(), {name: c.pixels for name, c in file_exr.channels().items()}
    except RuntimeError as error:
        raise InputError(f"{path}: damaged OpenEXR file: {' '.join(str(error).split())}") from None


def exposure_of(pixels: ArrayLike) -> float:
    """Factor that puts the 98th percentile of the brightest channel at 0.9 of white; 1 for a black image."""
    brightest = np.max(np.asarray(pixels, np.float64), axis=-1)
    level = float(np.percentile(brightest, 98))
    return 0.9 / level if level > 0 else 1.0


def tone_map(pixels: ArrayLike, exposure: float | None = None) -> NDArray[np.uint8]:
    """Eight-bit sRGB (IEC 61966-2-1) of linear radiance, clipped at white.

    Parameters
    ----------
    pixels : array_like, shape (H, W, 3)
    exposure : float, optional
        Factor before clipping; `exposure_of` by default.

    Returns
    -------
    ndarray of uint8, shape (H, W, 3)
    """
    pixels = np.asarray(pixels, np.float64)
    x = np.clip(pixels * (exposure_of(pixels) if exposure is None else exposure), 0.0, 1.0)
    encoded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return np.rint(255 * encoded).astype(np.uint8)


def write_png(path: str | os.PathLike[str], pixels: NDArray[np.uint8]) -> None:
    """Write an eight-bit image of shape (H, W, 3) atomically."""
    with atomic(path) as temporary:
        matplotlib.image.imsave(temporary, pixels, format="png")
