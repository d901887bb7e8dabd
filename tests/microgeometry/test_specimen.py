from pathlib import Path

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st

from microgeometry.errors import InputError
from microgeometry.specimen import load_specimen, parse_specimen
from microgeometry.surfaces import SURFACES

DATA = Path(__file__).resolve().parents[2] / "data" / "specimens"

RANDOM = {"gaussian", "exponential", "self_affine", "ndf", "pits", "bosses", "fibres", "spheres"}

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


def test_text_of_a_mapping_loads_as_the_same_specimen(tmp_path):
    parsed = parse_specimen(
        {
            "surface": {"kind": "gaussian", "alpha": np.float64(0.25), "samples": np.int64(256)},
            "material": {"kind": "conductor", "eta": np.array([0.1, 0.2, 1e-7]), "k": (1, 2.5, 3)},
            "grid": {"theta_i_deg": [0, 30.5]},
        }
    )
    loaded = load_specimen(write(tmp_path, parsed.text))
    assert (parsed.surface, parsed.material, parsed.grid) == (loaded.surface, loaded.material, loaded.grid)


def test_files_are_relative_to_the_specimen(tmp_path):
    np.save(tmp_path / "map.npy", np.zeros((3, 3)))
    keys = '"heightmap"\nfile = "map.npy"\nunits = "um"\nsize = [1, 1]'
    text = GOOD.replace('"v_groove"\nslope_deg = 30', keys)
    assert load_specimen(write(tmp_path, text)).surface.file == tmp_path / "map.npy"


@pytest.mark.parametrize("path", sorted(DATA.glob("*.toml")), ids=lambda path: path.stem)
def test_specimens_that_come_with_the_project(path):
    specimen = load_specimen(path)
    assert specimen.surface.realise(0).statistics().alpha > 0


def test_gold_is_what_it_says():
    gold = load_specimen(DATA / "gold.toml")
    assert (gold.surface.kind, gold.surface.alpha, gold.material.name) == ("gaussian", 0.5, "Au")
    assert gold.grid.channels == ("R", "G", "B")


def test_grid_defaults_and_steps():
    tables = {"surface": {"kind": "flat"}, "material": {"kind": "mirror"}}
    default = parse_specimen(tables).grid
    assert (default.theta_i_deg, default.theta_step_deg, default.phi_step_deg) == (None, 1.0, 1.0)
    grid = {"theta_i_deg": [0, 30, 89.9], "theta_step_deg": 0.7031250, "phi_step_deg": 22.5}
    given = parse_specimen({**tables, "grid": grid}).grid
    assert given.theta_i_deg == (0.0, 30.0, 89.9)
    assert (given.theta_step_deg, given.phi_step_deg) == (90 / 128, 22.5)
    assert parse_specimen({**tables, "grid": {"theta_i_deg": 45}}).grid.theta_i_deg == (45.0,)


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        ({"theta_step": 1}, "did you mean 'theta_step_deg'"),
        ({"theta_step_deg": 0.7}, "must divide 90 degrees evenly"),
        ({"phi_step_deg": 50}, "must divide 180 degrees evenly"),
        ({"theta_step_deg": 0}, "at least 0.01"),
        ({"theta_step_deg": 180}, "at most 90"),
        ({"theta_i_deg": [0, 90]}, "below 90"),
        ({"theta_i_deg": [-1]}, "at least 0"),
        ({"theta_i_deg": [30, 0]}, "must increase"),
        ({"theta_i_deg": [30, 30]}, "must increase"),
        ({"theta_i_deg": []}, "empty"),
        ({"theta_i_deg": "all"}, "finite number"),
        ({"wavelengths_nm": [0]}, "above 0"),
        ({"wavelengths_nm": [500, 500]}, "twice"),
        ({"wavelengths_nm": [500], "channels": "rgb"}, "not both"),
        ({"channels": "RGB"}, "must be one of 'rgb', 'grey' .did you mean 'rgb'"),
        ({"channels": 3}, "must be one of"),
    ],
)
def test_bad_grid(grid, message):
    with pytest.raises(InputError, match=message) as caught:
        parse_specimen({"surface": {"kind": "flat"}, "material": {"kind": "mirror"}, "grid": grid})
    assert str(caught.value).startswith("[grid] ")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"\[surface\] is missing"),
        ("[surface]\nkind = 'flat'", r"\[material\] is missing"),
        (GOOD.replace("= 30", "= "), "not valid TOML.*line 4"),
        (GOOD + "[layer]\n", "layer = {}: unknown key.*allowed here: surface, material, grid"),
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
    "surface": ["alpha", "rms_height", "correlation_length", "samples", "size", "units", "slope_deg", "file"],
    "material": ["albedo", "eta", "k", "name"],
    "grid": ["wavelengths_nm", "channels", "theta_i_deg", "theta_step_deg", "phi_step_deg"],
}


@hypothesis.settings(max_examples=300, deadline=None, derandomize=True)
@hypothesis.given(st.data())
def test_anything_else_is_an_input_error_of_one_line(data):
    mapping = {
        "surface": {"kind": data.draw(st.sampled_from(sorted(SURFACES)))},
        "material": {"kind": data.draw(st.sampled_from(["mirror", "conductor", "lambert"]))},
        "grid": {},
    }
    for table, keys in KEYS.items():
        mapping[table].update(data.draw(st.dictionaries(st.sampled_from([*keys, "kind"]), JUNK, max_size=2)))
    message = ""
    try:
        parse_specimen(mapping)
    except InputError as error:
        message = str(error)
    assert "\n" not in message
    assert len(message) < 400
