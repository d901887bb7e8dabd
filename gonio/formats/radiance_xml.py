"""WINDOW and Radiance BSDF files `.xml`: Klems matrices and isotropic tensor trees.

Values are f in 1/sr without cosine; of a matrix rows are outgoing patches, columns incident ones. A file may
hold reflection and transmission of both sides; the front is read, or the back where there is no front.
Transmission is a part. Colour: besides ``Visible`` (Y) a matrix may have CIE-X and CIE-Z, a tree CIE-u and
CIE-v, the chromaticities u', v'. Red, green and blue are then Radiance's own, whose white is of equal energy:
grey stays grey.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml import DefusedXmlException
from defusedxml import ElementTree as safe_xml
from numpy.typing import NDArray

from gonio.files import atomic
from gonio.formats.cells import average_cells, row_centres, table_of, uniform_grid
from gonio.formats.colour import as_colour
from gonio.formats.klems import BASES, Klems
from gonio.formats.losses import common_losses
from gonio.formats.radiance_document import document
from gonio.formats.radiance_values import LEVELS, XYZ, matrix_texts, tree_texts
from gonio.formats.samples import Samples
from gonio.formats.tensor_tree import TensorTree, coordinates, directions
from gonio.formats.text import to_numbers
from gonio.table.parts import TRANSMISSION, is_transmission
from gonio.table.table import Table
from microgeometry.errors import InputError

Array = NDArray[np.float64]

_SECTORS = 36  # of delta phi, in reading a matrix
_TREE = "TensorTree3"
_COLOURS = ("cie-x", "visible", "cie-z"), ("visible", "cie-u", "cie-v")  # of matrices, of trees

_RGB = np.linalg.inv(XYZ)
_BASES_DIFFER = "{}: matrices of different bases; one basis for all is read"


def read(path: Path) -> Table:
    """Read a file of Klems matrices (full, half or quarter) or isotropic tensor trees.

    A matrix gives rows and rings that are the basis's own, averaged over the incident patches of a ring.

    Returns
    -------
    Table
        Channel Y, or R, G, B. A file of transmission alone is a table of gaps with that part.

    Raises
    ------
    InputError
        No XML, entities or a document type, no BSDF, an unknown basis, or numbers that are missing.
    """
    known, structure, lost = _read(path)
    tabulate = _tabulate_tree if structure == _TREE else _tabulate_matrix
    tables = tabulate(path, known, structure)
    main = tables.get("reflection")
    if main is None:
        part = tables[TRANSMISSION]
        gaps = np.ones(part.values.shape[:3], bool)
        main = part.replace(values=0 * part.values, row_albedo=0 * part.row_albedo, gaps=gaps)
    parts = {TRANSMISSION: tables[TRANSMISSION]} if TRANSMISSION in tables else {}
    provenance = {"source": path.name, "format": f"WINDOW/Radiance XML, {structure}", "lost": lost}
    return main.replace(parts=parts, provenance=provenance)


def samples_of(path: Path) -> dict[str, Samples]:
    """The middles of patches or cells, of the side that is read, as `gonio.formats` has them; errors as `read`."""
    known, structure, _ = _read(path)
    middles = _cells_of_tree if structure == _TREE else _patches
    return {
        "" if name == "reflection" else name: middles(path, kinds, _coloured(known, structure), structure)
        for name, kinds in known.items()
    }


def _read(path: Path) -> tuple[dict[str, dict[str, Element]], str, list[str]]:
    """WavelengthDataBlocks by "reflection" or "transmission" and wavelengths, the structure, and what was lost."""
    try:
        root = safe_xml.fromstring(path.read_bytes(), forbid_dtd=True)
    except (ParseError, DefusedXmlException, ValueError, LookupError) as error:
        reason = " ".join(str(error).split())[:100] or type(error).__name__
        raise InputError(f"{path}: no XML that can be read safely ({reason}); copy it again") from error
    structure = next((_text(e) for e in _all(root, "IncidentDataStructure")), "")
    if structure not in ("Columns", "Rows", _TREE):
        raise InputError(
            f"{path}: IncidentDataStructure {structure[:40]!r}; Columns, Rows and TensorTree3 (isotropic) are read"
        )
    blocks: dict[str, dict[str, Element]] = {}
    for data in _all(root, "WavelengthData"):
        kind = next((_text(e) for e in _all(data, "Wavelength")), "")
        for block in _all(data, "WavelengthDataBlock"):
            where = next((_text(e) for e in _all(block, "WavelengthDataDirection")), "").lower()
            blocks.setdefault(where, {})[kind.lower()] = block
    found = {
        name: next(
            (blocks[f"{name} {side}"] for side in ("front", "back") if f"{name} {side}" in blocks), None
        )
        for name in ("reflection", TRANSMISSION)
    }
    lost = [
        f"{where}: one side is read"
        for where in blocks
        if where.endswith("back") and where[:-4] + "front" in blocks
    ]
    known = {name: kinds for name, kinds in found.items() if kinds is not None and "visible" in kinds}
    if not known:
        raise InputError(
            f"{path}: no reflection or transmission in the wavelengths Visible; is it a BSDF file?"
        )
    return known, structure, lost


def _coloured(known: dict[str, dict[str, Element]], structure: str) -> bool:
    return all(c in kinds for kinds in known.values() for c in _COLOURS[structure == _TREE])


def write(table: Table, path: Path) -> list[str]:
    """Write a full Klems matrix, or, where the name ends in ``.tree.xml``, an isotropic tensor tree.

    Parameters
    ----------
    table : Table
        Of one channel, or three, taken as R, G, B. Its part "transmission" is written as well; a table of
        transmission (``--part transmission`` or a part of it) is written as that.
    path : Path

    Returns
    -------
    list of str
        What was lost.

    Raises
    ------
    InputError
        Another number of channels.
    OSError
        The file cannot be written.
    """
    table = as_colour(table, path, "a WINDOW file")
    tree = path.name.lower().endswith(".tree.xml")
    sides = {"Transmission Front" if is_transmission(table) else "Reflection Front": table}
    if TRANSMISSION in table.parts:
        sides["Transmission Front"] = table.parts[TRANSMISSION]
    data: dict[str, list[tuple[str, str]]] = {}
    for where, side in sides.items():
        for kind, text in (tree_texts(side) if tree else matrix_texts(side)).items():
            data.setdefault(kind, []).append((where, text))
    with atomic(path) as temporary:
        temporary.write_text(document(path.name, tree, data), encoding="utf-8")
    losses = common_losses(table, "this format", keeps=("transmission", "side"))
    grid = f"1/{2**LEVELS} of the square" if tree else "the 145 patches of Klems, 10 degrees and more"
    return [*losses, f"what is finer than {grid}", "provenance, ledger and the grid of the rows"]


def _all(element: Element, name: str) -> Iterator[Element]:
    """Descendants of a name, whatever their namespace."""
    return (e for e in element.iter() if isinstance(e.tag, str) and e.tag.rpartition("}")[2] == name)


def _text(element: Element) -> str:
    return (element.text or "").strip()


def _data(block: Element, path: Path) -> str:
    for element in _all(block, "ScatteringData"):
        return element.text or ""
    raise InputError(f"{path}: a WavelengthDataBlock without ScatteringData; copy it again")


# --- matrices ------------------------------------------------------------------------------------------


def _tabulate_matrix(path: Path, known: dict[str, dict[str, Element]], structure: str) -> dict[str, Table]:
    coloured = _coloured(known, structure)
    first: Klems | None = None
    tables = {}
    for name, kinds in known.items():
        basis, data = _matrices(path, kinds, coloured, structure)
        if first is not None and basis.name != first.name:
            raise InputError(_BASES_DIFFER.format(path))
        first = basis
        phi_edges = np.linspace(0, np.pi, _SECTORS + 1)

        def look(
            row: int, theta: Array, phi: Array, basis: Klems = basis, data: Array = data
        ) -> tuple[Array, NDArray[np.bool_]]:
            incident = range(basis.first[row], basis.first[row + 1])
            total = np.zeros((len(theta), data.shape[2]))
            for patch in incident:
                for azimuth in basis.points(patch, 1, 4)[1]:
                    # the patch is that of the direction of travel, opposite to the light's
                    total += data[basis.index(theta, azimuth + np.pi + phi), patch]
            return total / (4 * len(incident)), np.ones(len(theta), bool)

        n_rows = len(basis.counts)
        values, gaps = average_cells(look, n_rows, basis.edges, phi_edges, data.shape[2], points=(1, 2))
        tables[name] = table_of(
            values,
            gaps,
            0.5 * (basis.edges[1:] + basis.edges[:-1]),
            basis.edges,
            phi_edges,
            ("R", "G", "B") if coloured else ("Y",),
            theta_i_edges=basis.edges,
        )
    return tables


def _patches(path: Path, kinds: dict[str, Element], coloured: bool, structure: str) -> Samples:
    basis, data = _matrices(path, kinds, coloured, structure)
    theta, phi = (
        np.concatenate(a) for a in zip(*(basis.points(n, 1, 1) for n in range(basis.size)), strict=True)
    )
    # light comes from opposite to where the incident patch is
    return Samples.on_grid(theta, theta[:, None], phi[:, None] - phi - np.pi, data)


def _matrices(path: Path, kinds: dict[str, Element], coloured: bool, structure: str) -> tuple[Klems, Array]:
    """Basis, and values by outgoing patch, incident patch and channel."""
    wanted = _COLOURS[0] if coloured else ("visible",)
    bases, matrices = zip(*(_matrix(kinds[kind], path, structure) for kind in wanted), strict=True)
    if any(basis.name != bases[0].name for basis in bases):
        raise InputError(_BASES_DIFFER.format(path))
    data = np.stack(matrices, axis=-1)
    return bases[0], data @ _RGB.T if coloured else data


def _matrix(block: Element, path: Path, structure: str) -> tuple[Klems, Array]:
    """Basis, and values by outgoing and incident patch."""
    names = {
        _text(e)
        for tag in ("ColumnAngleBasis", "RowAngleBasis", "AngleBasis")
        for e in _all(block, tag)
        if _text(e)
    }
    if len(names) != 1 or not names <= set(BASES):
        found = ", ".join(sorted(names))[:100] or "none"
        raise InputError(
            f"{path}: angle basis {found}; one of {', '.join(BASES)} for rows and columns is read"
        )
    basis = Klems(names.pop())
    words = _data(block, path).replace(",", " ").split()
    if len(words) != basis.size**2:
        raise InputError(f"{path}: {len(words)} numbers of ScatteringData; {basis.size**2} are expected")
    matrix = to_numbers(words, "ScatteringData", path).reshape(basis.size, basis.size)
    return basis, matrix if structure == "Columns" else matrix.T


# --- tensor trees --------------------------------------------------------------------------------------


def _tabulate_tree(path: Path, known: dict[str, dict[str, Element]], structure: str) -> dict[str, Table]:
    coloured = _coloured(known, structure)
    trees = {name: _trees(path, kinds, coloured) for name, kinds in known.items()}
    finest = max(tree.resolution for group in trees.values() for tree in group)
    n_channels = 3 if coloured else 1
    n = uniform_grid(path, n_channels * len(trees), min(90, finest))
    edges, phi_edges = np.linspace(0, np.pi / 2, n + 1), np.linspace(0, np.pi, 2 * n + 1)
    rows = row_centres(edges)
    tables = {}
    for name, group in trees.items():

        def look(
            row: int, theta: Array, phi: Array, group: list[TensorTree] = group
        ) -> tuple[Array, NDArray[np.bool_]]:
            return _look_up(group, coordinates(rows[row], theta, phi)), np.ones(len(theta), bool)

        values, gaps = average_cells(look, n, edges, phi_edges, n_channels)
        tables[name] = table_of(
            values,
            gaps,
            0.5 * (edges[1:] + edges[:-1]),
            edges,
            phi_edges,
            ("R", "G", "B") if coloured else ("Y",),
            theta_i_edges=edges,
        )
    return tables


def _trees(path: Path, kinds: dict[str, Element], coloured: bool) -> list[TensorTree]:
    return [TensorTree(_data(kinds[kind], path), path) for kind in _COLOURS[1][: 3 if coloured else 1]]


def _look_up(trees: list[TensorTree], points: Array) -> Array:
    """Values at points of the unit cube, shape (N, C)."""
    luminance, *chroma = (tree.look_up(points) for tree in trees)
    values = luminance[:, None]
    if chroma:
        u, v = chroma[0], np.maximum(chroma[1], 1e-6)
        xyz = np.stack([2.25 * u / v, np.ones_like(u), (3 - 0.75 * u - 5 * v) / v], axis=-1)
        values = values * (xyz @ _RGB.T)
    return values


def _cells_of_tree(path: Path, kinds: dict[str, Element], coloured: bool, structure: str) -> Samples:
    trees = _trees(path, kinds, coloured)
    points = trees[0].middles()
    points = points[points[:, 0] <= 0.5]  # beyond there is no incidence
    return Samples(*directions(points), _look_up(trees, points))
