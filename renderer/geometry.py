"""Where rays hit: triangles through Embree, spheres and disks exactly.

Spheres and disks are tested one by one before Embree is asked, so their silhouettes and normals are
exact; a scene with hundreds of spheres is better given as a mesh.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gonio.core.directions import frame
from gonio.core.embree import (
    DIR_X,
    DIR_Y,
    DIR_Z,
    GEOM_ID,
    HIT_U,
    HIT_V,
    MISS,
    NORMAL_X,
    NORMAL_Y,
    NORMAL_Z,
    ORG_X,
    ORG_Y,
    ORG_Z,
    PRIM_ID,
    T_FAR,
    Handle,
)
from gonio.core.jit import kernel


class Geometry(NamedTuple):
    """The shapes of a scene as kernels take them: M meshes, then Q spheres and disks."""

    handle: Handle
    material: np.ndarray  # int64 (M + Q,)
    light: np.ndarray  # int64 (M + Q,), index of the area light, -1 for none
    extent: np.ndarray  # (M + Q,), largest coordinate: how exact a hit can be in float32
    first_face: np.ndarray  # int64 (M,)
    smooth: np.ndarray  # int64 (M,), whether vertex normals are interpolated
    faces: np.ndarray  # int32 (F, 3)
    normals: np.ndarray  # float32 (V, 3)
    tangents: np.ndarray  # float32 (F, 3), where u grows
    is_disk: np.ndarray  # int64 (Q,)
    quadric: np.ndarray  # (Q, 8): centre, radius, orientation; disks: normal, spheres: axis


@kernel(allocates=False)
def nearest_quadric(geometry, origin, direction, t_max):
    """Nearest sphere or disk before `t_max`: (distance, index), index -1 for none."""
    q = geometry.quadric
    found = -1
    for i in range(len(q)):
        x, y, z = q[i, 0] - origin[0], q[i, 1] - origin[1], q[i, 2] - origin[2]
        if geometry.is_disk[i]:
            below = direction[0] * q[i, 5] + direction[1] * q[i, 6] + direction[2] * q[i, 7]
            if below == 0.0:
                continue
            t = (x * q[i, 5] + y * q[i, 6] + z * q[i, 7]) / below
            x, y, z = x - t * direction[0], y - t * direction[1], z - t * direction[2]
            if 0.0 < t < t_max and x * x + y * y + z * z <= q[i, 3] * q[i, 3]:
                t_max, found = t, i
            continue
        # Haines et al. 2019, Ray Tracing Gems chapter 7: the discriminant from the perpendicular, so a
        # small sphere far away does not drown in b^2
        middle = x * direction[0] + y * direction[1] + z * direction[2]
        x, y, z = x - middle * direction[0], y - middle * direction[1], z - middle * direction[2]
        half2 = q[i, 3] * q[i, 3] - (x * x + y * y + z * z)
        if half2 <= 0.0:
            continue
        half = math.sqrt(half2)
        t = middle - half
        if t <= 0.0:
            t = middle + half
        if 0.0 < t < t_max:
            t_max, found = t, i
    return t_max, found


@kernel(allocates=False)
def surface(geometry, packet, lane, i_quadric):
    """What a lane of the packet hit.

    Parameters
    ----------
    i_quadric : int
        The sphere or disk before which Embree looked, -1 for none.

    Returns
    -------
    shape : int
        Its index, -1 for nothing.
    point, normal, shading_normal : tuple of 3 float
        World space; both normals on the side the shape calls its front.
    distance : float
        Along the ray.
    """
    ids = packet.view(np.int32)
    t = np.float64(packet[T_FAR, lane])
    dx, dy, dz = (
        np.float64(packet[DIR_X, lane]),
        np.float64(packet[DIR_Y, lane]),
        np.float64(packet[DIR_Z, lane]),
    )
    point = (packet[ORG_X, lane] + t * dx, packet[ORG_Y, lane] + t * dy, packet[ORG_Z, lane] + t * dz)
    mesh = np.int64(ids[GEOM_ID, lane])
    if mesh == MISS:
        if i_quadric < 0:
            return -1, point, point, point, t
        shape = len(geometry.first_face) + i_quadric
        q = geometry.quadric
        if geometry.is_disk[i_quadric]:
            normal = (q[i_quadric, 5], q[i_quadric, 6], q[i_quadric, 7])
            return shape, point, normal, normal, t
        x, y, z = point[0] - q[i_quadric, 0], point[1] - q[i_quadric, 1], point[2] - q[i_quadric, 2]
        scale = 1.0 / math.sqrt(x * x + y * y + z * z)
        onto = q[i_quadric, 3] * scale
        point = (q[i_quadric, 0] + onto * x, q[i_quadric, 1] + onto * y, q[i_quadric, 2] + onto * z)
        scale *= q[i_quadric, 4]
        normal = (scale * x, scale * y, scale * z)
        return shape, point, normal, normal, t
    x, y, z = packet[NORMAL_X, lane], packet[NORMAL_Y, lane], packet[NORMAL_Z, lane]
    x, y, z = np.float64(x), np.float64(y), np.float64(z)
    scale = 1.0 / math.sqrt(x * x + y * y + z * z)
    normal = (scale * x, scale * y, scale * z)
    if not geometry.smooth[mesh]:
        return mesh, point, normal, normal, t
    face = geometry.first_face[mesh] + ids[PRIM_ID, lane]
    i, j, k = geometry.faces[face, 0], geometry.faces[face, 1], geometry.faces[face, 2]
    n, b, c = geometry.normals, np.float64(packet[HIT_U, lane]), np.float64(packet[HIT_V, lane])
    a = 1.0 - b - c
    x = a * n[i, 0] + b * n[j, 0] + c * n[k, 0]
    y = a * n[i, 1] + b * n[j, 1] + c * n[k, 1]
    z = a * n[i, 2] + b * n[j, 2] + c * n[k, 2]
    length2 = x * x + y * y + z * z
    if length2 < 1e-12:
        return mesh, point, normal, normal, t
    scale = 1.0 / math.sqrt(length2)
    x, y, z = x * scale, y * scale, z * scale
    if x * normal[0] + y * normal[1] + z * normal[2] < 0.0:
        normal = (-normal[0], -normal[1], -normal[2])
    # At a silhouette the interpolated normal may turn away from a viewer who sees the face: bend it back
    # to grazing, or the rim would be black.
    front = -(dx * normal[0] + dy * normal[1] + dz * normal[2])
    seen = -(dx * x + dy * y + dz * z)
    if front * seen <= 0.0:
        shift = seen - math.copysign(1e-3, front)
        x, y, z = x + shift * dx, y + shift * dy, z + shift * dz
        scale = 1.0 / math.sqrt(x * x + y * y + z * z)
        x, y, z = x * scale, y * scale, z * scale
    return mesh, point, normal, (x, y, z), t


@kernel(allocates=False)
def tangents(geometry, packet, lane, shape, point, n):
    """The axes x and y of an anisotropic material at a hit of the lane, in the plane of the shading normal `n`.

    x is where the shape's u grows: see `renderer.scene`. Any two axes where that direction is undefined.
    """
    n_meshes = len(geometry.first_face)
    if shape >= n_meshes:
        q = geometry.quadric
        i = shape - n_meshes
        x, y, z = point[0] - q[i, 0], point[1] - q[i, 1], point[2] - q[i, 2]
        if not geometry.is_disk[i]:
            a, b, c = q[i, 5], q[i, 6], q[i, 7]
            x, y, z = b * z - c * y, c * x - a * z, a * y - b * x
        scale = 1.0 / q[i, 3]
        x, y, z = scale * x, scale * y, scale * z
    else:
        face = geometry.first_face[shape] + packet.view(np.int32)[PRIM_ID, lane]
        x = np.float64(geometry.tangents[face, 0])
        y = np.float64(geometry.tangents[face, 1])
        z = np.float64(geometry.tangents[face, 2])
    along = x * n[0] + y * n[1] + z * n[2]
    x, y, z = x - along * n[0], y - along * n[1], z - along * n[2]
    length2 = x * x + y * y + z * z
    if length2 < 1e-12:
        return frame(n)
    scale = 1.0 / math.sqrt(length2)
    s = (scale * x, scale * y, scale * z)
    return s, (n[1] * s[2] - n[2] * s[1], n[2] * s[0] - n[0] * s[2], n[0] * s[1] - n[1] * s[0])


@kernel(allocates=False)
def offset(geometry, shape, point, normal, direction, distance):
    """Where a ray in `direction` starts so that it does not, in float32, hit the surface it leaves."""
    reach = max(abs(point[0]), max(abs(point[1]), abs(point[2])))
    step = 1e-6 * (geometry.extent[shape] + reach + distance)
    if direction[0] * normal[0] + direction[1] * normal[1] + direction[2] * normal[2] < 0.0:
        step = -step
    return point[0] + step * normal[0], point[1] + step * normal[1], point[2] + step * normal[2]
