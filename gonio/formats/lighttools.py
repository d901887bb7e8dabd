"""LightTools BSDF files `.bsdf` (text).

Keywords Symmetry, SpectralContent (Monochrome or XYZ), ScatterAzimuth and ScatterRadial with their lists, then
between DataBegin and DataEnd blocks ``AOI a POI p Side Front|Back Wavelength w ScatterType BRDF|BTDF
[TristimulusValue X|Y|Z] TIS t`` and values of f, rows of azimuth, columns of the radial angle. Angles are
from the normal, of the side that the light leaves; the light of POI 0 stands at azimuth 90 degrees (as in
libbsdf's reader), so delta phi = azimuth - 90 - POI.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.formats.cells import cells_around, check_size, table_of
from gonio.formats.colour import XYZ_TO_RGB
from gonio.formats.grid import close_circle, interpolate
from gonio.formats.samples import Samples
from gonio.formats.text import Words, angles
from gonio.table.parts import TRANSMISSION
from gonio.table.table import Table
from microgeometry.errors import InputError

Array = NDArray[np.float64]

_BLOCK = ("AOI", "POI", "Side", "Wavelength", "ScatterType", "TristimulusValue", "TIS")
_TRISTIMULUS = ("x", "y", "z")

Key = tuple[str, str, float, float, float, str]  # side, type, AOI, POI, wavelength, tristimulus


def read(path: Path) -> Table:
    """Read a LightTools file; the front side, or the back where there is no front.

    Cells are those around the file's own radial angles; azimuths of the light (POI) are averaged, as are both
    signs of delta phi. Tristimulus values become linear sRGB.

    Returns
    -------
    Table
        Channel Y, R, G, B, or one a wavelength; transmission is a part.

    Raises
    ------
    InputError
        A keyword that is missing or unknown, or numbers that are missing.
    """
    header, azimuths, radials, blocks = _read(path)
    side, chosen = _one_side(blocks)
    lost = [] if len(chosen) == len(blocks) else [f"the back side: the {side} is read"]
    return _tabulate(path, header["colour"], azimuths, radials, chosen, lost)


def samples_of(path: Path) -> dict[str, Samples]:
    """The samples of the side that is read, as `gonio.formats` has them; errors as `read`."""
    header, azimuths, radials, blocks = _read(path)
    _, chosen = _one_side(blocks)
    stimuli, wavelengths = _channels(path, header["colour"], chosen)
    shape = (len(azimuths), len(radials), len(stimuli) * len(wavelengths))
    grids: dict[str, dict[tuple[float, float], Array]] = {}
    for (kind, aoi, turn, wavelength, stimulus), block in chosen.items():
        if stimulus in stimuli:
            values = grids.setdefault(kind, {}).setdefault((aoi, turn), np.full(shape, np.nan))
            channel = int(np.searchsorted(wavelengths, wavelength)) + stimuli.index(stimulus)
            values[..., channel] = block[:, : len(radials)]
    to_rgb = XYZ_TO_RGB.T if header["colour"] == "xyz" else np.eye(shape[2])
    return {
        "" if kind == "brdf" else TRANSMISSION: Samples.joined(
            Samples.on_grid(
                np.radians(aoi), radials, azimuths[:, None] - np.radians(turn + 90), values @ to_rgb
            )
            for (aoi, turn), values in found.items()
        )
        for kind, found in grids.items()
    }


def _read(path: Path) -> tuple[dict[str, str], Array, Array, dict[Key, Array]]:
    """Header, azimuths and radial angles up to 90 degrees in radians, and the blocks."""
    words = Words(path)
    header = _read_header(words)
    azimuths = np.radians(words_list(words, header, "ScatterAzimuth"))
    radials = angles(words_list(words, header, "ScatterRadial"), "ScatterRadial", path, 180)
    radials = radials[radials <= np.pi / 2 + 1e-9]
    if not np.all(np.diff(azimuths) > 0) or len(radials) == 0:
        raise InputError(f"{path}: azimuths that increase and radial angles up to 90 degrees are expected")
    return header, azimuths, radials, _read_blocks(words, header, len(azimuths))


def _one_side(blocks: dict[Key, Array]) -> tuple[str, dict]:
    """The front, or the back where there is no front, and its blocks by the rest of their keys."""
    side = "front" if any(key[0] == "front" for key in blocks) else "back"
    return side, {key[1:]: block for key, block in blocks.items() if key[0] == side}


def _channels(path: Path, colour: str, blocks: dict) -> tuple[tuple[str, ...], Array]:
    """Tristimulus values and wavelengths, whose product the channels are."""
    wavelengths = np.unique([key[3] for key in blocks])
    stimuli = _TRISTIMULUS if colour == "xyz" else ("",)
    if colour == "xyz" and len(wavelengths) > 1:
        raise InputError(f"{path}: tristimulus values at {len(wavelengths)} wavelengths; one is expected")
    return stimuli, wavelengths


def words_list(words: Words, header: dict[str, str], name: str) -> Array:
    """A list of the header, degrees."""
    if name not in header:
        raise InputError(f"{words.path}: keyword {name} is missing; is it a LightTools BSDF file?")
    return np.array(header[name].split(), dtype=float)


def _read_header(words: Words) -> dict[str, str]:
    header: dict[str, str] = {"colour": "monochrome"}
    while (keyword := words.word("DataBegin")) != "DataBegin":
        if keyword in ("ScatterAzimuth", "ScatterRadial"):
            n = words.count(f"angles of {keyword}")
            header[keyword] = " ".join(map(repr, words.numbers(n, keyword).tolist()))
        elif keyword == "SpectralContent":
            header["colour"] = words.word(keyword).lower()
        elif keyword in ("Symmetry", "Source"):
            header[keyword] = words.word(keyword)
        # other words are labels of the data, as in Zemax's format
    if header["colour"] not in ("monochrome", "xyz"):
        raise InputError(
            f"{words.path}: SpectralContent {header['colour'][:20]!r}; Monochrome or XYZ is expected"
        )
    return header


def _read_blocks(words: Words, header: dict[str, str], n_azimuths: int) -> dict[Key, Array]:
    n_radials = len(header["ScatterRadial"].split())
    blocks: dict[Key, Array] = {}
    said: dict[str, str] = {}
    while (keyword := words.word("DataEnd")) != "DataEnd":
        if keyword not in _BLOCK:
            raise InputError(f"{words.path}: {keyword[:40]!r} where one of {', '.join(_BLOCK)} is expected")
        if keyword != "TIS":
            said[keyword] = words.word(keyword).lower()
            continue
        words.number("TIS")
        values = words.numbers(n_azimuths * n_radials, f"block {len(blocks) + 1}").reshape(
            n_azimuths, n_radials
        )
        blocks[_key(words, said)] = values
        said = {}
    if not blocks:
        raise InputError(f"{words.path}: no data between DataBegin and DataEnd")
    return blocks


def _key(words: Words, said: dict[str, str]) -> Key:
    def number(name: str) -> float:
        try:
            found = float(said.get(name, "0"))
        except ValueError:
            found = np.nan
        if not np.isfinite(found):
            raise InputError(f"{words.path}: {name} {said[name][:40]!r}; a number is expected")
        return found

    side, kind = said.get("Side", "front"), said.get("ScatterType", "brdf")
    tristimulus = said.get("TristimulusValue", "")
    if (
        side not in ("front", "back")
        or kind not in ("brdf", "btdf")
        or tristimulus not in ("", *_TRISTIMULUS)
    ):
        raise InputError(
            f"{words.path}: Side {side[:20]}, ScatterType {kind[:20]}, TristimulusValue {tristimulus[:20]}; allowed "
            "are Front or Back, BRDF or BTDF, X, Y or Z"
        )
    aoi = number("AOI")
    if not 0 <= aoi <= 90:
        raise InputError(f"{words.path}: AOI {aoi:g}; 0 to 90 degrees is allowed")
    return side, kind, aoi, number("POI"), number("Wavelength"), tristimulus


def _tabulate(
    path: Path, colour: str, azimuths: Array, radials: Array, blocks: dict, lost: list[str]
) -> Table:
    """The table of the blocks of one side."""
    aois = np.unique([key[1] for key in blocks])
    turns = np.unique([key[2] for key in blocks])
    if len(turns) > 1:
        lost.append(f"{len(turns)} azimuths of the light: they are averaged")
    stimuli, wavelengths = _channels(path, colour, blocks)
    n_channels = len(stimuli) * len(wavelengths)
    edges, source = cells_around(radials, np.pi / 2)
    n_sectors = int(np.clip(len(azimuths), 18, 180))
    phi_edges = np.linspace(0, np.pi, n_sectors + 1)
    phi = 0.5 * (phi_edges[1:] + phi_edges[:-1])
    kinds = {key[0] for key in blocks}
    check_size(path, len(aois) * len(source) * n_sectors * n_channels * len(kinds), "blocks")
    tables = {}
    for kind in kinds:
        values = np.zeros((len(aois), len(source), n_sectors, n_channels))
        count = np.zeros_like(values)
        for (which, aoi, turn, wavelength, stimulus), block in blocks.items():
            if which != kind or stimulus not in stimuli:
                continue
            row = int(np.searchsorted(aois, aoi))
            channel = int(np.searchsorted(wavelengths, wavelength)) + stimuli.index(stimulus)
            found, known = _at(azimuths, block[:, : len(radials)], phi, np.radians(turn + 90.0))
            values[row, source >= 0, :, channel] += found[source[source >= 0]]
            count[row, source >= 0, :, channel] += known[None]
        values = np.divide(values, count, out=np.zeros_like(values), where=count > 0)
        gaps = np.any(count == 0, axis=-1)
        values[gaps] = 0.0
        if colour == "xyz":
            values = values @ XYZ_TO_RGB.T
        named = len(wavelengths) > 1 or (colour != "xyz" and wavelengths[0] > 0)
        named = named and wavelengths[0] > 0
        tables[kind] = table_of(
            values,
            gaps,
            np.radians(aois),
            edges,
            phi_edges,
            ("R", "G", "B")
            if colour == "xyz"
            else tuple(f"{w:g} nm" for w in wavelengths)
            if named
            else ("Y",) * n_channels,
            wavelengths_nm=tuple(wavelengths.tolist()) if named else None,
            provenance={"source": path.name, "format": "LightTools", "lost": lost},
        )
    main = tables.get("brdf")
    if main is None:
        part = tables["btdf"]
        main = part.replace(
            values=0 * part.values, row_albedo=0 * part.row_albedo, gaps=np.ones(part.values.shape[:3], bool)
        )
    parts = {TRANSMISSION: tables["btdf"].replace(provenance={})} if "btdf" in tables else {}
    return main.replace(parts=parts)


def _at(azimuths: Array, block: Array, phi: Array, light: float) -> tuple[Array, Array]:
    """Sums over both signs of delta phi of what is known, shape (radials, P), and how many, shape (P,)."""
    nodes, values = close_circle(azimuths, block)
    radials = np.arange(block.shape[1], dtype=float)
    total, count = np.zeros((block.shape[1], len(phi))), np.zeros(len(phi))
    for sign in (1, -1):
        azimuth = (light + sign * phi - nodes[0]) % (2 * np.pi) + nodes[0]
        a, r = (x.ravel() for x in np.meshgrid(azimuth, radials, indexing="ij"))
        found, inside = interpolate(values, nodes, radials, a, r)
        known = inside.reshape(len(phi), -1)[:, 0]
        total += np.where(known, found.reshape(len(phi), -1).T, 0.0)
        count += known
    return total, count
