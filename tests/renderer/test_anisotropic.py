"""Anisotropic tables in scenes: densities and energy, and the frame they lie in on each kind of shape."""

import os
import subprocess

import numpy as np
import pytest

from gonio.bench.anisotropic import beckmann
from gonio.core.directions import direction
from gonio.core.jit import disabled, kernel
from gonio.table.anisotropic import tabulate_brdf
from gonio.table.tilts import tilt_edges
from gonio.validation import validate
from microgeometry.errors import InputError
from renderer.materials import evaluate, sample
from renderer.meshes import load_mesh, rectangle, transformed
from renderer.mitsuba_xml import load_scene
from renderer.pack_materials import pack_materials
from renderer.render import render
from renderer.scene import Camera, DirectionalLight, Disk, Material, Mesh, Scene, Sphere, look_at
from tests.renderer.scenes import assert_within, constant, mean, spot, square
from tests.renderer.test_against_mitsuba import PYTHON, SCRIPT
from tests.table.test_anisotropic import THETA_I, table_of

pytestmark = [pytest.mark.skipif(disabled, reason="needs compiled kernels"), pytest.mark.compiled]

ALPHA = 0.4, 0.15


@pytest.fixture(scope="module")
def brushed():
    return Material("tabulated", {"table": table_of(*ALPHA, n_phi=24, cells=49)})


@kernel
def _evaluate_many(materials, wi, wo, values, density):
    memory = np.zeros(6)
    for n in range(len(wi)):
        i, o = (wi[n, 0], wi[n, 1], wi[n, 2]), (wo[n, 0], wo[n, 1], wo[n, 2])
        values[n, 0], values[n, 1], values[n, 2], density[n] = evaluate(materials, 0, i, o, memory)


@kernel
def _sample_many(materials, wo, u, wi, density):
    memory = np.zeros(6)
    for n in range(len(wo)):
        o = (wo[n, 0], wo[n, 1], wo[n, 2])
        wi[n], _, _, _, density[n] = sample(materials, 0, o, u[n, 0], u[n, 1], u[n, 2], memory)


def test_densities_and_energy(brushed):
    """As any material: the renderer draws the light for the camera, so the two change places here."""
    materials = pack_materials([brushed])

    def pairs(wo, wi):
        wo, wi = (np.ascontiguousarray(np.broadcast_to(a, np.broadcast(wo, wi).shape)) for a in (wo, wi))
        values, density = np.zeros((len(wo), 3)), np.zeros(len(wo))
        _evaluate_many(materials, wi, wo, values, density)
        return values, density, wi[:, 2:]

    def value(wo, wi):
        values, _, cosine = pairs(wo, wi)
        return values / np.maximum(np.abs(cosine), 1e-12)

    def draw(wo, u):
        wi, density = np.zeros((len(wo), 3)), np.zeros(len(wo))
        _sample_many(materials, np.ascontiguousarray(wo), u, wi, density)
        return wi, density

    report = validate(
        value, draw, lambda a, b: pairs(a, b)[1], "renderer brushed", (0.3, 1.0), 100_000, reciprocal=False,
        isotropic=False,
    )  # fmt: skip
    assert report.passed, "\n".join(str(o) for o in report.outcomes if not o.passed)


def exact(wi, wo, s, n):
    """Radiance of light of irradiance 1 from `wi`, on a surface whose x axis is along `s`."""
    s = s - n * (n @ s)
    s /= np.linalg.norm(s)
    local = np.stack([s, np.cross(n, s), n])
    i, o = local @ wi, local @ wo
    return beckmann(i[None], o[None], *ALPHA)[0, 0] * i[2]


ORIGIN = np.array([0.5, -1.0, 3.0])
LIGHT = direction(0.5, 1.2)


def radiance(shape, target):
    """Of a shape at one of its points, seen from ORIGIN, in parallel light from LIGHT."""
    camera = Camera(look_at(ORIGIN, target, (0, 1, 0)), 0.01, width=4, height=4)
    light = DirectionalLight(tuple(-LIGHT), (1.0, 1.0, 1.0))
    return render(Scene(camera, (shape,), None, (light,), max_depth=2), spp=4).pixels.mean()


def seen(point):
    wo = ORIGIN - np.array(point)
    return wo / np.linalg.norm(wo)


def turned(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])


Z = np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_rectangle_lies_along_its_x(brushed, angle):
    mesh = transformed(rectangle(), turned(angle))
    shape = Mesh(mesh.vertices, mesh.faces, material=brushed, x_axis=mesh.x_axis)
    expected = exact(LIGHT, seen((0.1, 0.1, 0)), np.array([np.cos(angle), np.sin(angle), 0]), Z)
    assert radiance(shape, (0.1, 0.1, 0)) == pytest.approx(expected, rel=0.02)


def test_mesh_lies_along_its_texture(brushed, tmp_path):
    """u grows along y here; a mesh without coordinates takes x."""
    corners = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\n"
    uv = "vt 0 0\nvt 0 1\nvt 1 1\nvt 1 0\n"
    (tmp_path / "uv.obj").write_text(corners + uv + "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n")
    (tmp_path / "plain.obj").write_text(corners + "f 1 2 3\nf 1 3 4\n")
    for name, along in (("uv", [0.0, 1, 0]), ("plain", [1.0, 0, 0])):
        mesh = transformed(load_mesh(tmp_path / f"{name}.obj"), np.eye(4))
        shape = Mesh(mesh.vertices, mesh.faces, None, brushed, None, mesh.uv, mesh.x_axis)
        expected = exact(LIGHT, seen((0.2, 0.1, 0)), np.array(along), Z)
        assert radiance(shape, (0.2, 0.1, 0)) == pytest.approx(expected, rel=0.02)
    across = [exact(LIGHT, seen((0.2, 0.1, 0)), np.array(a), Z) for a in ([1.0, 0, 0], [0.0, 1, 0])]
    assert abs(across[0] / across[1] - 1) > 0.5  # or the test could not tell


