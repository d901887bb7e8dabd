"""What tables that know the azimuth of incidence, and those that do not, have in common."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from gonio.table import many
from microgeometry.errors import InputError

Array = NDArray[np.float64]
Self = TypeVar("Self", bound="BRDFTable")


class BRDFTable:
    """Base of `Table` and `AnisotropicTable`: a frozen dataclass with a pool for the kernels."""

    def _pools(self) -> tuple[Any, Any]:
        """The pools that the kernels of `gonio.table.many` take, with the table as table 0."""
        raise NotImplementedError

    def _channels(self) -> int:
        return len(self.channels)  # type: ignore[attr-defined]

    @property
    def luminance(self) -> Array | None:
        """Weights of the channels in the luminance Y, shape (C,), where they are CIE colour; else None.

        R, G or B of a colour outside the gamut of sRGB lie outside 0 to 1; its luminance does not.
        """
        weights = self.provenance.get("colour", {}).get("luminance")  # type: ignore[attr-defined]
        return None if weights is None else np.array(weights, float)

    def replace(self: Self, **changes: Any) -> Self:
        """A copy with some fields changed, checked like a new table."""
        own = {f.name: changes.get(f.name, getattr(self, f.name)) for f in fields(self)}  # type: ignore[arg-type]
        return type(self)(**own)

    def save(self, path: str | os.PathLike[str]) -> list[str]:
        """Write the table in the format of the suffix (.h5 keeps everything); see `gonio.formats`.

        Returns
        -------
        list of str
            What the format could not keep, one sentence each.

        Raises
        ------
        InputError
            The suffix is of no format that can hold the table.
        OSError
            The file cannot be written; nothing is left under its name.
        """
        from gonio import formats

        return formats.write(self, path)  # type: ignore[arg-type]

    def eval(self, wi: ArrayLike, wo: ArrayLike) -> Array:
        """Interpolated BRDF without the delta term; how is said in the modules of the kernels.

        Those are `gonio.table.interpolation` and `gonio.table.anisotropic_interpolation`.

        Parameters
        ----------
        wi, wo : array_like, shape (..., 3)
            Unit directions to the light and to the detector, broadcast against each other.

        Returns
        -------
        ndarray, shape (..., C)
            f_r in 1/sr; 0 where a direction is below the horizon.
        """
        wi, wo, shape = _flat(wi, wo)
        out = np.empty((len(wi), self._channels()))
        many.eval_many(*self._pools(), 0, wi, wo, out)
        return out.reshape(*shape, -1)

    def sample(self, wi: ArrayLike, u: ArrayLike) -> tuple[Array, Array]:
        """Draw `wo` in proportion to the channel mean of f cos(theta_o), without the delta term.

        Exactly so where the table is isotropic; the density is exact in either case.

        Parameters
        ----------
        wi : array_like, shape (..., 3)
            Unit directions to the light.
        u : array_like, shape (..., 3)
            Uniform in [0, 1), broadcast against `wi`.

        Returns
        -------
        wo : ndarray, shape (..., 3)
        pdf : ndarray, shape (...)
            Per solid angle; 0 marks a sample to be discarded (nothing is reflected).
        """
        wi, u, shape = _flat(wi, u)
        wo, pdf = np.empty_like(wi), np.empty(len(wi))
        many.sample_many(*self._pools(), 0, wi, u, wo, pdf)
        return wo.reshape(*shape, 3), pdf.reshape(shape)

    def pdf(self, wi: ArrayLike, wo: ArrayLike) -> Array:
        """Density per solid angle with which `sample` draws `wo`, shape (...); directions as in `eval`."""
        wi, wo, shape = _flat(wi, wo)
        out = np.empty(len(wi))
        many.pdf_many(*self._pools(), 0, wi, wo, out)
        return out.reshape(shape)


def check_arrays(table: Any, expected: Mapping[str, tuple[int, ...]], kinds: Mapping[str, DTypeLike]) -> None:
    """Make read-only arrays of the table's fields, of these shapes and types (default float64); None stays.

    Raises
    ------
    InputError
        A shape, a NaN, or a standard error below 0.
    """
    for name, want in expected.items():
        given = getattr(table, name)
        if given is None:
            continue
        array: NDArray = np.array(given, kinds.get(name, np.float64))
        if array.shape == () and name.startswith(("albedo_", "specular")):
            array = np.full(want, array)
        if array.shape != want:
            raise InputError(f"{name}: shape {array.shape}; {want} is expected")
        if name.endswith("std_error") and not np.all(array >= 0):
            raise InputError(f"{name}: contains NaN or negative numbers; a standard error is >= 0")
        if name != "std_error" and not np.all(np.isfinite(array)):
            raise InputError(f"{name}: contains NaN or infinity; finite numbers are expected")
        array.setflags(write=False)
        object.__setattr__(table, name, array)


def check_channels(table: Any, channels: int) -> None:
    """Make tuples of the table's names and wavelengths of so many channels.

    Raises
    ------
    InputError
        Another number of them, or a wavelength that is none.
    """
    object.__setattr__(table, "channels", tuple(str(c) for c in table.channels))
    if len(table.channels) != channels:
        raise InputError(f"channels: {len(table.channels)} names for {channels} channels of values")
    if table.wavelengths_nm is not None:
        object.__setattr__(table, "wavelengths_nm", tuple(float(w) for w in table.wavelengths_nm))
        if len(table.wavelengths_nm) != channels or not all(w > 0 for w in table.wavelengths_nm):
            raise InputError(
                f"wavelengths_nm: {table.wavelengths_nm}; {channels} positive numbers are expected"
            )


def check_parts(table: Any, shared: Sequence[str]) -> None:
    """Make a dict of the table's parts, which are tables like it with these fields in common.

    Raises
    ------
    InputError
        A name that is no word, or a part that is of another kind or on another grid.
    """
    object.__setattr__(table, "parts", dict(table.parts))
    for name, part in table.parts.items():
        if not isinstance(name, str) or name in ("", ".") or "/" in name:
            raise InputError(f"parts: the name {name!r}; a word without slashes is expected")
        if not isinstance(part, type(table)):
            raise InputError(f"parts/{name}: {type(part).__name__}; a {type(table).__name__} is expected")
        for field_name in shared:
            # None, tuples and arrays alike
            if not np.array_equal(getattr(part, field_name), getattr(table, field_name)):
                raise InputError(
                    f"parts/{name}: {field_name} is not the table's; a part is on the same grid and channels"
                )


def _flat(a: ArrayLike, b: ArrayLike) -> tuple[Array, Array, tuple[int, ...]]:
    """Two arrays of triples, broadcast and flattened to shape (N, 3), and the shape they had."""
    a, b = np.broadcast_arrays(np.asarray(a, float), np.asarray(b, float))
    if a.shape[-1:] != (3,):
        raise ValueError(f"directions of shape {a.shape}; (..., 3) is expected")
    return (
        np.ascontiguousarray(a).reshape(-1, 3),
        np.ascontiguousarray(b).reshape(-1, 3),
        a.shape[:-1],
    )
