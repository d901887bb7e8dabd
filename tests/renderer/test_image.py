"""Images on disk, tone mapping and comparison."""

import matplotlib.image
import numpy as np
import pytest

from microgeometry.errors import InputError
from renderer.compare import compare, side_by_side
from renderer.image import Image, read_exr, tone_map, write_exr

RNG = np.random.default_rng(11)


def picture(noise=0.1, level=1.0, shape=(20, 30, 3)):
    truth = level * np.linspace(0.5, 2, shape[1])[None, :, None] * np.ones(shape)
    return Image(truth + noise * RNG.standard_normal(shape), np.full(shape, noise), {"spp": 4})


def test_exr_round_trip(tmp_path):
    image = picture()
    image.save(tmp_path / "a.exr")
    back = Image.load(tmp_path / "a.exr")
    np.testing.assert_allclose(back.pixels, image.pixels, rtol=1e-6)
    np.testing.assert_allclose(back.std_error, image.std_error, rtol=1e-6)
    assert back.provenance == {"spp": 4}
    assert [p.name for p in tmp_path.iterdir()] == ["a.exr"]


def test_channels_keep_their_order(tmp_path):
    pixels = np.zeros((2, 3, 3))
    pixels[0, 1] = (1, 2, 3)
    write_exr(tmp_path / "a.exr", {"RGB": pixels})
    assert read_exr(tmp_path / "a.exr")[0, 1].tolist() == [1, 2, 3]
    assert np.all(np.isnan(Image.load(tmp_path / "a.exr").std_error))


def test_png_is_srgb(tmp_path):
    # IEC 61966-2-1: linear 0.5 is 188, 0.001 is 3, above one is white
    assert tone_map(np.array([[[0.5, 0.001, 7.0]]]), 1.0)[0, 0].tolist() == [188, 3, 255]
    image = picture()
    image.save(tmp_path / "a.png")
    pixels = matplotlib.image.imread(tmp_path / "a.png")[..., :3]
    np.testing.assert_allclose(np.rint(255 * pixels), tone_map(image.pixels), atol=0.5)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("none.exr", None, "No such file"),
        ("a.exr", b"hello", "not an OpenEXR"),
        ("b.exr", b"\x76\x2f\x31\x01xx", "damaged"),
    ],
)
def test_bad_files(tmp_path, name, content, words):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=words) as error:
        read_exr(path)
    assert name in str(error.value)
    assert "\n" not in str(error.value)


def test_unknown_suffix(tmp_path):
    with pytest.raises(InputError, match=r"\.exr or \.png"):
        picture().save(tmp_path / "a.jpg")


def test_comparison_tells_noise_from_difference():
    same = compare(picture(), picture())
    # both noisy by 0.1: the difference by 0.1 sqrt 2 of a root mean square of about 1.32
    assert same.relative_rmse == pytest.approx(same.noise_rmse, rel=0.06)
    assert abs(same.bias) < 4 * same.bias_std_error
    brighter = compare(picture(level=1.2), picture())
    assert brighter.bias == pytest.approx(0.2, abs=4 * brighter.bias_std_error)
    assert brighter.excess_rmse == pytest.approx(0.2, abs=0.01)
    exact = compare(picture(0.0, 2.0), picture(0.0))
    assert exact.relative_rmse == pytest.approx(1)
    assert exact.mean_relative == pytest.approx(1)


def test_side_by_side(tmp_path):
    differences = side_by_side({"a": picture(), "b": picture(level=1.1), "c": picture()}, tmp_path / "s.png")
    assert list(differences) == ["b", "c"]
    assert differences["b"].bias > 5 * differences["b"].bias_std_error
    assert matplotlib.image.imread(tmp_path / "s.png").shape[1] > 900


def test_pictures_of_different_size():
    with pytest.raises(InputError, match="30 x 20 and 5 x 4"):
        compare(picture(), picture(shape=(4, 5, 3)))
