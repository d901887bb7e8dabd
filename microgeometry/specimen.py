"""The specimen: a surface, its material and the grid to measure it on, from TOML or a mapping."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from microgeometry.errors import InputError
from microgeometry.grid import Grid
from microgeometry.keys import Keys
from microgeometry.materials import MATERIALS, Material
from microgeometry.surfaces import SURFACES, Surface

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["Grid", "Specimen", "load_specimen", "parse_specimen"]


@dataclass(frozen=True)
class Specimen:
    """A surface, what it is made of, and what to measure.

    Attributes
    ----------
    surface : Surface
        Realised from a seed by ``surface.realise(seed)``.
    material : Mirror, Conductor or Lambert
        With one value per channel of the grid.
    grid : Grid
        Channels and angles.
    text : str
        TOML text it was read from, or that says the same as the mapping it was built from.
    name : str
        Stem of the file, or the surface's kind.
    """

    surface: Surface
    material: Material
    grid: Grid
    text: str
    name: str


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
    top.allow("surface", "material", "grid")
    for table in ("surface", "material"):
        if table not in top:
            raise InputError(
                f"[{table}] is missing; a specimen has the tables [surface], [material] and, "
                "if wanted, [grid]"
            )
    surface_keys, material_keys = Keys(mapping["surface"], "surface"), Keys(mapping["material"], "material")
    surface_type = SURFACES[surface_keys.choice("kind", None, SURFACES)]
    material_type = MATERIALS[material_keys.choice("kind", None, MATERIALS)]
    grid = Grid.from_keys(Keys(mapping.get("grid", {}), "grid"), material_keys.table)
    return Specimen(
        surface=surface_type.from_keys(surface_keys, folder),
        material=material_type.from_keys(material_keys, grid),
        grid=grid,
        text=_as_toml(mapping) if text is None else text,
        name=surface_type.kind if name is None else name,
    )


def _as_toml(mapping: Mapping[str, Any]) -> str:
    """Write the tables of a valid specimen as TOML: keys with numbers, strings and lists of them."""
    lines = []
    for table, keys in mapping.items():
        # JSON writes strings, numbers and lists the way TOML reads them.
        lines += [f"[{table}]"]
        lines += [f"{key} = {json.dumps(value, default=_plain)}" for key, value in keys.items()]
        lines += [""]
    return "\n".join(lines)


def _plain(value: Any) -> Any:
    """Turn numpy's numbers and arrays, and paths, into what JSON knows."""
    return value.tolist() if hasattr(value, "tolist") else str(value)
