"""From materials' descriptions to the arrays of `renderer.materials`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from fitting.models import SHAPE, SIZE, find_lobe
from fitting.result import Fit
from gonio.core.optics import fresnel_dielectric
from gonio.table.anisotropic import AnisotropicTable
from gonio.table.anisotropic_pool import pool_anisotropic
from gonio.table.pool import pool_tables
from gonio.table.table import Table
from microgeometry.errors import InputError
from renderer.analytic import Lobes
from renderer.materials import ANISOTROPIC, KINDS, TRANSMITTING, Materials
from renderer.scene import Array, Material
from renderer.spectral import rgb_anisotropic, rgb_table, rgb_weights

DISTRIBUTIONS = {"beckmann": 0.0, "ggx": 1.0}


def pack_materials(materials: Sequence[Material]) -> Materials:
    """Arrays of a scene's materials.

    Raises
    ------
    InputError
        An unknown kind, a value out of range, or a table or fit whose channels are no colours (see
        `renderer.spectral`).
    """
    values = np.zeros((len(materials), 12))
    kinds = np.zeros(len(materials), np.int64)
    first, count = np.zeros((2, len(materials)), np.int64)
    # as they are given, with their names
    tables: list[tuple[Table, str]] = []
    anisotropic: list[tuple[AnisotropicTable, str]] = []
    lobes: list[Lobes] = [Lobes(np.zeros(0, np.int64), np.zeros((0, SIZE)), np.zeros((0, 7)))]
    for m, material in enumerate(materials):
        if material.kind not in KINDS:
            raise InputError(f"material: unknown kind {material.kind!r}; allowed are {', '.join(KINDS)}")
        kinds[m] = KINDS.index(material.kind)
        if material.kind in _ROWS:
            entries = _ROWS[material.kind](material)
            values[m, : len(entries)] = entries
        elif material.kind == "tabulated":
            table: Table | AnisotropicTable = material.values["table"]
            if isinstance(table, AnisotropicTable):
                kinds[m] = ANISOTROPIC
                first[m] = _place(table, _name(material), anisotropic)
            else:
                first[m] = _place(table, _name(material), tables)
        elif material.kind == "analytic":
            fit: Fit = material.values["fit"]
            lobes.append(_lobes(fit, _name(material)))
            first[m], count[m] = sum(len(part.kind) for part in lobes[:-1]), len(lobes[-1].kind)
            if any(find_lobe(lobe.name).transmits for lobe in fit.lobes):
                kinds[m] = TRANSMITTING
    return Materials(
        kinds,
        np.array([m.two_sided for m in materials], np.int64),
        values,
        first,
        count,
        pool_tables([rgb_table(table, name) for table, name in tables]),
        pool_anisotropic([rgb_anisotropic(table, name) for table, name in anisotropic]),
        Lobes(*(np.concatenate(parts) for parts in zip(*lobes, strict=True))),
    )


_AnyTable = TypeVar("_AnyTable")


def _place(table: _AnyTable, name: str, tables: list[tuple[_AnyTable, str]]) -> int:
    """Number of the table in the list, which it joins if it is new."""
    for i, (other, _) in enumerate(tables):
        if other is table:
            return i
    tables.append((table, name))
    return len(tables) - 1


def _name(material: Material) -> str:
    return str(material.values.get("filename", material.kind))


def _lobes(fit: Fit, name: str) -> Lobes:
    """A model's lobes; the two terms of one lobe, which a fit lists apart, are evaluated together."""
    for lobe in fit.lobes:
        if not find_lobe(lobe.name).isotropic:
            raise InputError(
                f"{name}: lobe {lobe.name} is anisotropic, but surfaces of a scene have no direction for its "
                "x axis; an isotropic lobe is needed"
            )
    kinds, shapes, weights = fit.terms()
    spectrum = rgb_weights(fit.channels, fit.wavelengths_nm, name)
    if spectrum is not None:
        weights = np.maximum(weights @ spectrum.T, 0.0)  # a colour outside the gamut is cut off
    merged: dict[tuple, Array] = {}
    for kind, shape, weight in zip(kinds, shapes, weights, strict=True):
        rgb = np.broadcast_to(weight, (3,))
        entry = merged.setdefault((int(kind), *shape[SHAPE:]), np.zeros(7))
        entry[:3] += shape[0] * rgb
        entry[3:6] += shape[1] * rgb
    lobes = np.array(list(merged.values())).reshape(-1, 7)
    # The second term is Schlick's grazing part or a correction: small but near the horizon.
    chance = lobes[:, :3].mean(axis=1) + 0.2 * lobes[:, 3:6].mean(axis=1)
    lobes[:, 6] = chance / max(chance.sum(), 1e-300)
    packed = np.zeros((len(merged), SIZE))
    packed[:, :SHAPE] = 1.0
    for row, key in zip(packed, merged, strict=True):
        row[SHAPE:] = key[1:]
    return Lobes(np.array([key[0] for key in merged], np.int64), packed, lobes)