def test_sphere_lies_along_its_parallels(brushed):
    axis = np.array([0.0, 1.0, 0.0])
    n = direction(0.3, 0.4)
    shape = Sphere((0, 0, 0), 1.0, material=brushed, axis=tuple(axis))
    expected = exact(LIGHT, seen(n), np.cross(axis, n), n)
    assert radiance(shape, n) == pytest.approx(expected, rel=0.02)


def test_disk_lies_away_from_its_centre(brushed):
    shape = Disk(np.eye(4), material=brushed)
    point = np.array([0.3, 0.5, 0.0])
    expected = exact(LIGHT, seen(point), point, Z)
    assert radiance(shape, point) == pytest.approx(expected, rel=0.02)


def test_furnace(brushed):
    """In constant light a surface is as bright as its albedo from the camera's side."""
    scene = Scene(spot(), (square(material=brushed),), constant(), max_depth=2)
    value, error = mean(scene, 400)
    camera = np.array([3.0, 1.0, 2.0]) / np.sqrt(14)
    theta, phi = np.arccos(camera[2]), np.arctan2(camera[1], camera[0])
    albedo = brushed.values["table"].albedo(theta, phi)[0]
    assert_within(value, albedo, error + 0.003 * albedo)


def test_from_a_file(tmp_path):
    table_of(*ALPHA, n_phi=4, cells=9, theta_i=np.radians([0, 60])).save(tmp_path / "t.h5")
    scene = tmp_path / "s.xml"
    scene.write_text(
        '<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="40"/></sensor>'
        '<shape type="sphere"><transform name="to_world"><rotate x="1" angle="-90"/></transform>'
        '<bsdf type="twosided"><bsdf type="tabulated"><string name="filename" value="t.h5"/></bsdf></bsdf>'
        "</shape></scene>"
    )
    (shape,) = load_scene(scene).shapes
    assert shape.axis == pytest.approx((0, 1, 0), abs=1e-12)
    assert shape.material.two_sided
    assert shape.material.values["table"].phi_i.shape == (4,)
    odd = table_of(*ALPHA, n_phi=4, cells=9, theta_i=np.radians([0, 60]), channels=("a", "b"))
    with pytest.raises(InputError, match="2 channels without wavelengths"):
        pack_materials([Material("tabulated", {"table": odd})])


SCENE = """<scene version="3.0.0">
  <integrator type="path"><integer name="max_depth" value="3"/></integrator>
  <sensor type="perspective"><float name="fov" value="40"/><transform name="to_world">
      <lookat origin="1, 3, 6" target="0, 0.4, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="80"/><integer name="height" value="48"/>
      <rfilter type="box"/></film></sensor>
  <shape type="rectangle"><transform name="to_world"><scale x="0.8" y="0.5"/>
      <lookat origin="2.5, 4, 3" target="0,0,0"/></transform>
      <emitter type="area"><rgb name="radiance" value="12,12,12"/></emitter></shape>
  <shape type="sphere"><transform name="to_world"><rotate x="1" angle="-90"/>
      <translate x="-1.2" y="0.8" z="0"/></transform>BSDF</shape>
  <shape type="disk"><transform name="to_world"><rotate x="1" angle="-90"/><scale value="1.1"/>
      <translate x="1.3" y="0.1" z="0.3"/></transform>BSDF</shape>
  <shape type="rectangle"><transform name="to_world"><scale x="1" y="0.6"/><rotate z="1" angle="30"/>
      <rotate x="1" angle="-40"/><translate x="0.5" y="0.9" z="-1.6"/></transform>BSDF</shape>
</scene>"""


@pytest.mark.slow
@pytest.mark.skipif(PYTHON is None, reason="no mitsuba: install it, or name its Python in MITSUBA_PYTHON")
def test_same_picture_as_mitsuba(tmp_path):
    """Its roughconductor with alpha_u, alpha_v, against a table of the same closed form."""

    def brdf(wi, wo):
        return beckmann(wi, wo, 0.3, 0.06, correlated=False)

    tabulate_brdf(brdf, THETA_I, 36, tilt_edges(0.3, 65), tilt_edges(0.06, 65), ("grey",)).save(
        tmp_path / "t.h5"
    )
    ours, theirs = tmp_path / "ours.xml", tmp_path / "theirs.xml"
    table = '<bsdf type="tabulated"><string name="filename" value="t.h5"/></bsdf>'
    metal = (
        '<bsdf type="roughconductor"><string name="distribution" value="beckmann"/>'
        '<float name="alpha_u" value="0.3"/><float name="alpha_v" value="0.06"/></bsdf>'
    )
    ours.write_text(SCENE.replace("BSDF", table))
    theirs.write_text(SCENE.replace("BSDF", metal))
    without = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    subprocess.run(
        [PYTHON, "-c", SCRIPT, theirs, tmp_path / "m.npy", "400"],
        check=True,
        capture_output=True,
        env=without,
    )
    picture = np.load(tmp_path / "m.npy")[..., :3]
    image = render(load_scene(ours), spp=400)
    a, b = (p.reshape(6, 8, 10, 8, 3).mean((1, 3, 4)) for p in (image.pixels, picture))
    assert np.sqrt(np.sum((a - b) ** 2) / np.sum(b**2)) < 0.02
    assert a.mean() == pytest.approx(b.mean(), rel=0.01)
