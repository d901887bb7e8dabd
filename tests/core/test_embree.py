"""The gateway to Embree: hits where geometry says, errors as exceptions, no compilation twice."""

from __future__ import annotations

import gc
import importlib.metadata
import os
import subprocess
import sys
import weakref

import numpy as np
import pytest

from gonio.core import embree
from gonio.core.embree import (
    DIR_Z,
    GEOM_ID,
    INST_ID,
    MISS,
    NORMAL_X,
    NORMAL_Y,
    NORMAL_Z,
    ORG_X,
    ORG_Y,
    ORG_Z,
    T_FAR,
    VALID,
    EmbreeError,
    Scene,
    intersect1,
    intersect16,
    new_packet,
    new_ray,
    occluded1,
)  # fmt: skip

QUAD = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 1]]], float)  # corner (1, 1) lifted


def ray_down(x, y):
    ray = new_ray()
    ray[ORG_X], ray[ORG_Y], ray[ORG_Z], ray[DIR_Z], ray[T_FAR] = x, y, 5.0, -1.0, np.inf
    ray.view(np.int32)[[GEOM_ID, INST_ID]] = MISS
    return ray


def hit(scene, x, y):
    ray = ray_down(x, y)
    intersect1(scene.handle, ray)
    return 5.0 - ray[T_FAR], ray[[NORMAL_X, NORMAL_Y, NORMAL_Z]].tolist()


def test_grid_is_split_from_the_second_to_the_fourth_corner_and_faces_up():
    scene = Scene()
    scene.add_grid(QUAD)
    scene.commit()
    # below the diagonal the flat triangle (0,0) (1,0) (0,1); above it z = x + y - 1, normal (-1, -1, 1)
    assert hit(scene, 0.2, 0.7) == (0.0, [0.0, 0.0, 1.0])
    height, normal = hit(scene, 0.75, 0.5)
    assert height == pytest.approx(0.25, abs=1e-6)
    assert normal == [-1.0, -1.0, 1.0]


def test_triangles_keep_their_winding():
    scene = Scene()
    scene.add_triangles([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    scene.commit()
    assert hit(scene, 0.25, 0.25) == (0.0, [0.0, 0.0, 1.0])


def test_packet_agrees_with_single_rays_and_leaves_idle_lanes_alone():
    scene = Scene()
    scene.add_grid(QUAD)
    scene.commit()
    packet = new_packet()
    ints = packet.view(np.int32)
    packet[ORG_X] = np.linspace(-0.2, 0.99, 16)
    packet[ORG_Y], packet[ORG_Z], packet[DIR_Z], packet[T_FAR] = 0.6, 5.0, -1.0, np.inf
    ints[[GEOM_ID, INST_ID]] = MISS
    ints[VALID] = -1
    ints[VALID, 5] = 0
    intersect16(scene.handle, packet, True)
    for lane, x in enumerate(packet[ORG_X]):
        if lane == 5:
            assert ints[GEOM_ID, lane] == MISS
            assert packet[T_FAR, lane] == np.inf
        elif x < 0:
            assert ints[GEOM_ID, lane] == MISS
        else:
            assert packet[T_FAR, lane] == pytest.approx(5.0 - hit(scene, x, 0.6)[0], abs=1e-6)


def test_occlusion():
    scene = Scene()
    scene.add_grid(QUAD)
    scene.commit()
    assert occluded1(scene.handle, ray_down(0.5, 0.5))
    assert not occluded1(scene.handle, ray_down(1.5, 0.5))


def test_alignment():
    assert new_packet().ctypes.data % 64 == 0
    assert new_ray().ctypes.data % 16 == 0


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda s: s.add_triangles(np.zeros((0, 3)), np.zeros((0, 3), int)), "F > 0"),
        (lambda s: s.add_triangles([[0, 0, 0], [1, 0, 0], [0, 1, np.nan]], [[0, 1, 2]]), "finite"),
        (lambda s: s.add_triangles([[0, 0, 0]], [[0, 1, 2]]), "face index 2"),
        (lambda s: s.add_grid(np.zeros((1, 5, 3))), "2 to 32767"),
        (lambda s: s.handle, "commit"),
    ],
)
def test_bad_geometry_is_refused(build, words):
    with pytest.raises(EmbreeError, match=words):
        build(Scene())


def test_embrees_own_error_becomes_an_exception_of_the_call():
    device = embree._device()
    geometry = device.call("rtcNewGeometry", device.pointer, 0)
    data = np.zeros((4, 3), np.float32)
    with pytest.raises(EmbreeError, match="rtcSetSharedGeometryBuffer: invalid"):
        # a vertex buffer in an index format
        device.call("rtcSetSharedGeometryBuffer", geometry, 1, 0, 0x5003, data.ctypes.data, 0, 12, 3)
    Scene().commit()  # the device still works, and the error is not reported twice


def test_scene_releases_its_memory():
    scene = Scene()
    scene.add_grid(QUAD)
    buffer = weakref.ref(scene._buffers[0])
    scene.commit()
    del scene
    gc.collect()
    assert buffer() is None


def test_embreex_without_a_bundled_library(monkeypatch):
    class Bare:
        version = "9.9"
        files = ()

    monkeypatch.setattr(importlib.metadata, "distribution", lambda name: Bare())
    with pytest.raises(EmbreeError, match=r"embreex 9\.9 carries no Embree 4 library.*pip install"):
        embree.library_path()


def test_missing_embreex(monkeypatch):
    def missing(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "distribution", missing)
    with pytest.raises(EmbreeError, match="embreex is not installed"):
        embree.library_path()


SECOND_PROCESS = """
import numba
from numba.core import event

class Listener(event.Listener):
    compiled = []
    def on_start(self, e):
        self.compiled.append(str(e.data["dispatcher"]))
    def on_end(self, e):
        pass

listener = Listener()
event.register("numba:compile", listener)
from gonio.trace.measure import measure
from microgeometry.specimen import parse_specimen
specimen = parse_specimen({"surface": {"kind": "flat"}, "material": {"kind": "lambert", "albedo": 0.5},
                           "grid": {"theta_step_deg": 30, "phi_step_deg": 90}})
table = measure(specimen, rays=1)
table.eval([0.0, 0.0, 1.0], [0.0, 0.0, 1.0])
print(len(listener.compiled))
"""


@pytest.mark.compiled
def test_a_second_process_compiles_nothing(tmp_path):
    environment = {**os.environ, "GONIO_CACHE_DIR": str(tmp_path)}
    counts = []
    for _ in range(2):
        run = subprocess.run(
            [sys.executable, "-c", SECOND_PROCESS],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        counts.append(int(run.stdout.split()[-1]))
    assert counts[0] > 5  # the first one did compile
    assert counts[1] == 0
