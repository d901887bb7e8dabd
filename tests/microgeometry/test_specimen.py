import sys
from math import inf
from pathlib import Path

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st

from microgeometry.errors import InputError
from microgeometry.materials import MATERIALS, Black, Dielectric, Lambert, NoInterface
from microgeometry.media import HenyeyGreenstein, Medium
from microgeometry.specimen import load_specimen, parse_specimen
from microgeometry.surfaces import SURFACES

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

DATA = Path(__file__).resolve().parents[2] / "data" / "specimens"

RANDOM = {"gaussian", "exponential", "self_affine", "ndf", "pits", "bosses", "fibres", "spheres"}

ODD_NAME = 'a "b" \\ \x7f\N{GREEK SMALL LETTER MU}\N{MATHEMATICAL ITALIC SMALL ETA}.csv'

GOOD = """
[surface]
kind = "v_groove"
slope_deg = 30
[material]
kind = "lambert"
albedo = 0.5
"""


def write(folder, text):
    path = folder / "groove.toml"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def test_file_and_mapping_say_the_same(tmp_path):
    loaded = load_specimen(write(tmp_path, GOOD))
    assert (loaded.text, loaded.name) == (GOOD, "groove")
    parsed = parse_specimen(
        {"surface": {"kind": "v_groove", "slope_deg": 30}, "material": {"kind": "lambert", "albedo": 0.5}}
    )
    assert (parsed.surface, parsed.material, parsed.grid) == (loaded.surface, loaded.material, loaded.grid)


@pytest.mark.parametrize(
    "mapping",
    [
        {
            "surface": {"kind": "gaussian", "alpha": np.float64(0.25), "samples": np.int64(256)},
            "material": {"kind": "conductor", "eta": np.array([0.1, 0.2, 1e-7]), "k": (1, 2.5, 3)},
            "grid": {"theta_i_deg": [0, 30.5]},
        },
        {
            "surface": {"kind": "flat"},
            "material": {"kind": "none"},
            "medium": {
                "sigma_s": 1e22,
                "phase": "table",
                "file": ODD_NAME,
                "thickness": inf,
            },
        },
        {
            "layer": (
                {
                    "surface": {"kind": "bosses", "cover": 0.2, "plane": {"kind": "dielectric", "eta": 1.5}},
                    "material": {
                        "kind": "coated",
                        "films": [
                            {"name": "TiO2", "thickness_nm": 50},
                            {"eta": 1.4, "thickness_nm": np.float64(9)},
                        ],
                        "over": {"kind": "dielectric", "eta": 1.5},
                    },
                    "medium": {"thickness": 3, "units": "mm"},
                },
                {
                    "surface": {"kind": "flat"},
                    "material": {"kind": "none"},
                    "medium": {"sigma_a": 1, "thickness": inf},
                },
            ),
            "grid": {"channels": "rgb", "illuminant": "A", "orders": 3},
        },
    ],
    ids=["table", "medium", "layers"],
)
def test_text_of_a_mapping_loads_as_the_same_specimen(tmp_path, mapping):
    (tmp_path / ODD_NAME).write_text("theta_deg,value\n0,2\n180,1\n")
    parsed = parse_specimen(mapping, tmp_path)
    loaded = load_specimen(write(tmp_path, parsed.text))
    assert (parsed.layers, parsed.grid) == (loaded.layers, loaded.grid)
    # And again: the text is the mapping.
    assert parse_specimen(tomllib.loads(parsed.text), tmp_path) == parsed


def test_files_are_relative_to_the_specimen(tmp_path):
    np.save(tmp_path / "map.npy", np.zeros((3, 3)))
    keys = '"heightmap"\nfile = "map.npy"\nunits = "um"\nsize = [1, 1]'
    text = GOOD.replace('"v_groove"\nslope_deg = 30', keys)
    assert load_specimen(write(tmp_path, text)).surface.file == tmp_path / "map.npy"


