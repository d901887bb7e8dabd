"""The specimen: its layers and the grid to measure it on, from TOML or a mapping."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

from microgeometry.errors import InputError
from microgeometry.grid import Grid
from microgeometry.keys import Keys
from microgeometry.materials import Material, read_material
from microgeometry.media import Medium
from microgeometry.surfaces import SURFACES, Surface

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["Grid", "Layer", "Specimen", "load_specimen", "parse_specimen"]


WITH_PLANE = ("pits", "bosses")
"""Surfaces with a flat part that may be of a material of its own."""


@dataclass(frozen=True)
class Layer:
    """A surface, what it is made of, and what fills the space below it.

    Attributes
    ----------
    surface : Surface
        Realised from a seed by ``surface.realise(seed)``.
    material : Material
    medium : Medium or None
        None below an opaque layer, or where the last layer bounds a clear half-space.
    plane : Material or None
        Material of the flat part of pits and bosses, if it is another.
    """

    surface: Surface
    material: Material
    medium: Medium | None = None
    plane: Material | None = None


@dataclass(frozen=True)
class Specimen:
    """Surfaces over one another, what they are made of, and what to measure.

    Attributes
    ----------
    layers : tuple of Layer
        Top to bottom, at least one.
    grid : Grid
        Channels, wavelengths and angles.
    text : str
        TOML text it was read from, or that says the same as the mapping it was built from.
    name : str
        Stem of the file, or the kind of the top surface.
    """

    layers: tuple[Layer, ...]
    grid: Grid
    text: str
    name: str

    @property
    def surface(self) -> Surface:
        """Surface of the top layer."""
        return self.layers[0].surface

    @property
    def material(self) -> Material:
        """Material of the top layer."""
        return self.layers[0].material

    @property
    def is_random(self) -> bool:
        """A new seed gives a new realisation of some layer."""
        return any(layer.surface.is_random for layer in self.layers)


def load_specimen(path: str | Path) -> Specimen:
    """Read a specimen from a TOML file.

    Parameters
    ----------
    path : str or Path
        The file; files it names are relative to its folder.

    Raises
    ------
    InputError
        The file is missing or not TOML, or anything in it is not allowed: one line that starts with the
        path.
    """
    path = Path(path)
    try:
        text = path.read_bytes().decode("utf-8")
        mapping = tomllib.loads(text)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file in UTF-8; a specimen is TOML") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {' '.join(str(error).split())}") from error
    try:
        return _build(mapping, path.parent, text, path.stem)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def parse_specimen(mapping: Mapping[str, Any], folder: str | Path = Path(".")) -> Specimen:
    """Build a specimen from a mapping with the tables of the TOML file.

    Parameters
    ----------
    mapping : Mapping
        For example ``{"surface": {"kind": "flat"}, "material": {"kind": "mirror"}}``.
    folder : str or Path
        What file names in it are relative to.

    Raises
    ------
    InputError
        Anything in it is not allowed.
    """
    return _build(mapping, Path(folder), None, None)


def _build(mapping: Mapping[str, Any], folder: Path, text: str | None, name: str | None) -> Specimen:
    top = Keys(mapping, "")
    top.allow("surface", "material", "medium", "layer", "grid")
    tables = _layer_tables(top)
    grid = Grid.from_keys(Keys(mapping.get("grid", {}), "grid"), _optics(tables))
    layers = tuple(_layer(keys, grid, folder) for keys in tables)
    _check_stack(tables, layers, grid)
    return Specimen(
        layers=layers,
        grid=grid,
        text=_as_toml(mapping) if text is None else text,
        name=layers[0].surface.kind if name is None else name,
    )


def _layer_tables(top: Keys) -> tuple[Keys, ...]:
    """One table a layer, with the keys surface, material and medium."""
    single = [key for key in ("surface", "material", "medium") if key in top]
    if "layer" not in top:
        for table in ("surface", "material"):
            if table not in top:
                raise InputError(
                    f"[{table}] is missing; a specimen has the tables [surface] and [material], or one [[layer]] "
                    "for each surface, and, if wanted, [grid]"
                )
        return (Keys({key: top.table[key] for key in single}, ""),)
    if single:
        raise InputError(
            f"[{single[0]}] and [[layer]]: give one or the other; a layer holds its own {single[0]}"
        )
    return top.subtables("layer")


def _layer(keys: Keys, grid: Grid, folder: Path) -> Layer:
    keys.allow("surface", "material", "medium")
    surface = keys.subtable("surface")
    surface_type = SURFACES[surface.choice("kind", None, SURFACES)]
    plane = None
    if "plane" in surface:
        if surface_type.kind not in WITH_PLANE:
            raise surface.error(
                "plane", f"only {' and '.join(WITH_PLANE)} have a flat part of its own material; leave it out"
            )
        plane = read_material(surface.subtable("plane"), grid, folder)
        surface = Keys({k: v for k, v in surface.table.items() if k != "plane"}, surface.where)
    return Layer(
        surface_type.from_keys(surface, folder),
        read_material(keys.subtable("material"), grid, folder),
        Medium.from_keys(keys.subtable("medium"), grid, folder) if "medium" in keys else None,
        plane,
    )


def _check_stack(tables: tuple[Keys, ...], layers: tuple[Layer, ...], grid: Grid) -> None:
    """Refuse a stack in which light has nowhere to go, or never gets to what lies below."""
    above = (1.0,) * grid.n_samples
    for number, (keys, layer) in enumerate(zip(tables, layers, strict=True), 1):
        material, medium, plane = layer.material, layer.medium, layer.plane
        last = number == len(layers)
        if plane is not None and (
            plane.transmits != material.transmits
            or (plane.transmits and plane.index_below(above) != material.index_below(above))
        ):
            raise keys.subtable("surface").error(
                "plane", "must be opaque if the material is, and else have the same index below it"
            )
        if material.transmits:
            above = material.index_below(above)
            if last:
                _check_last(keys, medium)
            else:
                _check_inner(keys, medium)
        elif medium is not None:
            raise keys.error("medium", f"{material.kind} is opaque and hides what is below it; leave it out")
        elif not last:
            raise keys.error(
                "material",
                "opaque, it hides the layers below; remove them, or take a dielectric, none, or coated over a "
                "dielectric",
            )


def _check_inner(keys: Keys, medium: Medium | None) -> None:
    if medium is None:
        raise keys.error(
            "medium", "missing; add medium = {thickness = ...}, the space down to the next layer"
        )
    if medium.thickness == inf:
        raise keys.error("medium", "thickness = inf leaves no room for the next layer; give a number")


def _check_last(keys: Keys, medium: Medium | None) -> None:
    if medium is None:
        return
    if medium.thickness < inf:
        raise keys.error(
            "medium",
            "of the last layer, so its thickness must be inf; or add what lies below it as a further [[layer]], for "
            'air with material = {kind = "dielectric", eta = 1}',
        )
    if min(a + s for a, s in zip(medium.sigma_a, medium.sigma_s, strict=True)) == 0:
        raise keys.error(
            "medium",
            "without end, and neither absorbs nor scatters (at some wavelength); give sigma_a or sigma_s, or leave "
            "the medium out: what lies below is then clear",
        )


def _optics(layers: Iterable[Keys]) -> Iterator[Mapping[str, Any]]:
    """Every table of a material, film or medium, whether valid or not."""
    for layer in layers:
        surface = layer.table.get("surface")
        plane = surface.get("plane") if isinstance(surface, Mapping) else None
        yield from _tables([layer.table.get("material"), layer.table.get("medium"), plane])


def _tables(values: Iterable[Any]) -> Iterator[Mapping[str, Any]]:
    for value in values:
        if isinstance(value, Mapping):
            yield value
            yield from _tables(value.values())
        elif isinstance(value, list | tuple):
            yield from _tables(value)


def _as_toml(mapping: Mapping[str, Any]) -> str:
    """Write the tables of a valid specimen as TOML."""
    lines = []
    for table, content in mapping.items():
        single = isinstance(content, Mapping)
        for keys in [content] if single else content:
            lines += [f"[{table}]" if single else f"[[{table}]]"]
            lines += [f"{key} = {_value(value)}" for key, value in keys.items()]
            lines += [""]
    return "\n".join(lines)


def _value(value: Any) -> str:
    """Write a number, a string, a list or an inline table."""
    if hasattr(value, "tolist"):  # numpy's numbers and arrays
        value = value.tolist()
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key} = {_value(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_value, value)) + "]"
    if isinstance(value, int | float):
        return repr(value)
    # JSON writes strings the way TOML reads them, if characters stand as they are.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
