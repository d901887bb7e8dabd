"""A measured height map, in any format SurfaceTopography reads."""

from __future__ import annotations

import io
import re
import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.signal import windows
from scipy.sparse.linalg import spsolve

from microgeometry.errors import InputError
from microgeometry.keys import METRES, Keys
from microgeometry.tile import HeightField

LEVEL_DEGREE = {"plane": 1, "curvature": 2, "none": 0}
"""Degree of the polynomial that levelling takes out, by least squares over the measured samples."""

TILINGS = ("mirror", "window", "repeat")
_TAPER = 0.1  # part of the map on each side that a window tapers


@dataclass(frozen=True)
class HeightMap:
    """Heights from a profilometer or an AFM file (x3p, sur, plux, gwy, opd, text, npy, ...).

    Keys of [surface]:

    - ``file``, relative to the specimen's folder.
    - ``units``: the unit of all lengths, lateral and height. Needed only if the file states none; if both
      do, the key overrides the file: its numbers are read as being in this unit.
    - ``size`` = [Lx, Ly], the lateral size in ``units`` (which it needs): only for a file that states none,
      or a wrong one.
    - ``level``: "plane" (default) takes out a least-squares plane, "curvature" a paraboloid, "none" only
      the mean.
    - ``holes``: "refuse" (default) a map with samples that were not measured, or "fill" them by the
      smoothest surface through their rims (Laplace's equation): flatter than the true one, so a map
      that is more than half holes is refused anyway.
    - ``tiling``: a measured map is not periodic. "mirror" (default) puts it beside its mirror images, 2 x 2,
      so edges meet exactly: no heights are altered, but the tile is four times as large and as symmetric
      in its slopes as a mirror makes it; a brushed or blazed surface loses its one-sidedness. "window" brings
      the heights of the outer tenth on each side down to their mean by a raised cosine (Tukey's window): the
      tile is as large as the map and keeps its one-sidedness, but 36 % of it is smoother than the surface, and
      form that levelling left is slope there. "repeat" takes the map as one period as it stands: right for
      a map that is periodic, else with a cliff along the seam.

    x and y run in the order of the file (columns, rows; a .npy is [x, y]): where the instrument counts
    rows downwards, the tile is the surface's mirror image.

    Attributes
    ----------
    file : Path
    unit : float or None
        Metres per unit of the file's numbers; None: as the file says.
    file_size : tuple of float or None
        Lateral size in metres; None: as the file says.
    level, holes, tiling : str
    """

    kind: ClassVar[str] = "heightmap"
    is_random: ClassVar[bool] = False

    file: Path
    unit: float | None = None
    file_size: tuple[float, float] | None = None
    level: str = "plane"
    holes: str = "refuse"
    tiling: str = "mirror"

    @classmethod
    def from_keys(cls, keys: Keys, folder: Path) -> HeightMap:
        """Build from the [surface] table; the file must exist, but is read at the first `realise`."""
        keys.allow("kind", "file", "units", "size", "level", "holes", "tiling")
        file = folder / keys.text("file")
        if not file.is_file():
            raise keys.error("file", f"there is no file {file}; paths are relative to the specimen's folder")
        unit = METRES[keys.choice("units", None, METRES)] if "units" in keys else None
        size = None
        if "size" in keys:
            numbers = keys.numbers("size", above=0)
            if len(numbers) != 2 or unit is None:
                raise keys.error("size", "must be [Lx, Ly], and needs units beside it")
            size = (numbers[0] * unit, numbers[1] * unit)
        level = keys.choice("level", "plane", LEVEL_DEGREE)
        holes = keys.choice("holes", "refuse", ("refuse", "fill"))
        return cls(file, unit, size, level, holes, keys.choice("tiling", "mirror", TILINGS))

    @property
    def n_holes(self) -> int:
        """Number of samples of the file that were not measured (filled, if `realise` succeeds)."""
        return self._measured[2]

    def realise(self, seed: int) -> HeightField:
        """Return the tile, the same for every seed; the file is read once.

        Raises
        ------
        InputError
            The file cannot be read, is no map of at least 2 x 2 heights, states no unit or size, or has
            holes that are refused.
        """
        return self._tile

    @cached_property
    def _tile(self) -> HeightField:
        heights, step, _ = self._measured
        if self.tiling == "mirror":
            # Sample n-1 and sample 0 stand once each: 0 1 .. n-1 n-2 .. 1, a period of 2 n - 2.
            heights = np.concatenate((heights, heights[-2:0:-1]), axis=0)
            heights = np.concatenate((heights, heights[:, -2:0:-1]), axis=1)
        elif self.tiling == "window":
            # Its first value is 0, its last one step above it: the first of the next period.
            rows, columns = (windows.tukey(n, 2 * _TAPER, sym=False) for n in heights.shape)
            heights = heights * rows[:, None] * columns
        nx, ny = heights.shape
        return HeightField(heights, (nx * step[0], ny * step[1]))

    @cached_property
    def _measured(self) -> tuple[NDArray[np.float64], tuple[float, float], int]:
        """Levelled and filled heights, sampling steps (both metres), and the number of holes."""
        heights, (lx, ly) = _read(self.file, self.unit, self.file_size)
        step = (lx / heights.shape[0], ly / heights.shape[1])
        hole = ~np.isfinite(heights)
        n_holes = int(np.count_nonzero(hole))
        share = f"{n_holes} of {hole.size} samples ({100 * n_holes / hole.size:.2g} %) were not measured"
        if n_holes > hole.size // 2:
            raise InputError(f"{self.file}: {share}; with more than half missing there is nothing to go by")
        if n_holes and self.holes == "refuse":
            raise InputError(f'{self.file}: {share}; set holes = "fill" under [surface] to interpolate them')
        heights = _level(heights, hole, LEVEL_DEGREE[self.level])
        return (_fill(heights, hole, step) if n_holes else heights), step, n_holes


