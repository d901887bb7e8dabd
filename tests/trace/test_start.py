"""Light from straight above: the hits that are looked up are those that Embree finds."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.core.embree import (
    DIR_Y,
    GEOM_ID,
    NORMAL_X,
    NORMAL_Z,
    ORG_X,
    ORG_Z,
    PACKET_WIDTH,
    T_FAR,
    intersect16,
    new_packet,
)
from gonio.core.jit import kernel
from gonio.trace.scene import TraceScene
from gonio.trace.start import fall, is_vertical, start_packet
from microgeometry.materials import Mirror
from microgeometry.tile import HeightField

from .paths import Paths

pytestmark = pytest.mark.compiled

# more than the fraction of rays that rounding moves to the triangle beside (measured: 3 of a million)
_BESIDE = 1e-4


@kernel
def first_hits(embree, samples, box, side, looked_up, traced):
    packet = new_packet()
    dx, dy = box.width_x / (4 * side), box.width_y / (4 * side)
    for k in range(side * side):
        for found in (looked_up, traced):
            x0, y0 = 4 * (k // side) * dx, 4 * (k % side) * dy
            start_packet(packet, (0.0, 0.0, 1.0), box, x0, y0, dx, dy, 7, 0, 16 * k)
            if found is looked_up:
                fall(samples, box, packet)
            else:
                intersect16(embree, packet, True)
            found[k] = packet


@kernel
def intersect(embree, packet):
    intersect16(embree, packet, True)


@pytest.mark.parametrize("shape", [(64, 64), (40, 90)])
def test_hits_are_embrees(shape):
    rng = np.random.default_rng(1)
    tile = HeightField(rng.normal(0.0, 0.02, shape), (1.5, 1.0))
    scene = TraceScene([tile], horizon=True)
    side = 32
    looked_up, traced = np.zeros((2, side * side, *new_packet().shape), np.float32)
    first_hits(scene.embree, scene.horizon.samples, scene.box, side, looked_up, traced)
    for hits in (looked_up, traced):
        hits[:, NORMAL_X : NORMAL_Z + 1] /= np.linalg.norm(
            hits[:, NORMAL_X : NORMAL_Z + 1], axis=1, keepdims=True
        )
    assert np.all(looked_up.view(np.int32)[:, GEOM_ID] == 0)
    assert np.array_equal(looked_up[:, ORG_X : ORG_Z + 1], traced[:, ORG_X : ORG_Z + 1])
    assert np.abs(looked_up[:, T_FAR] - traced[:, T_FAR]).max() < 2 * scene.box.lift
    same = (
        np.abs(looked_up[:, NORMAL_X : NORMAL_Z + 1] - traced[:, NORMAL_X : NORMAL_Z + 1]).max(axis=1) < 1e-4
    )
    assert same.mean() > 1.0 - _BESIDE


@pytest.mark.parametrize("corner", [(0.0, 0.0), (1.5, 1.0)])
def test_paths_that_start_on_a_face_of_the_box_find_a_facet(corner):
    """Strata without width: all start in the corner."""
    scene = TraceScene([HeightField(np.zeros((8, 8)), (1.5, 1.0))])
    packet = new_packet()
    x, y = np.float32(corner) * scene.box.width_x / np.float32(1.5)
    start_packet(packet, (0.0, 0.0, 1.0), scene.box, x, y, 0.0, 0.0, 0, 0, 0)
    intersect(scene.embree, packet)
    assert np.all(packet.view(np.int32)[GEOM_ID] == 0)


def test_only_packets_from_straight_above_fall():
    box = TraceScene([HeightField(np.zeros((2, 2)), (1.0, 1.0))]).box
    packet = new_packet()
    for wi, expected in (((0.0, 0.0, 1.0), True), ((1e-6, 0.0, 1.0), False), ((0.0, -1e-6, 1.0), False)):
        start_packet(packet, wi, box, 0.0, 0.0, 0.1, 0.1, 0, 0, 0)
        assert is_vertical(packet) == expected


def test_one_ray_a_path_is_saved_and_none_lost():
    rng = np.random.default_rng(2)
    tile = HeightField(rng.normal(0.0, 0.002, (64, 64)), (1.0, 1.0))
    looked_up, traced = (Paths(tile, Mirror(), 0.0, side=64, horizon=h) for h in (True, False))
    paths = PACKET_WIDTH * 64**2
    assert np.all(looked_up.status == 1)
    assert traced.rays - looked_up.rays > paths
    assert np.mean(looked_up.bounces) == pytest.approx(np.mean(traced.bounces), abs=_BESIDE)


def test_one_slanted_ray_keeps_its_packet_from_falling():
    box = TraceScene([HeightField(np.zeros((2, 2)), (1.0, 1.0))]).box
    packet = new_packet()
    start_packet(packet, (0.0, 0.0, 1.0), box, 0.0, 0.0, 0.1, 0.1, 0, 0, 0)
    packet[DIR_Y, 9] = 0.1
    assert not is_vertical(packet)
