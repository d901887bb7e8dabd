"""The same scene file in Mitsuba 3, where it is installed: here, or in the Python named by MITSUBA_PYTHON.

One light at a time: with several, Mitsuba 3.9.1's picture of a rough conductor is not the sum of its
pictures with each of them (1.5 % darker in places), ours is.
"""

import importlib.util
import os
import subprocess
import sys

import numpy as np
import pytest

from renderer.image import write_exr
from renderer.mitsuba_xml import load_scene
from renderer.render import render

PYTHON = os.environ.get("MITSUBA_PYTHON") or (sys.executable if importlib.util.find_spec("mitsuba") else None)
SCRIPT = """
import sys, numpy, mitsuba
mitsuba.set_variant("scalar_rgb")
picture = mitsuba.render(mitsuba.load_file(sys.argv[1]), spp=int(sys.argv[3]), seed=1)
numpy.save(sys.argv[2], numpy.array(picture))
"""
LIGHTS = {
    "envmap": """<emitter type="envmap"><string name="filename" value="env.exr"/>
      <float name="scale" value="0.8"/>
      <transform name="to_world"><rotate y="1" angle="50"/></transform></emitter>""",
    "point": """<emitter type="point"><point name="position" x="-3" y="4" z="2"/>
      <rgb name="intensity" value="6,4,3"/></emitter>""",
    "directional": """<emitter type="directional"><vector name="direction" x="1" y="-1" z="-0.6"/>
      <rgb name="irradiance" value="0.2,0.3,0.6"/></emitter>""",
    "area": """<shape type="rectangle"><transform name="to_world">
      <scale x="0.8" y="0.5"/>
      <lookat origin="2.5, 3, 2" target="0,0,0"/></transform>
      <emitter type="area"><rgb name="radiance" value="5,5,4"/></emitter></shape>""",
}
SCENE = """<scene version="3.0.0">
  <integrator type="path"><integer name="max_depth" value="6"/></integrator>
  <sensor type="perspective"><float name="fov" value="40"/><transform name="to_world">
      <lookat origin="1, 2.6, 7" target="0, 0.9, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="48"/><integer name="height" value="32"/>
      <rfilter type="box"/></film></sensor>
  LIGHT
  <shape type="rectangle">
    <transform name="to_world"><rotate x="1" angle="-90"/><scale value="10"/></transform>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.4,0.5,0.3"/></bsdf></shape>
  <shape type="sphere"><point name="center" x="0" y="1" z="0"/><bsdf type="roughconductor">
    <rgb name="eta" value="0.18,0.42,1.37"/><rgb name="k" value="3.4,2.3,1.77"/>
    <float name="alpha" value="0.3"/><string name="distribution" value="ggx"/></bsdf></shape>
  <shape type="sphere"><point name="center" x="-1.7" y="0.5" z="1"/><float name="radius" value="0.5"/>
    <bsdf type="plastic"><rgb name="diffuse_reflectance" value="0.7,0.2,0.1"/></bsdf></shape>
  <shape type="sphere"><point name="center" x="1.6" y="0.5" z="1.4"/><float name="radius" value="0.5"/>
    <bsdf type="dielectric"/></shape>
  <shape type="cube"><transform name="to_world"><scale value="0.4"/><rotate y="1" angle="30"/>
      <translate x="-2.2" y="0.4" z="-1"/></transform>
    <bsdf type="roughconductor"><float name="alpha" value="0.5"/></bsdf></shape>
  <shape type="disk"><transform name="to_world"><rotate x="1" angle="-60"/><scale value="0.6"/>
      <translate x="2.2" y="0.7" z="-0.5"/></transform>
    <bsdf type="twosided"><bsdf type="conductor"/></bsdf></shape>
</scene>"""


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.skipif(PYTHON is None, reason="no mitsuba: install it, or name its Python in MITSUBA_PYTHON")
@pytest.mark.parametrize("light", LIGHTS)
def test_same_picture(light, tmp_path):
    rng = np.random.default_rng(3)
    env = 0.1 + rng.random((17, 36, 3))
    env[3:5, 8:10], env[5, 25] = (20, 10, 5), (5, 15, 30)
    env[0], env[-1] = env[0].mean(0), env[-1].mean(0)
    write_exr(tmp_path / "env.exr", {"RGB": env})
    scene = tmp_path / "scene.xml"
    scene.write_text(SCENE.replace("LIGHT", LIGHTS[light]))
    spp = 500
    subprocess.run(
        [PYTHON, "-c", SCRIPT, scene, tmp_path / "m.npy", str(spp)], check=True, capture_output=True
    )
    theirs = np.load(tmp_path / "m.npy")[..., :3]
    image = render(load_scene(scene), spp=spp)
    # blocks of 8 x 8 pixels; Mitsuba's noise is taken to be ours, and tails are heavy: 6 sigma, and 1 %
    # (Mitsuba's Beckmann masking is a rational fit, 0.35 % off)
    blocks = [a.reshape(4, 8, 6, 8, 3).mean((1, 3)) for a in (image.pixels, theirs)]
    error = np.sqrt(2 * (image.std_error**2).reshape(4, 8, 6, 8, 3).sum((1, 3))) / 64
    z = (blocks[0] - blocks[1]) / (error + 0.005 * blocks[1] + 1e-9)
    assert np.abs(z).max() < 6, np.abs(z).max()
    assert np.sqrt(np.mean(z**2)) < 1.3
    assert image.pixels.mean() == pytest.approx(theirs.mean(), rel=0.01)
