"""BRDF files, one module a format, chosen by the file's suffix, and by its content where suffixes are shared.

A format is a module with ``read(path) -> Table`` and, where it can be written, ``write(table, path) ->
list[str]``, which returns what the format could not keep, and one line in `FORMATS`. What reading loses
(rotations of the sample averaged, say) stands in the table's provenance under ``lost``. So that `convert` can measure
what became of the values, a module that resamples has one function more: ``brdf_of(path)``, f at any angles,
where the format gives that, else ``samples_of(path) -> dict[str, Samples]``, the file's own samples by the part that
they became: "" for the table, "transmission".
"""

from __future__ import annotations

import codecs
import os
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio.files import check_writable
from gonio.table.parts import TRANSMISSION, extract, is_transmission
from microgeometry.errors import InputError

if TYPE_CHECKING:
    from gonio.table.anisotropic import AnisotropicTable
    from gonio.table.table import Table

FORMATS: dict[str, tuple[str, ...]] = {
    ".h5": ("hdf5",),
    ".binary": ("merl",),
    ".bsdf": ("rgl", "zemax", "lighttools"),
    ".txt": ("lighttools", "zemax"),
    ".xml": ("radiance_xml",),
    ".csv": ("csv", "plane_csv"),
    ".npz": ("npz",),
    ".brdf": ("speos",),
    ".anisotropicbsdf": ("speos",),
    ".astm": ("astm",),
    ".xompt": ("openmaterial",),
}
"""Suffix to modules; the first is written, and read unless the content says otherwise (`_by_content`)."""

_NO_CHANGE = 1e-3  # relative

_DIRECTIONS = 5000

_READINGS = b"Data file type :"
"""Of the log that a Reflet goniometer keeps in a text file."""


@dataclass(frozen=True)
class Conversion:
    """What a conversion cost.

    Parameters
    ----------
    lost : tuple of str
        What the target could not keep, and what reading the source lost, one sentence each.
    error : float
        Relative, cosine-weighted RMS difference between the file written, read again, and the table it was
        written from: median over rows and channels. 0 for a format that keeps everything.
    worst : float
        The largest of any row and channel.
    albedo_error : float
        Mean relative difference of the directional albedo without delta term.
    """

    lost: tuple[str, ...]
    error: float = 0.0
    worst: float = 0.0
    albedo_error: float = 0.0


def read(path: str | os.PathLike[str]) -> Table:
    """Read an isotropic table from a file of any known format.

    Raises
    ------
    InputError
        The file is missing, of an unknown suffix, damaged or not a table, or the table is anisotropic.
    """
    from gonio.table.table import Table

    table = read_any(path)
    if not isinstance(table, Table):
        raise InputError(
            f"{path}: an anisotropic table, and this takes isotropic ones; `gonio info`, `check`, `report`, "
            "`render` and `convert` to .h5 take it as it is; for all else "
            "trace the specimen without anisotropic = true in [grid]"
        )
    return table


def read_any(path: str | os.PathLike[str]) -> Table | AnisotropicTable:
    """Read a table, isotropic or not, from a file of any known format; errors as `read`, but the last."""
    path = Path(path)
    names = _names(path)
    if not path.is_file():
        raise InputError(f"{path}: {'is not a file' if path.exists() else 'no such file'}")
    module = _module(_by_content(path, names))
    try:
        # numbers beyond floating point become infinite, which a table refuses
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            return module.read(path)
    except InputError as error:
        text = str(error) if str(path) in str(error) else f"{path}: {error}"
        # what is quoted from a damaged file may hold anything
        raise InputError("".join(c if c.isprintable() else " " for c in text)) from error


def write(table: Table | AnisotropicTable, path: str | os.PathLike[str]) -> list[str]:
    """Write a table in the format of the suffix of `path`; nothing half-written stays on failure.

    Returns
    -------
    list of str
        What was lost, one sentence each; empty for .h5.

    Raises
    ------
    InputError
        The suffix is unknown or of a format that is only read, or the format cannot hold such a table.
    OSError
        The file cannot be written.
    """
    from gonio.table.table import Table

    if not isinstance(table, Table):
        check_anisotropic_target(path)
    return _writer(Path(path)).write(table, Path(path))


