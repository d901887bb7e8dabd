"""Export to Mitsuba: the dictionaries, and in Mitsuba itself (here, or in the Python named by MITSUBA_PYTHON)."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fitting import Fit
from fitting.export import mitsuba_dict, mitsuba_xml, renderer_xml
from fitting.models.dispatch import lobe_eval
from microgeometry.errors import InputError
from renderer.mitsuba_xml import load_scene

from .materials import RGB, gold, material, polar

PYTHON = os.environ.get("MITSUBA_PYTHON") or (sys.executable if importlib.util.find_spec("mitsuba") else None)
SCRIPT = """
import json, sys, mitsuba
mitsuba.set_variant("scalar_rgb")
job = json.load(open(sys.argv[1]))
out = []
for bsdf in (mitsuba.load_dict(job["dict"]), mitsuba.load_string(job["xml"])):
    si = mitsuba.SurfaceInteraction3f()
    for light, camera in job["pairs"]:
        si.wi = camera
        out.append([float(x) / abs(light[2]) for x in bsdf.eval(mitsuba.BSDFContext(), si, mitsuba.Vector3f(light))])
json.dump(out, open(sys.argv[2], "w"))
"""
LAMBERT = ("lambert", {}, {"albedo": (0.2, 0.1, 0.05)})
ONLY = {"R": (0.4, 0.0, 0.0), "G": (0.0, 0.5, 0.0), "B": (0.0, 0.0, 0.6)}
MODELS = {
    "lambert": material("lambert", LAMBERT),
    "metal": material(
        "ggx_separable_conductor+lambert",
        *(
            ("ggx_separable_conductor", {"alpha": 0.3, "eta": eta, "k": k}, {"specular_reflectance": ONLY[c]})
            for c, eta, k in zip(RGB, (0.18, 0.42, 1.37), (3.4, 2.3, 1.77), strict=True)
        ),
        LAMBERT,
    ),
    "plain": material(
        "ggx_separable+beckmann_separable_dielectric+lambert",
        ("ggx_separable", {"alpha": 0.4}, {"f0": (0.3, 0.2, 0.1), "f90": (0.3, 0.2, 0.1)}),
        (
            "beckmann_separable_dielectric",
            {"alpha": 0.25, "eta": 1.6},
            {"specular_reflectance": (0.5, 0.5, 0.5)},
        ),
        LAMBERT,
    ),
    "glass": material(
        "walter_ggx",
        (
            "walter_ggx",
            {"alpha": 0.2, "eta": 1.5},
            {"specular_reflectance": (1.0, 0.5, 0.2), "specular_transmittance": (0.3, 0.6, 0.9)},
        ),
    ),
}
PAIRS = [
    (polar(30.0, 180.0), polar(30.0)),
    (polar(50.0, 200.0), polar(20.0, 10.0)),
    (polar(70.0, 170.0), polar(75.0)),
]
THROUGH = [(polar(165.0, 180.0), polar(20.0)), (polar(30.0, 180.0), polar(150.0))]


@pytest.mark.compiled
@pytest.mark.skipif(PYTHON is None, reason="no mitsuba: install it, or name its Python in MITSUBA_PYTHON")
@pytest.mark.parametrize("name", MODELS)
def test_mitsuba_sees_the_same_model(name: str, tmp_path: Path) -> None:
    fit = MODELS[name]
    pairs = PAIRS + (THROUGH if name == "glass" else [])
    xml = mitsuba_xml(fit).replace("<bsdf ", '<bsdf version="3.0.0" ', 1)
    (tmp_path / "job.json").write_text(json.dumps({"dict": mitsuba_dict(fit), "xml": xml, "pairs": pairs}))
    subprocess.run(
        [PYTHON, "-c", SCRIPT, tmp_path / "job.json", tmp_path / "out.json"], check=True, capture_output=True
    )
    theirs = np.array(json.loads((tmp_path / "out.json").read_text()))
    kinds, shapes, weights = fit.terms()
    ours = [
        sum(w * lobe_eval(k, p, wi, wo) for k, p, w in zip(kinds, shapes, weights, strict=True))
        for wi, wo in pairs
    ]
    # single precision; Beckmann's masking is a rational fit there, 0.35 % off at 75 degrees
    rel = 5e-3 if name == "plain" else 1e-5
    assert theirs == pytest.approx(np.array([*ours, *ours]), rel=rel)


def test_a_metal_of_three_lobes_is_one_plugin() -> None:
    exported = mitsuba_dict(MODELS["metal"])
    # largest colours 0.6 and 0.2: shares 3/4 and 1/4
    assert exported["weight"] == pytest.approx(0.25)
    metal, base = exported["first"], exported["second"]
    assert metal["type"] == "roughconductor"
    assert metal["eta"] == {"type": "rgb", "value": [0.18, 0.42, 1.37]}
    assert metal["specular_reflectance"]["value"] == pytest.approx([0.4 / 0.75, 0.5 / 0.75, 0.6 / 0.75])
    assert base["reflectance"]["value"] == pytest.approx([0.8, 0.4, 0.2])


def test_a_lobe_that_only_reflects_lets_nothing_through() -> None:
    lobes = mitsuba_dict(MODELS["plain"])
    glass = lobes["second"]["first"]
    assert glass["type"] == "roughdielectric"
    assert glass["specular_transmittance"] == {"type": "uniform", "value": 0.0}


def test_what_mitsuba_has_no_plugin_for_goes_as_a_table() -> None:
    with pytest.raises(InputError, match=r"lobe beckmann: Mitsuba has no plugin equal to it; .* measured"):
        mitsuba_dict(gold())
    coloured = material(
        "ggx_separable", ("ggx_separable", {"alpha": 0.2}, {"f0": (0.5, 0.4, 0.3), "f90": (1.0, 1.0, 1.0)})
    )
    with pytest.raises(InputError, match="lobe ggx_separable:"):
        mitsuba_dict(coloured)
    assert mitsuba_dict(gold(), measured="a.bsdf") == {"type": "measured", "filename": "a.bsdf"}
    assert '<string name="filename" value="a.bsdf"/>' in mitsuba_xml(gold(), measured="a.bsdf")


def test_colours_above_1_and_unknown_channels_are_refused() -> None:
    bright = material("lambert", ("lambert", {}, {"albedo": (1.2, 0.5, 0.5)}))
    with pytest.raises(InputError, match=r"add up to 1\.2, and Mitsuba takes colours up to 1"):
        mitsuba_dict(bright)
    two = {
        "model": "lambert",
        "lobes": MODELS["lambert"].lobes,
        "channels": ("a", "b"),
    }
    with pytest.raises(InputError, match="channels: a, b without wavelengths"):
        mitsuba_dict(Fit(**two))


def test_wavelengths_and_nothing() -> None:
    fit = MODELS["lambert"].replace(wavelengths_nm=(630.0, 532.0, 467.0))
    assert mitsuba_dict(fit)["reflectance"] == {
        "type": "spectrum",
        "value": [(467.0, 0.05), (532.0, 0.1), (630.0, 0.2)],
    }
    assert 'value="467.0:0.05, 532.0:0.1, 630.0:0.2"' in mitsuba_xml(fit)
    black = material("lambert", ("lambert", {}, {"albedo": (0.0, 0.0, 0.0)}))
    assert mitsuba_dict(black) == {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.0}}


def test_our_renderer_reads_it(tmp_path: Path) -> None:
    gold().save(tmp_path / "gold.json")
    (tmp_path / "scene.xml").write_text(
        '<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="40"/></sensor>'
        + renderer_xml("gold.json")
        + '<shape type="sphere"><ref id="fit"/></shape></scene>'
    )
    scene = load_scene(tmp_path / "scene.xml")
    assert scene.shapes[0].material.values["fit"].lobes == gold().lobes
