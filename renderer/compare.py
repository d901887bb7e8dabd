"""Comparing pictures: numbers that separate real differences from noise, and panels side by side."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from gonio.files import atomic
from microgeometry.errors import InputError
from renderer.image import Image, exposure_of, tone_map


@dataclass(frozen=True)
class Difference:
    """How much a picture differs from a reference, in linear radiance.

    Parameters
    ----------
    relative_rmse : float
        Root mean square difference over the root mean square of the reference.
    noise_rmse : float
        The part of it that the two pictures' standard errors explain, on the same scale; NaN if unknown.
    excess_rmse : float
        What is left: sqrt(relative_rmse^2 - noise_rmse^2), 0 where noise explains all; NaN if unknown.
    mean_relative : float
        Sum of absolute differences over the sum of the reference.
    bias : float
        Difference of the means over the mean of the reference, signed.
    bias_std_error : float
        Standard error of `bias` (the channels of a pixel err together, pixels apart); NaN if unknown. It
        knows the noise of rendering only: a measured material's own noise is part of `bias`.
    """

    relative_rmse: float
    noise_rmse: float
    excess_rmse: float
    mean_relative: float
    bias: float
    bias_std_error: float


def compare(image: Image, reference: Image) -> Difference:
    """Compare two pictures of one scene.

    Noise is taken as independent: give the two renders different seeds, or read `noise_rmse` as an
    upper bound (renders of one seed share most of their noise where the scene is the same).

    Raises
    ------
    InputError
        Different sizes, or a black reference.
    """
    if image.pixels.shape != reference.pixels.shape:
        raise InputError(f"pictures of {_size(image)} and {_size(reference)} pixels cannot be compared")
    difference = image.pixels - reference.pixels
    power, total = np.mean(reference.pixels**2), reference.pixels.sum()
    if not power > 0:
        raise InputError("the reference picture is black; nothing can be relative to it")
    variance = image.std_error**2 + reference.std_error**2
    known = bool(np.all(np.isfinite(variance)))
    squared = np.mean(difference**2) / power
    noise = float(np.mean(variance) / power) if known else np.nan
    return Difference(
        float(np.sqrt(squared)),
        float(np.sqrt(noise)),
        float(np.sqrt(max(0.0, squared - noise))) if known else np.nan,
        float(np.abs(difference).sum() / total),
        float(difference.sum() / total),
        float(np.sqrt(np.sum(np.sqrt(variance).sum(axis=-1) ** 2)) / total) if known else np.nan,
    )


def _size(image: Image) -> str:
    return f"{image.pixels.shape[1]} x {image.pixels.shape[0]}"


def side_by_side(
    images: Mapping[str, Image] | Sequence[tuple[str, Image]],
    path: str | os.PathLike[str],
    *,
    gain: float = 4.0,
    title: str = "",
) -> dict[str, Difference]:
    """Draw pictures beside the first of them, their differences below, with the error in numbers.

    Parameters
    ----------
    images : mapping of str to Image, or sequence of (str, Image)
        The first is the reference; all are shown at its exposure.
    path : path
        A .png or whatever matplotlib writes by suffix.
    gain : float
        Factor on the differences; red is brighter than the reference, blue darker.
    title : str

    Returns
    -------
    dict of str to Difference
        For each picture but the first.
    """
    named = list(images.items()) if isinstance(images, Mapping) else list(images)
    reference = named[0][1]
    exposure = exposure_of(reference.pixels)
    differences = {name: compare(image, reference) for name, image in named[1:]}
    height, width = reference.pixels.shape[:2]
    panel = 4.2
    figure = Figure(figsize=(panel * len(named), 2 * panel * height / width + 1.3), layout="constrained")
    axes = figure.subplots(2, len(named), squeeze=False)
    for ax in axes.flat:
        ax.axis("off")
    for column, (name, image) in enumerate(named):
        axes[0, column].imshow(tone_map(image.pixels, exposure), interpolation="nearest")
        axes[0, column].set_title(name, fontsize=11)
        if column == 0:
            continue
        signed = (image.pixels - reference.pixels).mean(axis=-1) * exposure * gain
        axes[1, column].imshow(signed, cmap="RdBu_r", vmin=-1, vmax=1, interpolation="nearest")
        d = differences[name]
        noise = "" if np.isnan(d.noise_rmse) else f" (noise explains {100 * d.noise_rmse:.2g} %)"
        axes[1, column].set_title(
            f"difference x {gain:g}: relative RMSE {100 * d.relative_rmse:.2g} %{noise}\n"
            f"mean {100 * d.mean_relative:.2g} %, bias {100 * d.bias:+.2g} ± {100 * d.bias_std_error:.1g} %",
            fontsize=9,
        )
    if title:
        figure.suptitle(title, fontsize=12)
    with atomic(path) as temporary:
        figure.savefig(temporary, dpi=120, format=Path(path).suffix.lstrip(".") or "png")
    return differences
