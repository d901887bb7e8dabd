"""Zemax tabular BSDF files `.bsdf` (text; Radiant Imaging's BSDF data interchange format).

Values are f in 1/sr without cosine, in angles about the specular direction (of transmission: about the
straight continuation). With the light at azimuth 0 and angle of incidence a, the direction of radial angle
r and azimuth z, which is 0 from the specular direction towards the normal, is::

    x = sin r cos z cos a - cos r sin a,   y = sin r sin z,   cos theta_r = sin r cos z sin a + cos r cos a

Below the horizon values are 0. Rows are azimuths, columns radial angles; ``PlaneSymmetrical`` files hold
azimuths 0 to 180 degrees.

The ``TIS`` line of a row states its total reflectance. OpticStudio scales the values to it. That is no reason
to read them so: where an instrument sees 80 degrees about the mirror direction TIS holds what lies beyond as
well, and where a mirror's share is in no sample TIS holds that; scaled values would be too bright, by 3 to 18 %
and by 50 times in Ansys's examples. So values are read as they stand, and both reflectances are kept in
the provenance, under ``tis`` and ``integral``, and ``lost`` says where they differ.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.core.directions import direction, projected_solid_angles
from gonio.files import atomic
from gonio.formats.cells import average_cells, check_size, justified_bytes, table_of
from gonio.formats.colour import RGB_TO_XYZ, XYZ_TO_RGB, as_colour
from gonio.formats.grid import close_circle, interpolate
from gonio.formats.losses import common_losses, stated_reflectance
from gonio.formats.samples import Samples
from gonio.formats.text import Words, angles
from gonio.table.parts import TRANSMISSION, is_transmission
from gonio.table.table import Table
from microgeometry.errors import InputError

Array = NDArray[np.float64]

_CHANNELS = {"monochrome": ("Monochrome",), "xyz": ("TristimulusX", "TristimulusY", "TristimulusZ")}
_SYMMETRIES = ("planesymmetrical", "asymmetrical", "asymmetrical4d")
_LISTS = ("SampleRotation", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial")
_COARSEST = 18  # cells per quarter turn
_AZIMUTHS = np.arange(0.0, 181.0, 5.0)
_RADIALS = np.concatenate(
    [np.arange(*span) for span in ((0, 2, 0.25), (2, 5, 0.5), (5, 15, 1.0), (15, 45, 2.5), (45, 181, 5.0))]
)


def read(path: Path) -> Table:
    """Read a Zemax file, one row for each angle of incidence.

    Directions beyond the largest radial angle are gaps. Several rotations of the sample are averaged, and
    the two sides of the plane of incidence. Tristimulus values become linear sRGB.

    Returns
    -------
    Table
        Channel Y, or R, G, B. A BTDF is the part "transmission" of a table of gaps.

    Raises
    ------
    InputError
        A keyword that is missing or unknown, angles that do not increase, or numbers that are missing.
    """
    header, axes, data, tis = _read(path)
    rotations = axes[_LISTS[0]]
    full_turn = len(rotations) > 1 and rotations[-1] - rotations[0] > 2 * np.pi - 1e-6
    turns = slice(0, -1 if full_turn else None)
    data, tis = data[turns].mean(axis=0), tis[turns].mean(axis=0)
    lost = [f"{len(rotations)} rotations of the sample: they are averaged"] if len(rotations) > 1 else []
    return _tabulate(path, header, tuple(axes[name] for name in _LISTS[1:]), data, tis, lost)


def samples_of(path: Path) -> dict[str, Samples]:
    """The file's samples above the horizon, as `gonio.formats` has them; errors as `read`."""
    header, axes, data, _ = _read(path)
    aoi, azimuth, radial = (axes[name] for name in _LISTS[1:])
    theta_r, phi = _from_specular(aoi[:, None, None], azimuth[:, None], radial)
    samples = Samples.on_grid(aoi[:, None, None], theta_r, phi, data)
    above = samples.where(samples.theta_r < np.pi / 2)
    return {"" if header["ScatterType"] == "brdf" else TRANSMISSION: above}


