"""Scene files: what they mean, and what they are told when they are wrong."""

import json

import numpy as np
import pytest
import trimesh

from microgeometry.errors import InputError
from renderer.image import write_exr
from renderer.mitsuba_xml import load_scene
from renderer.pack import pack
from renderer.scene import Disk, Mesh, Sphere
from tests.renderer.scenes import lambert_table

SENSOR = '<sensor type="perspective"><float name="fov" value="40"/></sensor>'


def load(tmp_path, body, sensor=SENSOR, **parameters):
    (tmp_path / "s.xml").write_text(f'<scene version="3.0.0">{sensor}{body}</scene>')
    return load_scene(tmp_path / "s.xml", parameters)


def test_sensor_film_sampler_integrator(tmp_path):
    sensor = """<default name="w" value="32"/><sensor type="thinlens"><float name="fov" value="90"/>
      <string name="fov_axis" value="y"/><float name="aperture_radius" value="0.1"/>
      <float name="focus_distance" value="3"/><float name="near_clip" value="0.1"/>
      <transform name="to_world"><lookat origin="1,2,3" target="1,2,0" up="0,1,0"/></transform>
      <film type="hdrfilm"><integer name="width" value="$w"/><integer name="height" value="8"/>
        <rfilter type="gaussian"/></film>
      <sampler type="multijitter"><integer name="sample_count" value="7"/></sampler></sensor>
      <integrator type="path"><integer name="max_depth" value="-1"/></integrator>"""
    scene = load(tmp_path, "", sensor, w="16")
    camera = scene.camera
    assert (camera.width, camera.height, scene.spp, scene.max_depth) == (16, 8, 7, -1)
    assert camera.tangents() == pytest.approx((2, 1))
    # looks to -z; Mitsuba's +x is to the left, which is the world's -x
    np.testing.assert_allclose(camera.to_world[:3, :3], np.diag([-1, 1, -1]), atol=1e-15)
    np.testing.assert_allclose(camera.to_world[:3, 3], [1, 2, 3])
    assert (camera.aperture_radius, camera.focus_distance) == (0.1, 3)


def test_steps_of_a_transform_apply_in_order(tmp_path):
    body = """<shape type="disk"><transform name="to_world"><scale value="2"/><rotate y="1" angle="90"/>
      <translate x="1" y="2" z="3"/></transform></shape>"""
    (disk,) = load(tmp_path, body).shapes
    assert isinstance(disk, Disk)
    np.testing.assert_allclose(disk.to_world @ [1, 0, 0, 1], [1, 2, 1, 1], atol=1e-12)  # +x to -z
    np.testing.assert_allclose(disk.to_world @ [0, 0, 1, 1], [3, 2, 3, 1], atol=1e-12)  # normal to +x


def test_shapes(tmp_path):
    trimesh.creation.icosphere(subdivisions=1).export(tmp_path / "ball.ply")
    (tmp_path / "tri.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nvn 0 0 1\nvn 0 1 0\nf 1//1 2//2 3//3\n"
    )
    scene = load(
        tmp_path,
        """<shape type="sphere"><point name="center" value="1, 0, 0"/><float name="radius" value="2"/>
             <transform name="to_world"><scale value="3"/><translate z="1"/></transform></shape>
           <shape type="cube"/><shape type="rectangle"/>
           <shape type="ply"><string name="filename" value="ball.ply"/></shape>
           <shape type="obj"><string name="filename" value="tri.obj"/></shape>""",
    )
    ball, cube, square, ply, obj = scene.shapes
    assert isinstance(ball, Sphere)
    assert (ball.center, ball.radius) == ((3.0, 0.0, 1.0), pytest.approx(6.0))
    assert np.allclose(square.vertices[:, 2], 0)
    assert ply.normals is None
    np.testing.assert_allclose(obj.normals[2], [0, 1, 0])
    # normals outwards: the divergence theorem gives the volume with its sign
    for mesh, volume in ((cube, 8.0), (ply, trimesh.creation.icosphere(subdivisions=1).volume)):
        a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
        assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6 == pytest.approx(volume)
    pack(scene)


def test_mirroring_keeps_normals_outside(tmp_path):
    body = '<shape type="cube"><transform name="to_world"><scale x="-1"/></transform></shape>'
    (mesh,) = load(tmp_path, body).shapes
    assert isinstance(mesh, Mesh)
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0


def test_materials_by_reference_nesting_and_name(tmp_path):
    body = """<bsdf type="twosided" id="m"><bsdf type="conductor">
        <string name="material" value="Au"/></bsdf></bsdf>
      <shape type="sphere"><ref id="m"/></shape>
      <shape type="sphere"><bsdf type="diffuse"><rgb name="reflectance" value="0.1, 0.2 0.3"/></bsdf></shape>
      <shape type="sphere"><bsdf type="plastic"><string name="int_ior" value="water"/></bsdf></shape>
      <shape type="sphere"><bsdf type="roughconductor"><float name="alpha" value="0.2"/>
        <string name="distribution" value="ggx"/></bsdf></shape><shape type="sphere"/>"""
    gold, diffuse, plastic, rough, default = (s.material for s in load(tmp_path, body).shapes)
    assert gold.two_sided
    assert gold.values["k"][0] > 3 > gold.values["k"][2] > 1.5  # gold: red is reflected, blue less
    assert diffuse.values["reflectance"] == (0.1, 0.2, 0.3)
    assert plastic.values["eta"] == pytest.approx(1.333 / 1.000277)
    assert rough.values["distribution"] == "ggx"
    assert default.values["reflectance"] == (0.5, 0.5, 0.5)


