"""Single paths at a fixed azimuth, for tests that know where each must go."""

from __future__ import annotations

import numpy as np

from gonio.core import jit
from gonio.core.directions import direction
from gonio.core.embree import DIR_X, DIR_Y, DIR_Z, PACKET_WIDTH, new_packet
from gonio.core.jit import kernel
from gonio.trace.scene import TraceScene, pack_optics
from gonio.trace.start import start_packet
from gonio.trace.transport import trace_packet
from microgeometry.specimen import Layer
from microgeometry.surfaces.flat import Flat


@kernel
def _trace(
    embree, box, horizon, eta_k, albedo, wi, side, max_bounces, seed, exits, weight, bounces, status, absorbed
):  # fmt: skip
    packet = new_packet()
    polarisation = None if eta_k is None else np.empty((PACKET_WIDTH, weight.shape[1], 3))
    axis = None if eta_k is None else np.empty((PACKET_WIDTH, 3))
    retreat = np.empty((3, PACKET_WIDTH), np.float32)
    rays = 0
    dx, dy = box.width_x / (4 * side), box.width_y / (4 * side)
    for k in range(side * side):
        i, j = k // side, k % side
        path = 16 * k
        start_packet(packet, wi, box, 4 * i * dx, 4 * j * dy, dx, dy, seed, 0, path)
        lanes = slice(path, path + PACKET_WIDTH)
        rays += trace_packet(
            embree, box, horizon, True, packet, eta_k, albedo, max_bounces, seed, 0, path,
            weight[lanes], polarisation, axis, retreat, bounces[lanes], status[lanes], absorbed,
        )  # fmt: skip
        for lane in range(PACKET_WIDTH):
            exits[path + lane, 0] = packet[DIR_X, lane]
            exits[path + lane, 1] = packet[DIR_Y, lane]
            exits[path + lane, 2] = packet[DIR_Z, lane]
    return rays


class Paths:
    """Paths from one direction (azimuth 0: light in the xz plane, from +x), stratified over the tile."""

    def __init__(
        self, tile, material, theta_i_deg, side=32, seed=0, max_bounces=64, horizon=not jit.disabled
    ):
        scene = TraceScene([tile], horizon=horizon)
        optics = pack_optics(Layer(Flat(), material))
        channels = 1
        for field in optics:
            channels = channels if field is None else len(field)
        n = 16 * side * side
        self.exits = np.zeros((n, 3))
        self.weight = np.zeros((n, channels))
        self.bounces = np.zeros(n, np.int64)
        self.status = np.zeros(n, np.int64)
        self.absorbed = np.zeros(channels)
        wi = tuple(direction(np.radians(theta_i_deg)).tolist())
        self.rays = _trace(
            scene.embree, scene.box, scene.horizon, *optics, wi, side, max_bounces, seed,
            self.exits, self.weight, self.bounces, self.status, self.absorbed,
        )  # fmt: skip

    @property
    def theta_r_deg(self):
        """Signed angle in the xz plane, negative on the source's side (x > 0)."""
        return np.degrees(np.arctan2(-self.exits[:, 0], self.exits[:, 2]))

    def fraction(self, bounces, theta_r_deg):
        """Fraction of paths that left after so many bounces at this angle, to a hundredth of a degree."""
        return np.mean((self.bounces == bounces) & (abs(self.theta_r_deg - theta_r_deg) < 0.01))