def _read(path: Path) -> tuple[dict[str, str], dict[str, Array], Array, Array]:
    """Header, lists of angles, and values and TIS by rotation, angle of incidence (azimuth, radial), channel."""
    words = Words(path)
    header, axes = _read_header(words)
    rotations, aoi, azimuths, radials = (axes[name] for name in _LISTS)
    names = _CHANNELS[header["SpectralContent"]]
    shape = (len(rotations), len(aoi), len(azimuths), len(radials))
    data = np.empty((*shape, len(names)))
    tis = np.empty((*shape[:2], len(names)))
    for c, name in enumerate(names):
        for keyword in (name, "DataBegin"):
            _expect(words, keyword)
        for rotation, incidence in np.ndindex(*shape[:2]):
            _expect(words, "TIS")
            tis[rotation, incidence, c] = words.number("TIS")
            block = words.numbers(shape[2] * shape[3], f"{name}, angle of incidence {incidence + 1}")
            data[rotation, incidence, :, :, c] = block.reshape(shape[2:])
        _expect(words, "DataEnd")
    if len(names) == 3:
        data, tis = data @ XYZ_TO_RGB.T, tis @ XYZ_TO_RGB.T
    return header, axes, data, tis


def write(table: Table, path: Path) -> list[str]:
    """Write a table's interpolated values as a plane-symmetrical BRDF.

    Parameters
    ----------
    table : Table
        Of one channel, or three, taken as linear sRGB and written as tristimulus values. A table of
        transmission (``--part transmission`` or a part of it) is written as a BTDF.
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
    n_channels = len(table.channels)
    table = as_colour(table, path, "a Zemax file")
    transmits = is_transmission(table)
    names = _CHANNELS["monochrome" if n_channels == 1 else "xyz"]
    lines = [
        "# BSDF table converted by gonio; values in 1/sr, angles about the specular direction",
        "Source  Measured",
        "Symmetry  PlaneSymmetrical",
        f"SpectralContent  {'Monochrome' if n_channels == 1 else 'XYZ'}",
        f"ScatterType  {'BTDF' if transmits else 'BRDF'}",
    ]
    aoi = np.degrees(table.theta_i)
    for name, degrees in zip(_LISTS, (np.zeros(1), aoi, _AZIMUTHS, _RADIALS), strict=True):
        lines += [f"{name}  {len(degrees)}", "\t".join(f"{v:.8g}" for v in degrees)]
    azimuth, radial = np.radians(_AZIMUTHS)[:, None], np.radians(_RADIALS)
    rows = []
    for theta_i in table.theta_i:
        theta_r, phi = _from_specular(theta_i, azimuth, radial)
        values = table.eval(direction(theta_i), direction(theta_r, phi))
        values[np.cos(theta_r) < 0] = 0.0
        rows.append(values if n_channels == 1 else values @ RGB_TO_XYZ.T)
    tis = np.maximum(table.row_albedo - table.specular, 0.0)
    tis = tis if n_channels == 1 else tis @ RGB_TO_XYZ.T
    for c, name in enumerate(names):
        lines += ["", name, "DataBegin"]
        for n, values in enumerate(rows):
            lines.append(f"TIS {tis[n, c]:.6g}")
            lines += ["\t".join(f"{v:.6e}" for v in line) for line in values[..., c]]
        lines.append("DataEnd")
    with atomic(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n")
    losses = common_losses(table, "Zemax", keeps=("side", "peak", "rows"))
    if table.theta_i_edges is not None:
        losses.append("the width of the rows of incidence: their middles are written as exact angles")
    return [
        *losses,
        "what is finer than its angles: 0.25 degrees at the peak to 5 degrees far from it",
        "provenance and ledger",
    ]


def _expect(words: Words, keyword: str) -> None:
    found = words.word(keyword)
    if found.lower() != keyword.lower():
        raise InputError(
            f"{words.path}: {found[:40]!r} where {keyword} is expected; is it a Zemax BSDF file?"
        )


def _read_header(words: Words) -> tuple[dict[str, str], dict[str, Array]]:
    """Keywords in lower case, and the four lists of angles in radians."""
    allowed = {
        "Source": ("measured",),
        "Symmetry": _SYMMETRIES,
        "SpectralContent": tuple(_CHANNELS),
        "ScatterType": ("brdf", "btdf"),
    }
    header, axes = {}, {}
    for name, choices in allowed.items():
        _expect(words, name)
        header[name] = words.word(name).lower()
        if header[name] not in choices:
            raise InputError(f"{words.path}: {name} {header[name]!r}; allowed are {', '.join(choices)}")
    for name, last in zip(_LISTS, (360.0, 90.0, 360.0, 180.0), strict=True):
        _expect(words, name)
        n = words.count(f"angles of {name}")
        axes[name] = angles(words.numbers(n, name), name, words.path, last)
    if header["Symmetry"] == _SYMMETRIES[0] and axes["ScatterAzimuth"][-1] > np.pi + 1e-6:
        raise InputError(f"{words.path}: ScatterAzimuth beyond 180 degrees in a plane-symmetrical file")
    return header, axes


def _tabulate(
    path: Path,
    header: dict[str, str],
    axes: tuple[Array, ...],
    data: Array,
    tis: Array,
    lost: list[str],
) -> Table:
    """The table of values on (angle of incidence, azimuth, radial, channel)."""
    aoi, azimuths, radials = axes
    channels = ("Y",) if tis.shape[-1] == 1 else ("R", "G", "B")
    per_cell = 2 * len(aoi) * len(channels)
    n = min(_resolution(radials), int(np.sqrt(justified_bytes(path) / (8 * per_cell))))
    n = max(n, _COARSEST)
    check_size(path, per_cell * n**2, f"{len(aoi)} angles of incidence")
    edges, phi_edges = np.linspace(0, np.pi / 2, n + 1), np.linspace(0, np.pi, 2 * n + 1)
    one_side = azimuths[-1] <= np.pi + 1e-6
    data = _continued(data, aoi, azimuths, radials)

    def look(row: int, theta_r: Array, phi: Array) -> tuple[Array, NDArray[np.bool_]]:
        azimuth, radial = _to_specular(float(aoi[row]), theta_r, phi)
        azimuth = np.abs(azimuth) if one_side else azimuth % (2 * np.pi)
        # the cells that hold the outermost samples are known, and so are those that are interpolated to from there
        nearest = np.clip(radial, radials[0], radials[-1])
        radial = np.where(np.abs(radial - nearest) < 0.5 * np.pi / n, nearest, radial)
        nodes, values = close_circle(azimuths, data[row])
        found, inside = interpolate(values, nodes, radials, azimuth, radial)
        return found, inside

    values, gaps = average_cells(look, len(aoi), edges, phi_edges, len(channels), points=(2, 2))
    integral = np.einsum("irpc,rp->ic", values, projected_solid_angles(edges, phi_edges))
    lost = [*lost, *stated_reflectance(tis, integral, "the reflectance TIS", "OpticStudio scales")]
    provenance = {
        "source": path.name,
        "format": "Zemax",
        "tis": tis.tolist(),
        "integral": integral.tolist(),
        "lost": lost,
    }
    table = table_of(values, gaps, aoi, edges, phi_edges, channels, provenance=provenance)
    if header["ScatterType"] == "brdf":
        return table
    dark = table_of(0 * values, np.ones_like(gaps), aoi, edges, phi_edges, channels, provenance=provenance)
    return dark.replace(parts={TRANSMISSION: table.replace(provenance={})})


def _resolution(radials: Array) -> int:
    """Cells per quarter turn: a quarter of the closest spacing of the radial angles, 1 to 5 degrees."""
    spacing = np.diff(radials).min() if len(radials) > 1 else np.pi / 2
    return int(np.clip(np.ceil(2 * np.pi / spacing), _COARSEST, 90))


def _continued(data: Array, aoi: Array, azimuths: Array, radials: Array) -> Array:
    """The values, with the zeros below the horizon exchanged for what is last above it along the radial angle.

    Between samples f does not fall to 0 towards the horizon; f cos(theta_r) does.
    """
    theta_r, _ = _from_specular(aoi[:, None, None], azimuths[:, None], radials)
    below = np.cos(theta_r) < 1e-6
    # the mirror direction itself is above, but for light that grazes
    last = np.maximum.accumulate(np.where(below, 0, np.arange(len(radials))), axis=2)
    return np.take_along_axis(data, last[..., None], axis=2)


def _to_specular(theta_i: float, theta_r: Array, phi: Array) -> tuple[Array, Array]:
    """Azimuth in [-pi, pi] and radial angle about the specular direction, for light at azimuth 0."""
    x, y, z = np.sin(theta_r) * np.cos(phi), np.sin(theta_r) * np.sin(phi), np.cos(theta_r)
    towards_normal = x * np.cos(theta_i) + z * np.sin(theta_i)
    along = -x * np.sin(theta_i) + z * np.cos(theta_i)
    return np.arctan2(y, towards_normal), np.arctan2(np.hypot(towards_normal, y), along)


def _from_specular(theta_i: Array | float, azimuth: Array, radial: Array) -> tuple[Array, Array]:
    """Polar angle and delta phi, the inverse of `_to_specular`; broadcast."""
    towards_normal, y = np.sin(radial) * np.cos(azimuth), np.sin(radial) * np.sin(azimuth)
    along = np.cos(radial) + 0 * azimuth
    x = towards_normal * np.cos(theta_i) - along * np.sin(theta_i)
    z = towards_normal * np.sin(theta_i) + along * np.cos(theta_i)
    return np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