@pytest.mark.parametrize("path", sorted(DATA.glob("*.toml")), ids=lambda path: path.stem)
def test_specimens_that_come_with_the_project(path):
    for layer in load_specimen(path).layers:
        stats = layer.surface.realise(0).statistics()
        assert (stats.alpha > 0) is (layer.surface.kind != "flat")


def test_gold_is_what_it_says():
    gold = load_specimen(DATA / "gold.toml")
    assert (gold.surface.kind, gold.surface.alpha, gold.material.name) == ("gaussian", 0.5, "Au")
    assert gold.grid.channels == ("R", "G", "B")


FLAT = {"kind": "flat"}
GLASS = {"kind": "dielectric", "eta": 1.5}
MIRROR = {"kind": "mirror"}
SPACE = {"thickness": 10}
SCATTERING = {"sigma_s": 1, "thickness": inf}
BASE = {"surface": FLAT, "material": MIRROR}
TOP = {"surface": FLAT, "material": GLASS, "medium": SPACE}


def test_layers_from_top_to_bottom(tmp_path):
    text = """
    [[layer]]
    surface = {kind = "gaussian", alpha = 0.3}
    material = {kind = "dielectric", eta = 1.5}
    medium = {sigma_a = 0.1, sigma_s = 2.0, phase = "hg", g = 0.5, thickness = 10.0}
    [[layer]]
    surface = {kind = "flat"}
    material = {kind = "none"}
    medium = {thickness = 1, units = "mm"}
    [[layer]]
    surface = {kind = "pits", cover = 0.5, plane = {kind = "black"}}
    material = {kind = "lambert", albedo = 0.5}
    """
    specimen = load_specimen(write(tmp_path, text))
    top, middle, base = specimen.layers
    assert (top.surface.kind, top.surface.alpha, top.material) == ("gaussian", 0.3, Dielectric((1.5,)))
    near = pytest.approx
    assert top.medium == Medium((near(1e5),), (near(2e6),), HenyeyGreenstein(0.5), near(1e-5))
    assert (middle.surface.kind, middle.material, middle.medium.thickness) == ("flat", NoInterface(), 1e-3)
    assert (base.surface.kind, base.material, base.plane) == ("pits", Lambert((0.5,)), Black())
    assert (base.medium, top.plane, middle.plane) == (None, None, None)
    assert (specimen.surface, specimen.material) == (top.surface, top.material)
    assert specimen.is_random


def test_surface_and_material_are_one_layer():
    one = parse_specimen({"surface": FLAT, "material": GLASS, "medium": SCATTERING})
    same = parse_specimen({"layer": [{"surface": FLAT, "material": GLASS, "medium": SCATTERING}]})
    assert one.layers == same.layers
    assert one.layers[0].medium is not None
    assert not one.is_random
    assert parse_specimen({"surface": FLAT, "material": GLASS}).layers[0].medium is None


def test_random_if_any_layer_is():
    rough = {"surface": {"kind": "gaussian", "alpha": 0.1}, "material": MIRROR}
    assert parse_specimen({"layer": [TOP, rough]}).is_random
    assert not parse_specimen({"layer": [TOP, BASE]}).is_random


@pytest.mark.parametrize("kind", ["pits", "bosses"])
def test_plane_of_another_material(kind):
    surface = {"kind": kind, "cover": 0.4, "plane": {"kind": "conductor", "name": "Ag"}}
    layer = parse_specimen({"surface": surface, "material": {"kind": "conductor", "name": "Au"}}).layers[0]
    assert (layer.material.name, layer.plane.name) == ("Au", "Ag")
    assert layer.surface.cover == 0.4
    assert (
        parse_specimen({"surface": {"kind": kind, "cover": 0.4}, "material": MIRROR}).layers[0].plane is None
    )


def layers(*tables):
    return {"layer": list(tables)}