def _read(
    file: Path, unit: float | None, size: tuple[float, float] | None
) -> tuple[NDArray[np.float64], tuple[float, float]]:
    """Heights, with NaN where not measured, and lateral size, in metres."""
    # Imported here: it takes more than a second, which no other surface need wait for.
    from SurfaceTopography import open_topography
    from SurfaceTopography.Exceptions import CannotDetectFileFormat
    from SurfaceTopography.Support.UnitConversion import get_unit_conversion_factor

    try:
        with open_topography(_open(file)) as reader:
            channel = reader.default_channel
            missing = {} if channel.physical_sizes else {"physical_sizes": (1.0, 1.0)[: channel.dim]}
            topography = reader.topography(**missing)
            heights = np.ma.filled(np.ma.asarray(topography.heights(), dtype=np.float64), np.nan)
            file_unit = topography.unit
    except CannotDetectFileFormat as error:
        raise InputError(
            f"{file}: not a height map in a format that SurfaceTopography reads; export it as "
            "x3p, sur, gwy or a text matrix"
        ) from error
    except Exception as error:  # forty readers, each with errors of its own
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{file}: the height map cannot be read ({reason}); is it complete?") from error
    if heights.ndim != 2 or min(heights.shape) < 2:
        raise InputError(f"{file}: holds heights of shape {heights.shape}; 2 x 2 is the least")
    if unit is None:
        try:
            # The Greek letter is as common as the micro sign, but SurfaceTopography knows only the latter.
            unit = float(get_unit_conversion_factor(str(file_unit).replace("\u03bc", "\u00b5"), "m"))
        except ValueError as error:
            found = "no unit" if file_unit is None else f"a unit that is no length ({file_unit!r})"
            raise InputError(
                f'{file}: the file states {found}; add units = "um" (or m, mm, nm) under [surface]'
            ) from error
    if size is None:
        if missing:
            raise InputError(f"{file}: the file states no lateral size; add size = [Lx, Ly] under [surface]")
        lx, ly = topography.physical_sizes
        size = (float(lx) * unit, float(ly) * unit)
    if not all(0 < length < np.inf for length in size):
        raise InputError(
            f"{file}: the file states a lateral size of {size[0]:g} x {size[1]:g} m; "
            "add size = [Lx, Ly] and units under [surface]"
        )
    return heights * unit, size


def _open(file: Path) -> str | io.BytesIO:
    """Return the path, or a repaired copy in memory of an x3p that SurfaceTopography would not take.

    Two flaws of files in circulation (fix3p, archives packed on a Mac): everything stands in a folder
    inside the archive, and an empty <Offset/>, which means no offset.
    """
    if not zipfile.is_zipfile(file):
        return str(file)
    with zipfile.ZipFile(file) as archive:
        names = [name for name in archive.namelist() if not name.startswith("__MACOSX/")]
        index = [name for name in names if name == "main.xml" or name.endswith("/main.xml")]
        if len(index) != 1:
            return str(file)
        main = archive.read(index[0])
        mended = re.sub(rb"<Offset\s*/>|<Offset>\s*</Offset>", b"", main)
        folder = index[0][: -len("main.xml")]
        if not folder and mended == main:
            return str(file)
        copy = io.BytesIO()
        with zipfile.ZipFile(copy, "w") as repaired:
            for name in names:
                if name.startswith(folder) and not name.endswith("/"):
                    repaired.writestr(name[len(folder) :], mended if name == index[0] else archive.read(name))
    copy.seek(0)
    return copy


def _level(heights: NDArray[np.float64], hole: NDArray[np.bool_], degree: int) -> NDArray[np.float64]:
    """Take out the polynomial of a total degree that fits the measured samples best."""
    x, y = (np.linspace(-1.0, 1.0, n) for n in heights.shape)
    terms = [np.multiply.outer(x**a, y**b) for a in range(degree + 1) for b in range(degree + 1 - a)]
    measured = np.stack([term[~hole] for term in terms], axis=1)
    coefficients = np.linalg.lstsq(measured, heights[~hole], rcond=None)[0]
    return heights - sum(c * term for c, term in zip(coefficients, terms, strict=True))


def _fill(
    heights: NDArray[np.float64], hole: NDArray[np.bool_], step: tuple[float, float]
) -> NDArray[np.float64]:
    """Fill holes by Laplace's equation with the rim's heights; at the map's edge the slope is free."""
    number = np.full(hole.shape, -1)
    number[hole] = np.arange(np.count_nonzero(hole))
    n = int(number.max()) + 1
    diagonal, right, links = np.zeros(n), np.zeros(n), []
    for axis, length in enumerate(step):
        weight = 1.0 / length**2 * min(step) ** 2
        for a, b in ((0, 1), (1, 0)):  # every neighbour to the one side, then to the other
            here = np.delete(number, -1 if a == 0 else 0, axis=axis)
            there = np.delete(number, -1 if b == 0 else 0, axis=axis)
            known = np.delete(heights, -1 if b == 0 else 0, axis=axis)
            inside, rim = (here >= 0) & (there >= 0), (here >= 0) & (there < 0)
            np.add.at(diagonal, here[here >= 0], weight)
            np.add.at(right, here[rim], weight * known[rim])
            links.append(
                sparse.coo_array(
                    (np.full(np.count_nonzero(inside), -weight), (here[inside], there[inside])), shape=(n, n)
                )
            )
    filled = heights.copy()
    filled[hole] = spsolve((sparse.diags_array(diagonal) + sum(links)).tocsc(), right)
    return filled
