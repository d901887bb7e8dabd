"""Fitted and hand-written models for other programs: Mitsuba 3, as a dictionary or as XML, and our renderer.

Mitsuba has a plugin that is exactly ours for

- lambert: ``diffuse``;
- beckmann_separable_conductor, ggx_separable_conductor: ``roughconductor`` (its Beckmann masking is a rational
  fit, up to 0.5 % off); several of them with one channel each are one plugin with an index for each;
- beckmann_separable, ggx_separable where f0 = f90: ``roughconductor`` with a constant Fresnel term;
- beckmann_separable_dielectric, ggx_separable_dielectric, walter_beckmann, walter_ggx: ``roughdielectric``;

and for sums of these, ``blendbsdf``. Any other model goes as a table, which its ``measured`` reads.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from fitting.result import Fit, FittedLobe
from microgeometry.errors import InputError

Array = NDArray[np.float64]


def mitsuba_dict(fit: Fit, measured: str | os.PathLike[str] | None = None) -> dict[str, Any]:
    """The model as a dictionary for `mitsuba.load_dict`.

    Parameters
    ----------
    fit : Fit
        With one channel, with the channels R, G, B, or with wavelengths.
    measured : path, optional
        An RGL file of the model's table, for a model that no plugin is equal to.

    Returns
    -------
    dict
        Of plain numbers, strings, lists and dictionaries.

    Raises
    ------
    InputError
        Channels that are neither colours nor wavelengths, no plugin equal to the model and no file, or
        lobes whose largest colours add up to more than 1: Mitsuba's colours end there.
    """
    if measured is not None:
        return {"type": "measured", "filename": os.fspath(measured)}
    _check_channels(fit)
    parts = [_part(fit, group) for group in _groups(fit)]
    parts = [part for part in parts if part.peak() > 0.0]
    if not parts:
        return {"type": "diffuse", "reflectance": _spectrum(fit, np.zeros(len(fit.channels)))}
    return _sum(fit, parts)


def mitsuba_xml(fit: Fit, measured: str | os.PathLike[str] | None = None, name: str = "fit") -> str:
    """The model as a <bsdf> element of a Mitsuba 3 scene, with `name` for its id; see `mitsuba_dict`."""
    return _element(mitsuba_dict(fit, measured), f"id={quoteattr(name)}") + "\n"


def renderer_xml(path: str | os.PathLike[str], name: str = "fit") -> str:
    """A <bsdf> element for a scene of our renderer, of a model saved by `Fit.save` at `path`."""
    return _element({"type": "analytic", "filename": os.fspath(path)}, f"id={quoteattr(name)}") + "\n"


class _Part(NamedTuple):
    """One plugin: what is no colour, and the colours, shape (C,), by name."""

    plugin: dict[str, Any]
    colours: dict[str, Array]

    def peak(self) -> float:
        return max(float(colour.max()) for colour in self.colours.values())

    def divided(self, share: float) -> _Part:
        return _Part(self.plugin, {name: colour / share for name, colour in self.colours.items()})

    def filled(self, fit: Fit) -> dict[str, Any]:
        return {**self.plugin, **{name: _spectrum(fit, colour) for name, colour in self.colours.items()}}


def _part(fit: Fit, lobes: list[FittedLobe]) -> _Part:
    """The plugin of a group of lobes."""
    first = lobes[0]
    facets, _, rest = first.name.partition("_")
    if first.name == "lambert":
        return _Part({"type": "diffuse"}, {"reflectance": _colour(fit, first, "albedo")})
    if facets == "walter":
        colours = [_colour(fit, first, f"specular_{what}") for what in ("reflectance", "transmittance")]
        return _glass(rest, first, *colours)
    if facets != "gtr" and rest == "separable_dielectric":
        colour = _colour(fit, first, "specular_reflectance")
        return _glass(facets, first, colour, 0.0 * colour)
    plugin: dict[str, Any] = {
        "type": "roughconductor",
        "distribution": facets,
        "alpha": first.parameters.get("alpha"),
    }
    if facets != "gtr" and rest == "separable_conductor":
        colours = [_colour(fit, lobe, "specular_reflectance") for lobe in lobes]
        owner = np.argmax(colours, axis=0)
        for index in ("eta", "k"):
            plugin[index] = _spectrum(fit, np.array([lobes[o].parameters[index] for o in owner]), 1e9)
        return _Part(plugin, {"specular_reflectance": np.max(colours, axis=0)})
    if facets != "gtr" and rest == "separable":
        f0, f90 = _colour(fit, first, "f0"), _colour(fit, first, "f90")
        if np.allclose(f0, f90, rtol=1e-6, atol=0.0):
            return _Part({**plugin, "material": "none"}, {"specular_reflectance": f0})
    raise InputError(
        f"lobe {first.name}: Mitsuba has no plugin equal to it; write the model's table to an RGL file and give "
        "it as measured, or fit a model made of the lobes that fitting.export names"
    )


def _glass(facets: str, lobe: FittedLobe, reflected: Array, transmitted: Array) -> _Part:
    plugin = {
        "type": "roughdielectric",
        "distribution": facets,
        "alpha": lobe.parameters["alpha"],
        "int_ior": lobe.parameters["eta"],
        "ext_ior": 1.0,
    }
    return _Part(plugin, {"specular_reflectance": reflected, "specular_transmittance": transmitted})


def _groups(fit: Fit) -> list[list[FittedLobe]]:
    """Lobes; those of metals with channels of their own and the same roughness together."""
    groups: list[list[FittedLobe]] = []
    for lobe in fit.lobes:
        for group in groups:
            if (
                lobe.name.endswith("_separable_conductor")
                and lobe.name == group[0].name
                and lobe.parameters["alpha"] == group[0].parameters["alpha"]
                and not any(np.any(_lit(fit, lobe) & _lit(fit, other)) for other in group)
            ):
                group.append(lobe)
                break
        else:
            groups.append([lobe])
    return groups


def _lit(fit: Fit, lobe: FittedLobe) -> NDArray[np.bool_]:
    return _colour(fit, lobe, "specular_reflectance") > 0.0


def _colour(fit: Fit, lobe: FittedLobe, name: str) -> Array:
    return np.array([lobe.coefficients[name][channel] for channel in fit.channels])


def _sum(fit: Fit, parts: list[_Part]) -> dict[str, Any]:
    """Parts added by blending: each is divided by its share, which is in proportion to its largest colour."""
    if len(parts) == 1:
        return parts[0].filled(fit)
    share = parts[0].peak() / sum(part.peak() for part in parts)
    return {
        "type": "blendbsdf",
        "weight": 1.0 - share,
        "first": parts[0].divided(share).filled(fit),
        "second": _sum(fit, [part.divided(1.0 - share) for part in parts[1:]]),
    }


def _check_channels(fit: Fit) -> None:
    if len(fit.channels) > 1 and fit.wavelengths_nm is None and fit.channels != ("R", "G", "B"):
        raise InputError(
            f"channels: {', '.join(fit.channels)} without wavelengths; one channel, R, G, B, or wavelengths_nm "
            "is needed to say what colour they are"
        )


def _spectrum(fit: Fit, values: Array, largest: float = 1.0) -> dict[str, Any]:
    """A colour as Mitsuba takes it: grey, RGB, or values at wavelengths."""
    if np.ptp(values) == 0.0:
        return {"type": "uniform", "value": float(values[0])}
    if values.max() > largest * (1.0 + 1e-9):
        raise InputError(
            f"coefficients: the largest of all lobes add up to {values.max():.4g}, and Mitsuba takes colours up "
            "to 1; write the model's table to an RGL file and give it as measured"
        )
    if fit.wavelengths_nm is None:
        return {"type": "rgb", "value": [float(v) for v in values]}
    pairs = sorted(zip(fit.wavelengths_nm, values, strict=True))
    return {"type": "spectrum", "value": [(float(w), float(v)) for w, v in pairs]}


def _element(content: Mapping[str, Any], attributes: str) -> str:
    """A <bsdf> element."""
    lines = [f"<bsdf type={quoteattr(content['type'])} {attributes}>"]
    for key, value in content.items():
        name = f"name={quoteattr(key)}"
        if key == "type":
            continue
        if isinstance(value, (float, str)):
            kind = "string" if isinstance(value, str) else "float"
            lines.append(f"<{kind} {name} value={quoteattr(str(value))}/>")
        elif value["type"] == "rgb":
            lines.append(f'<rgb {name} value="{", ".join(map(repr, value["value"]))}"/>')
        elif value["type"] == "spectrum":
            pairs = ", ".join(f"{w!r}:{v!r}" for w, v in value["value"])
            lines.append(f'<spectrum {name} value="{pairs}"/>')
        elif value["type"] == "uniform":
            lines.append(f'<spectrum {name} value="{value["value"]!r}"/>')
        else:
            lines += _element(value, name).splitlines()
    return "\n    ".join(lines) + "\n</bsdf>"