def pits(plane, material):
    return {"surface": {"kind": "pits", "cover": 0.5, "plane": plane}, "material": material}


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        ({**layers(BASE), "surface": FLAT}, r"\[surface\] and \[\[layer\]\]: give one or the other"),
        ({**layers(BASE), "material": MIRROR}, r"\[material\] and \[\[layer\]\]: give one or the other"),
        ({**layers(BASE), "medium": SPACE}, r"\[medium\] and \[\[layer\]\]: give one or the other"),
        ({"surface": FLAT, "material": MIRROR, "layers": []}, "layers = .*did you mean 'layer'"),
        (layers(), "layer = .*at least one table"),
        ({"layer": BASE}, "layer = .*list of at least one table"),
        (layers(TOP, 3), "layer 2 = '3': must be a table"),
        (layers(TOP, {**BASE, "mdium": SPACE}), r"\[layer 2\] mdium = .*did you mean 'medium'"),
        (layers({"material": MIRROR}), r"\[layer 1\] surface: missing"),
        (layers({"surface": FLAT}), r"\[layer 1\] material: missing"),
        (layers(TOP, {**BASE, "surface": {"kind": "flt"}}), r"\[layer 2 surface\] kind = 'flt': .*'flat'"),
        (layers(TOP, {**BASE, "material": {"kind": "mirro"}}), r"\[layer 2 material\] kind = .*'mirror'"),
        (layers(BASE, BASE), r"\[layer 1\] material = .*opaque, it hides the layers below"),
        (layers({**BASE, "medium": SPACE}, BASE), r"\[layer 1\] medium = .*mirror is opaque"),
        (layers(TOP, {**BASE, "medium": SPACE}), r"\[layer 2\] medium = .*mirror is opaque"),
        (
            {"surface": FLAT, "material": MIRROR, "medium": SCATTERING},
            r"^medium = .*mirror is opaque.*leave it out",
        ),
        (layers({"surface": FLAT, "material": GLASS}, BASE), r"\[layer 1\] medium: missing; add .*thickness"),
        (
            layers({**TOP, "medium": SCATTERING}, BASE),
            r"\[layer 1\] medium = .*thickness = inf leaves no room",
        ),
        (layers(TOP), r"\[layer 1\] medium = .*last layer, so its thickness must be inf; or add .*eta = 1"),
        (layers(TOP, TOP), r"\[layer 2\] medium = .*last layer"),
        ({"surface": FLAT, "material": GLASS, "medium": SPACE}, "^medium = .*last layer"),
        ({"surface": FLAT, "material": GLASS, "medium": {"thickness": inf}}, "neither absorbs nor scatters"),
        (layers({**TOP, "medium": {"sigma_s": [0, 1, 1], "thickness": inf}}), "neither absorbs nor scatters"),
        (layers({**TOP, "medium": 3}, BASE), "layer 1 medium = '3': must be a table"),
        (
            {"surface": {**FLAT, "plane": MIRROR}, "material": MIRROR},
            r"\[surface\] plane = .*only pits and bosses",
        ),
        (pits(3, MIRROR), "surface plane = '3': must be a table"),
        (pits({"kind": "lambert"}, MIRROR), r"\[surface plane\] albedo: missing"),
        (pits(GLASS, MIRROR), r"\[surface\] plane = .*must be opaque if the material is"),
        (pits(MIRROR, GLASS), r"\[surface\] plane = .*must be opaque if the material is"),
        (pits({"kind": "none"}, GLASS), r"\[surface\] plane = .*the same index below"),
        (
            layers(TOP, {**TOP, **pits({"kind": "dielectric", "eta": 1.4}, {"kind": "none"})}),
            "same index below",
        ),
    ],
)
def test_bad_stacks(mapping, message):
    with pytest.raises(InputError, match=message) as caught:
        parse_specimen(mapping)
    assert "\n" not in str(caught.value)


