"""The bsdf elements of a scene file, one function each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fitting.result import Fit
from gonio.table.anisotropic import AnisotropicTable
from gonio.table.table import Table
from microgeometry.errors import InputError
from microgeometry.indices import refractive_index
from renderer.scene import Material
from renderer.spectral import rgb_weights
from renderer.xml_properties import Node

RGB_WAVELENGTHS_NM = (630.0, 532.0, 467.0)
"""Where a named metal's index is looked up for red, green and blue."""

_INDICES = {
    "vacuum": 1.0, "helium": 1.000036, "hydrogen": 1.000132, "air": 1.000277, "carbon dioxide": 1.00045,
    "water": 1.3330, "acetone": 1.36, "ethanol": 1.361, "carbon tetrachloride": 1.461, "glycerol": 1.4729,
    "benzene": 1.501, "silicone oil": 1.52045, "bromine": 1.661, "water ice": 1.31, "fused quartz": 1.458,
    "pyrex": 1.470, "acrylic glass": 1.49, "polypropylene": 1.49, "bk7": 1.5046, "sodium chloride": 1.544,
    "amber": 1.55, "pet": 1.5750, "diamond": 2.419,
}  # fmt: skip


def check_channels(node: Node, path: Path, content: Table | AnisotropicTable | Fit) -> None:
    """Refuse a file whose channels are no colours."""
    try:
        rgb_weights(content.channels, content.wavelengths_nm, str(path))
    except InputError as error:
        raise node.error(str(error)) from None


def diffuse(node: Node) -> Material:
    """Lambert's reflection."""
    return Material("diffuse", {"reflectance": node.rgb("reflectance", 0.5)})


def _conductor_values(node: Node) -> dict[str, Any]:
    values: dict[str, Any] = {"specular_reflectance": node.rgb("specular_reflectance", 1.0)}
    name = node.string("material", "none")
    eta, k = (
        node.take("eta", None, ("rgb", "spectrum", "float")),
        node.take("k", None, ("rgb", "spectrum", "float")),
    )
    if (eta is None) != (k is None):
        raise node.error("one of eta and k is missing; both or neither are needed")
    if eta is not None:
        if name != "none":
            raise node.error("has both a material's name and eta, k; one of them is needed")
        values |= {"eta": eta, "k": k}
    elif name != "none":
        try:
            n, k = refractive_index(name, RGB_WAVELENGTHS_NM)
        except InputError as error:
            raise node.error(str(error)) from None
        values |= {"eta": tuple(n), "k": tuple(k)}
    return values


def conductor(node: Node) -> Material:
    """A smooth metal, by indices or by name."""
    return Material("conductor", _conductor_values(node))


def rough_conductor(node: Node) -> Material:
    """A metal with microfacets."""
    alpha = float(node.number("alpha", 0.1))
    distribution = node.string("distribution", "beckmann")
    if distribution not in ("beckmann", "ggx"):
        raise node.error(f"distribution is {distribution!r}; allowed are beckmann, ggx")
    if not alpha > 0:
        raise node.error(f"alpha is {alpha}; a positive roughness is needed, or type conductor")
    node.ignore("sample_visible")
    return Material(
        "rough_conductor", {**_conductor_values(node), "alpha": alpha, "distribution": distribution}
    )


def _relative_index(node: Node, default: str) -> float:
    indices = []
    for name, fallback in (("int_ior", default), ("ext_ior", "air")):
        value = node.take(name, fallback, ("float", "string"))
        if isinstance(value, str):
            if value not in _INDICES:
                raise node.error(f"{name} is {value!r}; a number or one of {', '.join(_INDICES)} is allowed")
            value = _INDICES[value]
        if not value > 0:
            raise node.error(f"{name} is {value}; a positive index is needed")
        indices.append(value)
    return indices[0] / indices[1]


def dielectric(node: Node) -> Material:
    """Smooth glass."""
    values = {name: node.rgb(name, 1.0) for name in ("specular_reflectance", "specular_transmittance")}
    return Material("dielectric", {"eta": _relative_index(node, "bk7"), **values})


def plastic(node: Node) -> Material:
    """A smooth dielectric coat on a diffuse base."""
    return Material(
        "plastic",
        {
            "eta": _relative_index(node, "polypropylene"),
            "reflectance": node.rgb("diffuse_reflectance", 0.5),
            "specular_reflectance": node.rgb("specular_reflectance", 1.0),
            "nonlinear": node.flag("nonlinear"),
        },
    )


def analytic(node: Node) -> Material:
    """A fit's or hand-written model's JSON file."""
    path = node.file()
    fit = Fit.load(path)
    check_channels(node, path, fit)
    return Material("analytic", {"fit": fit, "filename": str(path)})
