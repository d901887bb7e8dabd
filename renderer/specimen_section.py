"""The part of a report that shows the specimen: a picture of each surface and what it is made of."""

from __future__ import annotations

import html
import io
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from microgeometry.errors import InputError
from microgeometry.materials import (
    Black,
    Coated,
    Conductor,
    Dielectric,
    Film,
    Lambert,
    Material,
    Mirror,
    NoInterface,
    TableMaterial,
)
from microgeometry.media import HenyeyGreenstein, Medium, Rayleigh, TabulatedPhase
from microgeometry.specimen import Layer, parse_specimen
from microgeometry.surfaces.heightmap import HeightMap
from microgeometry.surfaces.mesh import Mesh
from microgeometry.tile import Tile
from renderer.image import tone_map
from renderer.page import image_html
from renderer.specimen_picture import Picture, surface_picture

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_DPI = 100
_LOW_SUN_DEG = 20.0  # below which the light needs a word


def specimen_html(text: str, folder: Path) -> str:
    """Pictures of a specimen's surfaces, top to bottom, with captions.

    Parameters
    ----------
    text : str
        The specimen's TOML, from a table's provenance.
    folder : Path
        What file names in it are relative to. If one is missing, the result is a line that says so.
    """
    try:
        layers = parse_specimen(tomllib.loads(text), folder).layers
        tiles = [layer.surface.realise(0) for layer in layers]
    except (InputError, tomllib.TOMLDecodeError) as error:
        return f"<p>No picture of the surface: {html.escape(' '.join(str(error).split()))}</p>"
    figures = [_figure_html(layers, number, tile) for number, tile in enumerate(tiles)]
    return f'<div class="pictures">{"".join(figures)}</div>'


def _figure_html(layers: Sequence[Layer], number: int, tile: Tile) -> str:
    layer = layers[number]
    title = f"Layer {number + 1} of {len(layers)}: " if len(layers) > 1 else ""
    title += f"{layer.surface.kind.replace('_', ' ')}, {describe_material(layer.material)}"
    picture = surface_picture(tile, _size(layer, tile), layer.plane is not None)
    sentences = [_extent(layer, tile, picture), _relief(layer, tile)]
    if picture.sun_deg < _LOW_SUN_DEG:
        sentences.append(f"The sun stands {picture.sun_deg:.2g}° high, for the relief to be seen.")
    if layer.plane is not None:
        sentences.append(f"Blue is the flat part: {describe_material(layer.plane)}.")
    below = describe_below(layer)
    heading = f"<b>{html.escape(title)}</b>" + (f"<br>below it {html.escape(below)}" if below else "")
    image = image_html(_annotated(picture), f"Picture of the surface: {title}")
    caption = html.escape(" ".join(filter(None, sentences)))
    return f"<figure>{heading}{image}<figcaption>{caption}</figcaption></figure>"


def _size(layer: Layer, tile: Tile) -> tuple[float, float] | None:
    """What was measured is shown as it was measured, without its mirror images."""
    surface = layer.surface
    if isinstance(surface, HeightMap | Mesh) and surface.tiling == "mirror":
        return 0.5 * tile.size[0], 0.5 * tile.size[1]
    return tile.size if isinstance(surface, HeightMap) else None


def _extent(layer: Layer, tile: Tile, picture: Picture) -> str:
    block = picture.block
    metres = [block.size[axis] * block.unit for axis in (0, 1)]
    periods = [size / period for size, period in zip(metres, tile.size, strict=True)]
    shown, period = _area(metres), _area(tile.size)
    if _size(layer, tile) is not None:
        mirrored = "" if periods[0] == 1 else f"; with its mirror images it makes a period of {period}"
        what = f"The whole file, {shown}{mirrored}"
    elif all(abs(n - round(n)) < 1e-9 for n in periods):
        count = " x ".join(f"{n:.0f}" for n in periods)
        what = f"{count} periods of {period}" if count != "1 x 1" else f"One period of {period}"
    else:
        what = f"{shown} of a period of {period}"
    return f"{what}, true vertical scale."


def _relief(layer: Layer, tile: Tile) -> str:
    facts = tile.statistics()
    if facts.peak_to_valley == 0:
        return ""
    which = "of this realisation" if layer.surface.is_random else "measured"
    return (
        f"Alpha {which} {facts.alpha:.4g}, rms height {length(facts.rms_height)}, "
        f"highest above lowest {length(facts.peak_to_valley)}."
    )