def test_a_stack_may_end_in_anything():
    for last in (
        BASE,
        {"surface": FLAT, "material": GLASS},
        {"surface": FLAT, "material": {"kind": "none"}},
        {"surface": FLAT, "material": {"kind": "dielectric", "eta": 1}, "medium": SCATTERING},
        # A coat on part of the same glass.
        pits({"kind": "none"}, GLASS),
    ):
        assert len(parse_specimen(layers(TOP, last)).layers) == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"\[surface\] is missing"),
        ("[surface]\nkind = 'flat'", r"\[material\] is missing"),
        (GOOD.replace("= 30", "= "), "not valid TOML.*line 4"),
        (GOOD + "[layr]\n", "layr = {}: unknown key.*allowed here: surface, material, medium, layer, grid"),
        (GOOD + "[layer]\n", r"\[surface\] and \[\[layer\]\]: give one or the other"),
        (GOOD.replace("v_groove", "v-groove"), "did you mean 'v_groove'"),
        (GOOD.replace("v_groove", "moon"), "one of 'flat', 'gaussian', .*'v_groove', .*'mesh'"),
        (GOOD.replace("slope_deg", "slope"), "slope = 30: unknown key .did you mean 'slope_deg'"),
        (GOOD.replace("[material]", "[material.x]"), r"\[material\] kind: missing"),
        ("surface = 3\n[material]\nkind = 'mirror'", "must be a table"),
        (GOOD.replace("slope_deg", '"a\\nb"'), "unknown key"),
        (b"\xff\xfe\x00", "UTF-8"),
    ],
)
def test_bad_files(tmp_path, text, message):
    path = write(tmp_path, text)
    with pytest.raises(InputError, match=message) as caught:
        load_specimen(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        load_specimen(tmp_path / "none.toml")
    with pytest.raises(InputError, match="cannot be read"):
        load_specimen(tmp_path)


def test_registry_keeps_the_contract():
    for kind, surface in SURFACES.items():
        assert surface.kind == kind
        # Where it depends on the keys, it is a property.
        assert isinstance(surface.is_random, property) or surface.is_random is (kind in RANDOM)


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.dates(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=2),
    max_leaves=4,
)
KEYS = {
    "surface": [
        "alpha",
        "rms_height",
        "correlation_length",
        "samples",
        "size",
        "units",
        "slope_deg",
        "file",
        "cover",
        "plane",
    ],
    "material": ["albedo", "eta", "k", "name", "file", "films", "over"],
    "medium": ["sigma_a", "sigma_s", "phase", "g", "file", "thickness", "units"],
    "grid": [
        "wavelengths_nm",
        "channels",
        "wavelength_step_nm",
        "illuminant",
        "theta_i_deg",
        "theta_step_deg",
        "orders",
    ],
}
VALUES = JUNK | st.sampled_from(["Au", "BK7", "hg", "table", "rgb", inf, 1, 0.5, [1, 2, 3]])
NESTED = VALUES | st.fixed_dictionaries(
    {"kind": st.sampled_from(sorted(MATERIALS))}, optional={"eta": VALUES}
)


@hypothesis.settings(max_examples=300, deadline=None, derandomize=True)
@hypothesis.given(st.data())
def test_anything_else_is_an_input_error_of_one_line(data):
    mapping = {
        "surface": {"kind": data.draw(st.sampled_from(sorted(SURFACES)))},
        "material": {"kind": data.draw(st.sampled_from(sorted(MATERIALS)))},
        "medium": {"thickness": inf},
        "grid": {},
    }
    for table, keys in KEYS.items():
        drawn = st.dictionaries(st.sampled_from([*keys, "kind"]), NESTED, max_size=2)
        mapping[table].update(data.draw(drawn))
    if data.draw(st.booleans()):
        del mapping["medium"]
    if data.draw(st.booleans()):
        grid = mapping.pop("grid")
        mapping = {
            "layer": data.draw(st.sampled_from([[mapping], [mapping, mapping], mapping, [1]])),
            "grid": grid,
        }
    message = ""
    try:
        parse_specimen(mapping)
    except InputError as error:
        message = str(error)
    assert "\n" not in message
    assert len(message) < 400
