"""The picture of a specimen: light, camera and captions."""

import math

import numpy as np
import pytest

from microgeometry.specimen import parse_specimen
from renderer import specimen_picture
from renderer.specimen_picture import surface_picture
from renderer.specimen_section import describe_below, describe_material, length, specimen_html


def specimen(surface, material=None, **more):
    material = material or {"kind": "mirror"}
    return parse_specimen({"surface": surface, "material": material, **more})


def tile(**surface):
    return specimen(surface).surface.realise(0)


def test_flat_clay_has_the_radiance_of_its_light(small_pictures):
    picture = surface_picture(tile(kind="flat"))
    # whole in sun and sky, with nothing before it: no noise, and no bounce can add to it
    expected = np.array(specimen_picture._CLAY) * (specimen_picture._SUN + specimen_picture._SKY)
    assert picture.image.pixels[31, 48] == pytest.approx(expected, rel=1e-5)
    assert picture.image.pixels[0, 0] == pytest.approx(
        specimen_picture._SUN + specimen_picture._SKY, rel=0.05
    )


def test_edges_are_where_the_cut_meets_the_ground(small_pictures):
    picture = surface_picture(tile(kind="flat"))
    for first, last in picture.edges:
        x, y = (0.5 * (first + last)).astype(int)
        (red, _, blue), ground = picture.image.pixels[[y - 2, y + 2], x]
        assert red > 1.3 * blue  # the cut is brown, the ground white or in blue shadow
        assert ground[0] < 1.2 * ground[2]
    assert np.all((picture.edges > 0) & (picture.edges < [96, 72]))


def test_facets_towards_the_sun_are_bright(small_pictures):
    """The sun stands at the left, -x."""
    pixels = surface_picture(tile(kind="v_groove", slope_deg=20)).image.pixels
    middle = pixels[36, 20:76].mean(axis=1)
    flat = (np.array(specimen_picture._CLAY) * (specimen_picture._SUN + specimen_picture._SKY)).mean()
    assert middle.max() > 1.1 * flat
    assert middle.min() < 0.75 * flat


def test_the_sun_is_as_low_as_the_relief_is_shallow(small_pictures):
    steep, shallow = (surface_picture(tile(kind="v_groove", slope_deg=s)) for s in (30, 2))
    assert steep.sun_deg == 40
    assert shallow.sun_deg == pytest.approx(math.degrees(math.atan(2 * math.tan(math.radians(2)))))


def test_caption_says_what_is_seen(small_pictures, tmp_path):
    page = specimen_html(specimen({"kind": "v_groove", "slope_deg": 45}).text, tmp_path)
    assert page.count("<figure>") == page.count("data:image/png;base64,") == 1
    # rms of a saw from 0 to 0.5 um: 0.5 / sqrt(12)
    for words in ("v groove, mirror", "6 x 6 periods of 1 µm x 1 µm", "Alpha measured 1, rms height 144 nm"):
        assert words in page
    assert "Layer" not in page
    assert "below it" not in page


def test_layers_have_a_picture_each(small_pictures, tmp_path):
    layers = [
        {
            "surface": {"kind": "v_groove", "slope_deg": 5},
            "material": {"kind": "dielectric", "eta": 1.5},
            "medium": {"sigma_a": 0.02, "sigma_s": 2, "phase": "hg", "g": 0.5, "thickness": 10},
        },
        {
            "surface": {
                "kind": "bosses", "cover": 0.5, "segments": 12, "plane": {"kind": "lambert", "albedo": 0.2},
            },
            "material": {"kind": "conductor", "eta": 0.2, "k": 3.5},
        },
    ]  # fmt: skip
    page = specimen_html(parse_specimen({"layer": layers}).text, tmp_path)
    first, second = page.split("</figure>")[:2]
    for words in (
        "Layer 1 of 2: v groove, dielectric n 1.5",
        "below it 10 µm of a medium absorbing 20 per mm and scattering 2 per µm by Henyey and Greenstein, g 0.5",
        "The sun stands 9.9° high",
    ):
        assert words in first
    for words in (
        "Layer 2 of 2: bosses, conductor n 0.2, k 3.5",
        "Blue is the flat part: Lambertian of albedo 0.2.",
    ):
        assert words in second
    assert "below it" not in second


def test_a_missing_file_is_one_line(tmp_path):
    np.save(tmp_path / "map.npy", np.zeros((3, 3)))
    text = '[surface]\nkind = "heightmap"\nfile = "map.npy"\nunits = "um"\nsize = [1, 1]\n[material]\nkind = "mirror"\n'
    (tmp_path / "map.npy").unlink()
    page = specimen_html(text, tmp_path)
    assert page.startswith(
        "<p>No picture of the surface: [surface] file = &#x27;map.npy&#x27;: there is no file"
    )
    assert "\n" not in page
    assert specimen_html("surface = [", tmp_path).startswith("<p>No picture of the surface: ")


def test_a_measured_map_is_shown_whole_and_alone(small_pictures, tmp_path):
    np.save(tmp_path / "map.npy", np.random.default_rng(1).normal(size=(9, 5)))
    surface = {"kind": "heightmap", "file": "map.npy", "units": "um", "size": [9, 5]}
    page = specimen_html(
        parse_specimen({"surface": surface, "material": {"kind": "mirror"}}, tmp_path).text, tmp_path
    )
    # nine samples and their mirror images make a period of 16
    assert "The whole file, 8 µm x 4 µm; with its mirror images it makes a period of 16 µm x 8 µm" in page


def test_materials_and_media_in_words():
    films = [{"eta": 2.0, "thickness_nm": 80}, {"eta": 1.4, "k": 0.1, "thickness_nm": 1500}]
    coated = specimen(
        {"kind": "flat"},
        {"kind": "coated", "films": films, "over": {"kind": "dielectric", "name": "BK7"}},
        grid={"wavelengths_nm": [500, 600]},
        medium={"sigma_s": [3e-4, 1e-3], "phase": "rayleigh", "thickness": math.inf},
    ).layers[0]  # fmt: skip
    assert describe_material(coated.material) == "80 nm of n 2, 1.5 µm of n 1.4, k 0.1 on dielectric BK7"
    assert describe_below(coated) == "a half-space of a medium scattering 0.3 to 1 per mm by Rayleigh"
    for material, words in (
        ({"kind": "black"}, "black"),
        ({"kind": "none"}, "no interface"),
        ({"kind": "lambert", "albedo": [0.2, 0.5, 0.1]}, "Lambertian of albedo 0.1 to 0.5"),
    ):
        assert describe_material(specimen({"kind": "flat"}, material).material) == words
    assert describe_below(specimen({"kind": "flat"}, {"kind": "none"}).layers[0]) == "a clear half-space"


def test_lengths():
    assert [length(x) for x in (0, 2.464e-6, 1.5e-3, 9.999e-7, 3e-11, 2.0)] == [
        "0", "2.46 µm", "1.5 mm", "1 µm", "0.03 nm", "2 m",
    ]  # fmt: skip