def _annotated(picture: Picture) -> bytes:
    """The picture as a PNG with the block's widths written along its lower edges."""
    pixels = tone_map(picture.image.pixels, 1.0)
    height, width = pixels.shape[:2]
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
    panel = figure.add_axes((0, 0, 1, 1))
    panel.imshow(pixels, interpolation="nearest", aspect="auto")
    panel.axis("off")
    for axis, (first, last) in enumerate(picture.edges):
        along = (last - first) / np.linalg.norm(last - first)
        outward = np.array([-along[1], along[0]])  # below the edge: y counts down
        a, b = first + 7 * outward, last + 7 * outward
        panel.annotate(
            "", a, b, arrowprops={"arrowstyle": "|-|", "mutation_scale": 2.5, "lw": 0.8, "color": "0.25"}
        )
        x, y = (0.5 * (a + b) + 9 * outward).tolist()
        panel.text(
            x, y, length(picture.block.size[axis] * picture.block.unit),
            rotation=math.degrees(math.atan2(-along[1], along[0])), ha="center", va="center", fontsize=9, color="0.15",
        )  # fmt: skip
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def length(metres: float) -> str:
    """A length in the unit that suits it: "2.46 µm"."""
    units = {"m": 1.0, "mm": 1e-3, "µm": 1e-6, "nm": 1e-9}
    unit = next((unit for unit, scale in units.items() if abs(metres) >= 0.9995 * scale), "nm")
    return f"{metres / units[unit]:.3g} {unit}" if metres else "0"


def _area(sizes: Sequence[float]) -> str:
    return " x ".join(map(length, sizes))


def describe_material(material: Material) -> str:
    """A material in a few words."""
    match material:
        case Mirror():
            return "mirror"
        case Black():
            return "black"
        case NoInterface():
            return "no interface"
        case Lambert():
            return f"Lambertian of albedo {_values(material.albedo)}"
        case Conductor():
            return f"conductor {material.name or _index(material.eta, material.k)}"
        case Dielectric():
            return f"dielectric {material.name or _index(material.eta, (0.0,))}"
        case Coated():
            return f"{', '.join(map(_film, material.films))} on {describe_material(material.over)}"
        case TableMaterial():
            return f"table {material.file.name}"
    return material.kind


def _film(film: Film) -> str:
    return f"{length(film.thickness)} of {film.name or _index(film.eta, film.k)}"


def _index(eta: Sequence[float], k: Sequence[float]) -> str:
    return f"n {_values(eta)}" + (f", k {_values(k)}" if max(k) > 0 else "")


def describe_below(layer: Layer) -> str:
    """What lies below a surface in a few words; nothing below an opaque one."""
    if layer.medium is None:
        return "a clear half-space" if layer.material.transmits else ""
    medium = layer.medium
    extent = "a half-space" if medium.thickness == math.inf else length(medium.thickness)
    parts = [
        f"{verb} {_per_length(sigma)}"
        for verb, sigma in (("absorbing", medium.sigma_a), ("scattering", medium.sigma_s))
        if max(sigma) > 0
    ]
    if not parts:
        return f"{extent} of a clear medium"
    return f"{extent} of a medium {' and '.join(parts)}{_phase(medium)}"


def _phase(medium: Medium) -> str:
    if max(medium.sigma_s) == 0:
        return ""
    match medium.phase:
        case HenyeyGreenstein():
            return f" by Henyey and Greenstein, g {medium.phase.g:g}"
        case Rayleigh():
            return " by Rayleigh"
        case TabulatedPhase():
            return " by a tabulated phase function"
    return " isotropically"


def _per_length(sigma: Sequence[float]) -> str:
    units = {"µm": 1e6, "mm": 1e3, "m": 1.0}
    unit = next((unit for unit, scale in units.items() if max(sigma) >= 0.0995 * scale), "m")
    return f"{_values([s / units[unit] for s in sigma])} per {unit}"


def _values(values: Sequence[float]) -> str:
    """One number, or the range of those that differ."""
    low, high = f"{min(values):.4g}", f"{max(values):.4g}"
    return low if low == high else f"{low} to {high}"