def convert(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    part: str | None = None,
) -> Conversion:
    """Read one format and write another, both chosen by suffix, and measure what that changed.

    Parameters
    ----------
    source, target : path
        A target `.bsdf` is an RGL tensor file, or `.zemax.bsdf` for Zemax text.
    part : str, optional
        Write only this part, as a table of its own: "transmission", "L1", "transmission/L1".

    Returns
    -------
    Conversion

    Raises
    ------
    InputError
        As `read` and `write`; a missing folder, no such part, or a target that is the source.
    """
    from gonio.table.table import Table

    check_target(target)
    if os.path.exists(source) and os.path.exists(target) and os.path.samefile(source, target):
        raise InputError(f"{target}: is the file to be converted; choose another name")
    table = read_any(source) if Path(target).suffix.lower() == ".h5" else read(source)
    resampled = _resampling(Path(source), table, part)
    if part is not None:
        try:
            table = extract(table, part)  # type: ignore[type-var]
        except InputError as error:
            raise InputError(f"{source}: {error}") from error
    before = (*table.provenance.get("lost", ()), *resampled)
    lost = (*before, *write(table, target))
    if not isinstance(table, Table) or Path(target).suffix.lower() == ".h5":
        return Conversion(lost)
    again = read(target)
    if is_transmission(table) and TRANSMISSION in again.parts:  # where files know it from reflection
        again = again.parts[TRANSMISSION]
    return Conversion(lost, *_compare(table, again))


def _resampling(path: Path, table: Any, part: str | None) -> list[str]:
    """What the cells of a table, and of its parts or the one asked for, changed of the file's values."""
    module = _module(_by_content(path, _names(path)))
    if hasattr(module, "brdf_of"):
        from gonio.formats.highlights import resampling_error

        median, worst, at_deg = resampling_error(table, module.brdf_of(path))
        return [
            f"what lies between the table's cells: f cos differs from the file's by {100 * median:.2g} % "
            f"(median of theta_i from 10 to 80 degrees; at most {100 * worst:.2g} %, at {at_deg:g})"
        ]
    from gonio.formats.samples import sample_error

    sentences = []
    for name, samples in module.samples_of(path).items() if hasattr(module, "samples_of") else ():
        if part not in (None, name):
            continue
        median, worst, at_deg = sample_error(table.parts[name] if name else table, samples)
        if worst > _NO_CHANGE:
            of = f" of {name}" if name else ""
            sentences.append(
                f"the file's own samples{of}: where they stand f differs by {100 * median:.2g} % (RMS weighted with "
                f"the cosine; median of angles of incidence, at most {100 * worst:.2g} %, at {at_deg:.4g} degrees)"
            )
    return sentences


def check_target(path: str | os.PathLike[str]) -> None:
    """Fail now rather than after a long run: can `path` be written?

    Raises
    ------
    InputError
        The suffix is unknown or of a format that is only read; or as `gonio.files.check_writable`.
    """
    _writer(Path(path))
    check_writable(path)


def check_anisotropic_target(path: str | os.PathLike[str]) -> None:
    """Fail where an anisotropic table cannot be written to `path`.

    Raises
    ------
    InputError
        The suffix is not .h5.
    """
    if Path(path).suffix.lower() != ".h5":
        raise InputError(
            f"{path}: an anisotropic table can only be written as .h5; choose a name that ends so"
        )


def _names(path: Path) -> tuple[str, ...]:
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise InputError(f"{path}: unknown suffix {suffix!r}; allowed are {', '.join(FORMATS)}")
    return FORMATS[suffix]


def _module(name: str) -> ModuleType:
    return import_module(f"gonio.formats.{name}")


def _writer(path: Path) -> ModuleType:
    """The module that writes such a file."""
    names = _names(path)
    asked = path.with_suffix("").suffix[1:].lower()  # table.zemax.bsdf
    module = _module(asked if asked in names else names[0])
    if not hasattr(module, "write"):
        writable = [s for s, (first, *_) in FORMATS.items() if hasattr(_module(first), "write")]
        raise InputError(f"{path}: this format is only read; written are {', '.join(writable)}")
    return module


