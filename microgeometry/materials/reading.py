"""Reading optical quantities from a specimen's tables, one value per spectral sample."""

from __future__ import annotations

from pathlib import Path

from microgeometry.grid import Grid
from microgeometry.indices import refractive_index, tabulated_index
from microgeometry.keys import Keys


def per_sample(keys: Keys, key: str, values: tuple[float, ...], grid: Grid) -> tuple[float, ...]:
    """Return the S values of a key that holds one for all samples or one each."""
    if len(values) == 1:
        return values * grid.n_samples
    if grid.to_channels is not None:
        raise keys.error(
            key,
            f"{len(values)} values, where colours come from spectra at {grid.n_samples} wavelengths; give one "
            "number, or give no material by name, from a file or with films, or set wavelengths_nm under [grid]",
        )
    if len(values) != grid.n_samples:
        raise keys.error(
            key,
            f"{len(values)} values for {grid.n_samples} channel(s) ({', '.join(grid.channels)[:60]}); "
            f"give 1 or {grid.n_samples}, or set wavelengths_nm under [grid]",
        )
    return values


def wavelengths(keys: Keys, key: str, grid: Grid, what: str) -> tuple[float, ...]:
    """Return the grid's wavelengths, nanometres, or say that `what` needs some."""
    if grid.samples_nm is None:
        raise keys.error(
            key, f'{what} needs wavelengths; set wavelengths_nm = [...] or channels = "rgb" under [grid]'
        )
    return grid.samples_nm


def optical_constants(
    keys: Keys, grid: Grid, folder: Path, k_required: bool
) -> tuple[tuple[float, ...], tuple[float, ...], str | None]:
    """Read n and k from ``name``, from ``file``, or from ``eta`` and ``k``.

    Parameters
    ----------
    keys : Keys
        Of a material or film.
    grid : Grid
    folder : Path
        What ``file`` is relative to.
    k_required : bool
        Else k is 0 where only ``eta`` or a file without that column is given.

    Returns
    -------
    eta, k : tuple of float
        Per sample.
    name : str or None
        As given.
    """
    given = [key for key in ("name", "file", "eta", "k") if key in keys]
    if not given:
        and_k = " and k = ..." if k_required else ""
        raise keys.error(
            "name",
            f'missing; add name = "..." (see microgeometry.indices), eta = ...{and_k}, or file = "..."',
        )
    source = given[0]
    if source in ("name", "file") and len(given) > 1:
        raise keys.error(source, f"give {given[0]} or {given[1]}, not both")
    if source == "name":
        name = keys.text("name")
        n, k = refractive_index(name, wavelengths(keys, "name", grid, "a material by name"))
        return tuple(n.tolist()), tuple(k.tolist()), name
    if source == "file":
        file = keys.file("file", folder)
        nm = wavelengths(keys, "file", grid, "a material from a file")
        n, k_or_none = tabulated_index(file, nm)
        if k_or_none is None and k_required:
            raise keys.error("file", "has no column k, which a conductor needs; add it")
        return tuple(n.tolist()), (0.0,) * len(nm) if k_or_none is None else tuple(k_or_none.tolist()), None
    eta = per_sample(keys, "eta", keys.numbers("eta", above=0), grid)
    if "k" not in keys and not k_required:
        return eta, (0.0,) * grid.n_samples, None
    return eta, per_sample(keys, "k", keys.numbers("k", at_least=0), grid), None