def test_emitters(tmp_path):
    write_exr(tmp_path / "e.exr", {"RGB": np.ones((4, 8, 3))})
    body = """<emitter type="envmap"><string name="filename" value="e.exr"/>
        <float name="scale" value="2"/></emitter>
      <emitter type="point"><transform name="to_world"><translate x="1"/></transform>
        <rgb name="intensity" value="5"/></emitter>
      <emitter type="directional"><vector name="direction" x="0" y="-1" z="0"/>
        <rgb name="irradiance" value="1,2,3"/></emitter>
      <shape type="sphere"><emitter type="area"><rgb name="radiance" value="7"/></emitter></shape>"""
    scene = load(tmp_path, body)
    assert scene.environment.scale == 2
    assert scene.lights[0].position == (1, 0, 0)
    assert scene.lights[0].intensity == (5, 5, 5)
    assert scene.lights[1].irradiance == (1, 2, 3)
    assert scene.shapes[0].emission == (7, 7, 7)


def test_tabulated_and_analytic(tmp_path):
    lambert_table(0.5).save(tmp_path / "t.h5")
    fit = {
        "model": "lambert",
        "lobes": [
            {"name": "lambert", "parameters": {}, "coefficients": {"albedo": {"R": 0.5, "G": 0.4, "B": 0.3}}}
        ],
    }
    (tmp_path / "f.json").write_text(json.dumps(fit))
    body = """<bsdf type="tabulated" id="t"><string name="filename" value="$t"/></bsdf>
      <shape type="sphere"><ref id="t"/></shape><shape type="sphere"><ref id="t"/></shape>
      <shape type="sphere"><bsdf type="analytic"><string name="filename" value="f.json"/></bsdf></shape>"""
    scene = load(tmp_path, body, t="t.h5")
    materials = pack(scene).world.materials
    assert len(materials.kind) == 2
    assert len(materials.pool.header) == 1
    assert materials.lobes.weight[0, :3].tolist() == [0.5, 0.4, 0.3]


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("<shape type='torus'/>", "torus.*allowed are sphere, disk"),
        ("<shape type='sphere'><float name='radios' value='1'/></shape>", "radios.*radius"),
        ("<shape type='sphere'><float name='radius' value='-1'/></shape>", "radius is -1"),
        ("<shape type='sphere'><float name='radius' value='big'/></shape>", "'big' is not made of numbers"),
        ("<shape type='sphere'><transform name='to_world'><scale x='2'/></transform></shape>", "stretches"),
        ("<shape type='sphere'><ref id='gold'/></shape>", "gold.*no <bsdf> of this id"),
        ("<shape type='ply'><string name='filename' value='no.ply'/></shape>", "no.ply: no such mesh"),
        (
            "<shape type='ply'><string name='filename' value='s.xml'/></shape>",
            "s.xml: has no triangles",
        ),
        (
            "<bsdf type='diffuse' id='a'><texture type='bitmap' name='reflectance'/></bsdf>",
            "texture.*not supported",
        ),
        ("<bsdf type='roughconductor' id='a'><float name='alpha' value='-0.1'/></bsdf>", "alpha is -0.1"),
        ("<bsdf type='conductor' id='a'><string name='material' value='Unobtainium'/></bsdf>", "Unobtainium"),
        ("<bsdf type='conductor' id='a'><rgb name='eta' value='1'/></bsdf>", "one of eta and k is missing"),
        ("<bsdf type='dielectric' id='a'><string name='int_ior' value='jelly'/></bsdf>", "jelly.*water"),
        ("<bsdf type='tabulated' id='a'><string name='filename' value='no.h5'/></bsdf>", "no.h5"),
        ("<bsdf type='analytic' id='a'><string name='filename' value='no.json'/></bsdf>", "no.json"),
        ("<bsdf type='principled' id='a'/>", "principled.*allowed are diffuse"),
        ("<bsdf type='diffuse'/>", "attribute id is missing"),
        ("<emitter type='spot'/>", "spot.*envmap, constant, point, directional"),
        ("<emitter type='constant'><rgb name='radiance' value='1 2'/></emitter>", "2 numbers; 1 or 3"),
        (
            "<emitter type='constant'><rgb name='radiance' value='$x'/></emitter>",
            "parameter in '\\$x' has no value",
        ),
        ("<medium type='homogeneous'/>", "medium.*not supported"),
        ("<integrator type='bdpt'/>", "bdpt.*path is"),
        ("<integrator type='path'><integer name='max_depth' value='0'/></integrator>", "max_depth is 0"),
        (SENSOR, "2 sensors"),
        ("<shape", "not a valid XML"),
    ],
)
def test_errors_name_what_is_wrong(tmp_path, body, words):
    with pytest.raises(InputError, match=words) as error:
        load(tmp_path, body)
    assert "\n" not in str(error.value)
    assert str(tmp_path) in str(error.value)


def test_entities_are_refused(tmp_path):
    (tmp_path / "s.xml").write_text('<!DOCTYPE a [<!ENTITY b "c">]><scene>&b;</scene>')
    with pytest.raises(InputError, match="not a valid XML"):
        load_scene(tmp_path / "s.xml")


def test_unknown_parameter(tmp_path):
    with pytest.raises(InputError, match="no parameter 'tabel'; its parameters are none"):
        load(tmp_path, "", tabel="x")


@pytest.mark.parametrize(("fov", "words"), [("0", "fov is 0"), ("180", "between 0 and 180")])
def test_field_of_view(tmp_path, fov, words):
    with pytest.raises(InputError, match=words):
        load(tmp_path, "", f'<sensor type="perspective"><float name="fov" value="{fov}"/></sensor>')