def _by_content(path: Path, names: tuple[str, ...]) -> str:
    """Which of the formats that share a suffix a file is of."""
    if len(names) == 1:
        return names[0]
    with open(path, "rb") as file:
        start = file.read(1 << 16).removeprefix(codecs.BOM_UTF8)
    if "csv" in names:
        return "plane_csv" if start.lstrip().lower().startswith(b"incident_angle") else "csv"
    if start.startswith(b"tensor_file\0"):
        return "rgl"
    if _READINGS in start:
        raise InputError(
            f"{path}: the log of a Reflet goniometer: its 'Data file type' names what was scanned for, but the numbers "
            "are readings of the detector, which may be negative, not f in 1/sr; export the measurement from the "
            "instrument's program, to LightTools, Zemax or ASTM"
        )
    # comments may stand in front; LightTools alone has an angle of incidence in each block
    return "lighttools" if any(line.lstrip().startswith(b"AOI") for line in start.splitlines()) else "zemax"


def _compare(table: Table, again: Table) -> tuple[float, float, float]:
    """Median and worst relative RMS difference of rows, and mean relative difference of albedos.

    Evaluated at the centres of the table's cells, known ones, in at most 16 rows; where it has a highlight on a finer
    grid, at directions drawn from both tables and everywhere. Where the numbers of channels differ, means over
    channels are compared; wavelengths, by which a file may sort them, from the longest.
    """
    from gonio.core.directions import direction
    from gonio.formats.colour import from_longest

    rows = np.unique(np.linspace(0, len(table.theta_i) - 1, 16).round().astype(int))
    centres = direction(table.theta_r[:, None], table.delta_phi).reshape(-1, 3)
    same = len(table.channels) == len(again.channels)
    albedos, errors = [], []
    for row in rows:
        wi = direction(table.theta_i[row])
        wo, weight = centres, table.projected_solid_angles.ravel()
        if table.peak is not None:
            wo, weight = _drawn((table, again), wi)
        if table.gaps is not None:
            weight = weight * ~table.gaps[row][_cells(table, wo)]
        weight = weight[:, None]
        before = table.eval(wi, wo)[..., from_longest(table)]
        after = again.eval(wi, wo)[..., from_longest(again)]
        if not same:
            before, after = before.mean(axis=-1, keepdims=True), after.mean(axis=-1, keepdims=True)
        norm = np.sum(weight * before**2, axis=0)
        difference = np.sum(weight * (after - before) ** 2, axis=0)
        lit = norm > 0
        errors.append(np.sqrt(difference[lit] / norm[lit]))
        a, b = np.sum(weight * before, axis=0), np.sum(weight * after, axis=0)
        albedos.append(np.abs(b[lit] / a[lit] - 1))
    flat, albedo = np.concatenate(errors), np.concatenate(albedos)
    if flat.size == 0:
        return 0.0, 0.0, 0.0
    return float(np.median(flat)), float(flat.max()), float(albedo.mean())


def _drawn(tables: tuple[Table, ...], wi: Any) -> tuple[Any, Any]:
    """Directions, as many where each table has its light as everywhere, and what projected solid angle each is."""
    from gonio.core.directions import direction

    rng = np.random.default_rng(0)
    light = np.broadcast_to(wi, (_DIRECTIONS, 3))
    u = rng.random((_DIRECTIONS, 2))
    pieces = [direction(np.arcsin(np.sqrt(u[:, 0])), 2.0 * np.pi * u[:, 1])]
    for table in tables:
        drawn, density = table.sample(light, rng.random((_DIRECTIONS, 3)))
        pieces.append(drawn[density > 0])
    wo = np.concatenate(pieces)
    cosine = np.maximum(wo[:, 2], 0.0)
    density = cosine / np.pi + sum(table.pdf(np.broadcast_to(wi, wo.shape), wo) for table in tables)
    return wo, np.divide(cosine, density * _DIRECTIONS, out=np.zeros(len(wo)), where=density > 0)


def _cells(table: Table, wo: Any) -> tuple[Any, Any]:
    """Ring and sector of each direction, for light at azimuth 0."""
    theta_r = np.arccos(np.clip(wo[:, 2], 0.0, 1.0))
    delta_phi = np.abs(np.arctan2(wo[:, 1], wo[:, 0]))
    axes = (table.theta_r_edges, theta_r), (table.delta_phi_edges, delta_phi)
    ring, sector = (np.clip(np.searchsorted(e, x, "right") - 1, 0, len(e) - 2) for e, x in axes)
    return ring, sector
