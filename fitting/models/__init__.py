"""Analytic BRDF models, one module a family of lobes, on one contract (`fitting.models.contract`)."""

from __future__ import annotations

import difflib

from fitting.models import ashikhmin_shirley, cook_torrance, lambert, oren_nayar
from fitting.models.contract import SHAPE, SIZE, Lobe, Model, Parameter, Term
from microgeometry.errors import InputError

__all__ = [
    "LOBES",
    "MODELS",
    "SHAPE",
    "SIZE",
    "Lobe",
    "Model",
    "Parameter",
    "Term",
    "find_lobe",
    "find_model",
]

LOBES: dict[str, Lobe] = {
    lobe.name: lobe
    for lobe in (
        lambert.LOBE,
        oren_nayar.LOBE,
        cook_torrance.BECKMANN,
        cook_torrance.GGX,
        cook_torrance.V_CAVITY,
        ashikhmin_shirley.SPECULAR,
        ashikhmin_shirley.DIFFUSE,
    )
}
"""Every lobe, by name."""

MODELS: dict[str, Model] = {
    model.name: model
    for model in (
        Model("lambert", (lambert.LOBE,), "ideally diffuse"),
        Model("oren_nayar", (oren_nayar.LOBE,), "rough diffuse, full model of 1994"),
        Model(
            "cook_torrance_beckmann",
            (cook_torrance.BECKMANN, lambert.LOBE),
            "Beckmann facets, height-correlated Smith, + Lambert",
        ),
        Model(
            "cook_torrance_ggx",
            (cook_torrance.GGX, lambert.LOBE),
            "GGX facets, height-correlated Smith, + Lambert",
        ),
        Model(
            "cook_torrance_1982",
            (cook_torrance.V_CAVITY, lambert.LOBE),
            "Beckmann facets, V-cavity G, + Lambert",
        ),
        Model(
            "ashikhmin_shirley",
            (ashikhmin_shirley.SPECULAR, ashikhmin_shirley.DIFFUSE),
            "normalised Phong lobe of the half vector + its own diffuse term",
        ),
    )
}
"""Models by the name the command line calls them."""


def find_model(name: str) -> Model:
    """The model called `name`; InputError with the closest names where there is none."""
    if name not in MODELS:
        raise InputError(_unknown("model", name, list(MODELS)))
    return MODELS[name]


def find_lobe(name: str, where: str = "lobe") -> Lobe:
    """The lobe called `name`; InputError with the closest names where there is none."""
    if name not in LOBES:
        raise InputError(_unknown(where, name, list(LOBES)))
    return LOBES[name]


def _unknown(where: str, name: str, known: list[str]) -> str:
    close = difflib.get_close_matches(str(name), known, n=3, cutoff=0.4)
    hint = f"; did you mean {' or '.join(close)}?" if close else ""
    return f"{where}: unknown name {name!r}{hint} (known: {', '.join(known)})"
