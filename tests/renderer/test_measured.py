"""A table as an RGL tensor file: Mitsuba 3 renders by its `measured` plugin what we render by the table."""

import subprocess

import numpy as np
import pytest

from renderer.image import write_exr
from renderer.mitsuba_xml import load_scene
from renderer.render import render
from tests.renderer.test_against_mitsuba import PYTHON, SCRIPT
from tests.table.tables import ggx, grid, make

SCENE = """<scene version="3.0.0">
  <integrator type="path"><integer name="max_depth" value="2"/></integrator>
  <sensor type="perspective"><float name="fov" value="24"/><transform name="to_world">
      <lookat origin="0, 0, 6" target="0, 0, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="48"/><integer name="height" value="48"/>
      <rfilter type="box"/></film></sensor>
  <emitter type="envmap"><string name="filename" value="env.exr"/></emitter>
  <shape type="sphere">BSDF</shape>
</scene>"""


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.skipif(PYTHON is None, reason="no mitsuba: install it, or name its Python in MITSUBA_PYTHON")
def test_same_picture_of_a_table(tmp_path):
    """Blocks of 8 x 8 pixels of the ball, but for its rim: rows beyond 79 degrees are few in the file."""
    table = make(ggx(0.3, 0.8), grid(90, 90, 60))
    table.save(tmp_path / "table.h5")
    table.save(tmp_path / "table.bsdf")
    env = 0.2 + np.random.default_rng(5).random((16, 32, 3))
    env[4, 8] = 30, 20, 10
    write_exr(tmp_path / "env.exr", {"RGB": env})
    pictures = {}
    for name, bsdf in (("tabulated", "table.h5"), ("measured", "table.bsdf")):
        scene = tmp_path / f"{name}.xml"
        scene.write_text(
            SCENE.replace("BSDF", f'<bsdf type="{name}"><string name="filename" value="{bsdf}"/></bsdf>')
        )
        pictures[name] = scene
    spp = 256
    out = tmp_path / "m.npy"
    subprocess.run(
        [PYTHON, "-c", SCRIPT, pictures["measured"], out, str(spp)], check=True, capture_output=True
    )
    image = render(load_scene(pictures["tabulated"]), spp=spp)
    blocks = [a.reshape(6, 8, 6, 8, 3).mean((1, 3)) for a in (image.pixels, np.load(out)[..., :3])]
    error = np.sqrt(2 * (image.std_error**2).reshape(6, 8, 6, 8, 3).sum((1, 3))) / 64
    ball = (slice(1, 5), slice(1, 5))
    z = (blocks[0] - blocks[1])[ball] / (error + 0.01 * blocks[1])[ball]
    assert np.abs(z).max() < 5
    assert blocks[0][ball].mean() == pytest.approx(blocks[1][ball].mean(), rel=0.01)
