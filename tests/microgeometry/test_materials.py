import pytest

from microgeometry.errors import InputError
from microgeometry.materials import Conductor, Lambert, Mirror
from microgeometry.specimen import parse_specimen


def build(material, grid=None):
    return parse_specimen({"surface": {"kind": "flat"}, "material": material, "grid": grid or {}})


def test_mirror_is_grey():
    specimen = build({"kind": "mirror"})
    assert specimen.material == Mirror()
    assert specimen.material.kind == "mirror"
    assert (specimen.grid.channels, specimen.grid.wavelengths_nm) == (("grey",), None)


def test_scalar_is_grey_and_broadcasts():
    assert build({"kind": "lambert", "albedo": 0.5}).material == Lambert((0.5,))
    assert build({"kind": "lambert", "albedo": 0.5}, {"channels": "rgb"}).material == Lambert((0.5,) * 3)
    grid = {"wavelengths_nm": [400, 500]}
    conductor = build({"kind": "conductor", "eta": [0.2, 0.3], "k": 3}, grid).material
    assert conductor == Conductor((0.2, 0.3), (3.0, 3.0))


def test_three_values_are_rgb_in_that_order():
    specimen = build({"kind": "lambert", "albedo": [0.1, 0.5, 0.9]})
    assert specimen.material == Lambert((0.1, 0.5, 0.9))
    assert specimen.grid.channels == ("R", "G", "B")


def test_named_conductor_is_rgb():
    specimen = build({"kind": "conductor", "name": "Au"})
    assert specimen.grid.channels == ("R", "G", "B")
    assert specimen.grid.wavelengths_nm == (630.0, 532.0, 467.0)
    # Johnson's table at 616.8 and 659.5 nm: (0.21, 3.272) and (0.14, 3.697); 630 nm is 13.2/42.7 on its way.
    t = (630 - 616.8) / (659.5 - 616.8)
    assert specimen.material.eta[0] == pytest.approx(0.21 + t * (0.14 - 0.21))
    assert specimen.material.k[0] == pytest.approx(3.272 + t * (3.697 - 3.272))
    # Gold is yellow because it loses the blue: n falls and k grows from blue to red.
    assert specimen.material.eta[0] < specimen.material.eta[1] < specimen.material.eta[2]
    assert specimen.material.name == "Au"


def test_wavelengths_name_the_channels():
    specimen = build({"kind": "conductor", "name": "Au"}, {"wavelengths_nm": [616.8, 548.6]})
    assert specimen.grid.channels == ("616.8 nm", "548.6 nm")
    assert specimen.material.eta == pytest.approx((0.21, 0.43))


@pytest.mark.parametrize(
    ("material", "message"),
    [
        ({"kind": "miror"}, "must be one of 'mirror', 'conductor', 'lambert' .did you mean 'mirror'"),
        ({}, "kind: missing"),
        ({"kind": ["mirror"]}, "kind = .*must be one of"),
        ({"kind": "mirror", "albedo": 1}, "albedo = 1: unknown key"),
        ({"kind": "lambert"}, "albedo: missing"),
        ({"kind": "lambert", "albedo": 1.01}, "albedo = 1.01: .*finite number, at least 0 and at most 1"),
        ({"kind": "lambert", "albedo": -0.01}, "at least 0 and at most 1"),
        ({"kind": "lambert", "albedo": [0.5, float("nan"), 0.5]}, "finite"),
        ({"kind": "lambert", "albedo": True}, "finite number"),
        ({"kind": "lambert", "albedo": "white"}, "finite number"),
        ({"kind": "lambert", "albedo": []}, "empty"),
        ({"kind": "lambert", "albedo": [0.1, 0.2]}, "2 values for 1 channel"),
        ({"kind": "lambert", "albdo": 0.5}, "did you mean 'albedo'"),
        ({"kind": "conductor"}, "name: missing"),
        ({"kind": "conductor", "eta": 0.2}, "k: missing"),
        ({"kind": "conductor", "k": 0.2}, "eta: missing"),
        ({"kind": "conductor", "eta": 0, "k": 3}, "eta = 0: .*above 0"),
        ({"kind": "conductor", "eta": 0.2, "k": -3}, "k = -3: .*at least 0"),
        ({"kind": "conductor", "eta": [0.2, 0.2, 0.2], "k": [1, 2]}, "2 values for 3 channel"),
        ({"kind": "conductor", "eta": 0.2, "k": 3, "name": "Au"}, "not both"),
        ({"kind": "conductor", "name": 79}, "must be text"),
        ({"kind": "conductor", "name": "gold"}, "unknown name"),
    ],
)
def test_bad_materials(material, message):
    with pytest.raises(InputError, match=message) as caught:
        build(material)
    assert "\n" not in str(caught.value)


def test_name_needs_wavelengths():
    with pytest.raises(InputError, match="needs wavelengths"):
        build({"kind": "conductor", "name": "Au"}, {"channels": "grey"})
