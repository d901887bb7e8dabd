"""Rendering: same bits whatever the threads, error bars, the command."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from microgeometry.errors import InputError
from renderer import render as module
from renderer.commands import render_command
from renderer.image import Image, write_exr
from renderer.render import render
from renderer.scene import Camera, Material, Mesh, PointLight, Scene, Sphere, look_at
from tests.renderer.scenes import constant, lambert_table, square

ROOT = Path(__file__).parents[2]
CAMERA = Camera(look_at((3, 2, 4), (0, 0, 0), (0, 0, 1)), 30, width=18, height=10)  # not multiples of 4
SCENE = Scene(
    CAMERA,
    (
        square(3),
        Sphere((0, 0, 0.5), 0.5, material=Material("dielectric", {"eta": 1.5})),
        square(0.5, 3, emission=(3, 3, 2), down=True),
    ),
    constant(0.1, 0.2, 0.3),
    (PointLight((2, 2, 2), (1, 1, 1)),),
)


def test_same_bits_for_any_number_of_threads(monkeypatch):
    monkeypatch.setattr(module, "_BLOCKS_PER_TASK", 2)
    pictures = [render(SCENE, spp=3, seed=5, threads=n) for n in (1, 2, 8)]
    for picture in pictures[1:]:
        assert picture.pixels.tobytes() == pictures[0].pixels.tobytes()
        assert picture.std_error.tobytes() == pictures[0].std_error.tobytes()
    assert not np.array_equal(render(SCENE, spp=3, seed=6).pixels, pictures[0].pixels)


@pytest.mark.compiled
def test_same_bits_in_another_process_and_any_passes(monkeypatch, tmp_path):
    script = (
        "import sys, numpy as np\n"
        "from tests.renderer.test_render import SCENE; from renderer.render import render\n"
        "np.save(sys.argv[1], render(SCENE, spp=9, seed=5, threads=8).pixels)"
    )
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", script, str(tmp_path / "a.npy")], check=True, env=env, cwd=ROOT)
    monkeypatch.setattr(module, "_SECONDS_PER_PASS", 1e-9)  # one sample a pass
    assert np.array_equal(np.load(tmp_path / "a.npy"), render(SCENE, spp=9, seed=5).pixels)


@pytest.mark.compiled
def test_error_bars_are_those_of_repeated_renders():
    pictures = [render(SCENE, spp=64, seed=seed) for seed in range(24)]
    spread = np.var([p.pixels for p in pictures], axis=0, ddof=1).mean()
    stated = np.mean([p.std_error**2 for p in pictures])
    assert spread == pytest.approx(stated, rel=0.25)


def test_smooth_mesh_of_a_sphere_looks_like_a_sphere():
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    mesh = Mesh(ball.vertices, ball.faces, ball.vertices.copy(), Material())
    camera = Camera(look_at((0, -5, 1), (0, 0, 0), (0, 0, 1)), 12, width=6, height=6)
    light = (PointLight((3, -5, 4), (30, 30, 30)),)
    a, b = (render(Scene(camera, (s,), None, light, max_depth=2), spp=4).pixels for s in (Sphere(), mesh))
    assert a.min() > 0
    np.testing.assert_allclose(a, b, rtol=0.02)


def test_stop_and_progress():
    seen = []
    image = render(SCENE, spp=1000, progress=lambda f, w: seen.append(f), stop=lambda: True)
    assert image.provenance["spp"] < 1000
    assert seen == [image.provenance["spp"] / 1000]


@pytest.mark.parametrize(("options", "words"), [({"spp": 0}, "spp is 0"), ({"threads": 0}, "threads: 0")])
def test_bad_options(options, words):
    with pytest.raises(InputError, match=words):
        render(SCENE, **options)


def test_command_renders_the_shipped_scene(tmp_path):
    lambert_table(0.5, tint=(0.9, 0.6, 0.3)).save(tmp_path / "t.h5")
    out = tmp_path / "o.exr"
    arguments = [str(ROOT / "data/scenes/spheres.xml"), "-o", str(out), "--spp", "2", "--seed", "3"]
    arguments += ["-D", f"table={tmp_path / 't.h5'}", "-D", "width=8", "-D", "height=5"]
    result = CliRunner().invoke(render_command, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    assert "2 spp" in result.output
    assert len(result.output.splitlines()) == 1
    assert out.with_suffix(".png").is_file()
    image = Image.load(out)
    assert image.pixels.shape == (5, 8, 3)
    assert image.provenance["seed"] == 3
    assert image.pixels.min() > 0  # plane and spheres fill the frame, all lit
    assert sorted(p.name for p in tmp_path.iterdir()) == ["o.exr", "o.png", "t.h5"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["s.xml", "-o", "o.jpg"], "ends in .exr"),
        (["s.xml", "-o", "nowhere/o.exr"], "folder nowhere does not exist"),
        (["s.xml", "-o", "o.exr", "-D", "a"], "is not NAME=VALUE"),
        (["s.xml", "-o", "o.exr"], "s.xml: cannot be read"),
    ],
)
def test_command_errors(arguments, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=words):
        CliRunner().invoke(render_command, arguments, catch_exceptions=False)
    assert list(tmp_path.iterdir()) == []


def test_shipped_sky_is_the_code_s(tmp_path):
    from renderer.image import read_exr
    from renderer.sky import sky

    np.testing.assert_allclose(read_exr(ROOT / "data/scenes/sky.exr"), sky(), rtol=1e-5)
    write_exr(tmp_path / "a.exr", {"RGB": sky(4)})
    assert (ROOT / "data/scenes/sky.exr").stat().st_size < 200_000