def _rgb(material: Material, name: str, default: float = 1.0, largest: float = 1.0) -> list[float]:
    value = np.broadcast_to(np.asarray(material.values.get(name, default), np.float64), (3,))
    if not np.all((value >= 0) & (value <= largest)):
        raise InputError(f"{material.kind}: {name} is {value.tolist()}; 0 to {largest:g} is allowed")
    return value.tolist()


def _positive(material: Material, name: str, default: float) -> float:
    value = float(material.values.get(name, default))
    if not 0 < value < np.inf:
        raise InputError(f"{material.kind}: {name} is {value}; a positive number is needed")
    return value


def _diffuse(material: Material) -> list[float]:
    return _rgb(material, "reflectance", 0.5)


def _conductor(material: Material) -> list[float]:
    """eta, k, colour: three each. Without eta and k a perfect mirror: eta 0 reflects all, exactly."""
    eta = _rgb(material, "eta", 0.0, np.inf)
    k = _rgb(material, "k", 1.0, np.inf)
    return [*eta, *k, *_rgb(material, "specular_reflectance")]


def _rough_conductor(material: Material) -> list[float]:
    name = str(material.values.get("distribution", "beckmann"))
    if name not in DISTRIBUTIONS:
        raise InputError(f"rough conductor: distribution {name!r}; allowed are {', '.join(DISTRIBUTIONS)}")
    alpha = _positive(material, "alpha", 0.1)
    return [*_conductor(material), max(alpha, 1e-4), DISTRIBUTIONS[name]]


def _dielectric(material: Material) -> list[float]:
    eta = _positive(material, "eta", 1.5046)
    return [eta, *_rgb(material, "specular_reflectance"), *_rgb(material, "specular_transmittance")]


def _plastic(material: Material) -> list[float]:
    """eta, diffuse colour, mirror colour, inner diffuse reflectance, nonlinear, weight of the mirror part."""
    eta = _positive(material, "eta", 1.49)
    diffuse, mirror = _rgb(material, "reflectance", 0.5), _rgb(material, "specular_reflectance")
    weight = np.mean(mirror) / max(np.mean(mirror) + np.mean(diffuse), 1e-9)
    nonlinear = float(bool(material.values.get("nonlinear", False)))
    return [eta, *diffuse, *mirror, diffuse_fresnel(1 / eta), nonlinear, float(np.clip(weight, 0.05, 0.95))]


def diffuse_fresnel(eta: float) -> float:
    """Reflectance of a smooth interface of relative index `eta` for diffuse light: int 2 F cos d(cos)."""
    nodes, weights = np.polynomial.legendre.leggauss(64)
    # split at the critical angle, where the derivative is infinite; squared steps tame it
    critical = float(np.sqrt(max(0.0, 1 - eta * eta)))
    total = critical**2
    steps = 0.5 * (nodes + 1)
    for step, weight in zip(steps, 0.5 * weights, strict=True):
        cosine = critical + (1 - critical) * step**2
        s, p = fresnel_dielectric(cosine, eta)
        total += weight * 2 * step * (1 - critical) * 2 * cosine * 0.5 * (s + p)
    return float(total)


_ROWS: dict[str, Callable[[Material], list[float]]] = {
    "diffuse": _diffuse,
    "conductor": _conductor,
    "rough_conductor": _rough_conductor,
    "dielectric": _dielectric,
    "plastic": _plastic,
}
