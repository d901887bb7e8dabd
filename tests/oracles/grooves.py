"""V-grooves, exactly: light in beams that are cut where they meet an edge, no sampling over the groove.

A groove (of air) and a ridge (of glass) are triangles, convex: of a beam of parallel rays that starts on one side, a
part goes to each of the two others, cut by the ray through the corner between them. So all paths of a groove
are a finite list of beams of constant width, bounces and direction. Fields are vectors in space, transformed by
3 x 3 matrices: no Stokes vector, no frame to rotate.

Grooves are along y, of period 1 with the ridge at x = 0; incidence (theta, phi) is where the light comes from, phi
from x.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tests.oracles.films import film_amplitudes


class Exit(NamedTuple):
    """A beam that has left: `share` of the incident light before losses, and what optics left of it."""

    share: float
    bounces: int
    direction: np.ndarray
    """Of travel; up above the groove, down below it."""
    weight: float
    """Intensity / incident, unpolarised light in."""


class Walls(NamedTuple):
    """What the walls of a groove are made of."""

    n: complex
    """Complex is opaque metal; real is glass, which fills the half-space below, and beams in it are followed too."""
    films: tuple = ()
    """(index, thickness) from the air inwards, thickness in wavelengths."""


def groove(slope, theta, phi=0.0, walls=None, cutoff=1e-9):
    """All beams that leave a V-groove.

    Parameters
    ----------
    slope, theta, phi : float
        Radians.
    walls : Walls, optional
        None is a perfect mirror.
    cutoff : float
        Beams that carry less than this share of the light are dropped.

    Returns
    -------
    list of Exit
    """
    depth = 0.5 * math.tan(slope)
    # corners in x, z. Air: left ridge, valley, right ridge. Glass: left valley, ridge, right valley.
    air = np.array([(0.0, 0.0), (0.5, -depth), (1.0, 0.0)])
    glass = np.array([(-0.5, -depth), (0.0, 0.0), (0.5, -depth)])
    corners = {"air": air, "glass": glass}
    # normals out of the glass; a wall has the same end first in both triangles, but the other number
    left, right = (np.array([sign * math.sin(slope), 0.0, math.cos(slope)]) for sign in (1, -1))
    outwards = {"air": (left, right), "glass": (right, left)}
    sides = ((0, 1), (1, 2), (2, 0))  # two walls and the open side
    d = -np.array([math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)])
    exits = []
    # a beam: where it is, the side it starts on, its ends as fractions of that side, its direction, its fields
    # (columns: x, y, z for two states of the incident light's polarisation), bounces and share
    beams = [("air", 2, 0.0, 1.0, d, _basis(d), 0, 1.0)]
    while beams:
        where, side, low, high, d, fields, bounces, share = beams.pop()
        triangle = corners[where]
        start, end = triangle[sides[side][0]], triangle[sides[side][1]]
        opposite = triangle[3 - sides[side][0] - sides[side][1]]
        flat = np.array([d[0], d[2]])
        # the ray through the opposite corner starts at this fraction of the side
        cut = _cross(opposite - start, flat) / _cross(end - start, flat)
        for other in range(3):
            if other == side:
                continue
            shared = set(sides[side]) & set(sides[other])
            near_start = sides[side][0] in shared
            a, b = (low, min(high, cut)) if near_start else (max(low, cut), high)
            if b - a <= 1e-12:
                continue
            part = share * (b - a) / (high - low)
            weight = _intensity(fields)
            if part * weight < cutoff:
                continue
            if other == 2:
                exits.append(Exit(part, bounces, d, weight))
                continue
            o, p = triangle[sides[other][0]], triangle[sides[other][1]]
            ends = sorted(_cross(start + f * (end - start) - o, flat) / _cross(p - o, flat) for f in (a, b))
            normal = outwards[where][other]
            for onto, d_new, new in _meet(d, fields, normal, where, walls):
                wall = other if onto == where else 1 - other
                beams.append((onto, wall, *ends, d_new, new, bounces + 1, part))
    return exits


def _cross(a, b):
    return a[0] * b[1] - a[1] * b[0]


def _basis(d):
    """Two unit fields perpendicular to d, shape (3, 2), complex."""
    helper = np.array([0.0, 1.0, 0.0]) if abs(d[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    s = np.cross(d, helper)
    s /= np.linalg.norm(s)
    return np.stack([s, np.cross(d, s)], axis=1).astype(complex)


def _intensity(fields):
    """Mean of two unit states of polarisation; fields are scaled so that their square is the beam's power."""
    return 0.5 * float(np.sum(np.abs(fields) ** 2))


def _meet(d, fields, outward, where, walls):
    """What becomes of a beam at a wall: list of (where, direction, fields)."""
    normal = outward if where == "air" else -outward  # against d
    cos_i = -float(d @ normal)
    s = np.cross(d, normal)
    size = np.linalg.norm(s)
    s = s / size if size > 1e-12 else _basis(d)[:, 0].real
    p = np.cross(d, s)
    e_s, e_p = s @ fields, p @ fields

    def leaving(direction, a_s, a_p):
        return np.outer(s, a_s * e_s) + np.outer(np.cross(direction, s), a_p * e_p)

    mirrored = d + 2 * cos_i * normal
    if walls is None:
        return [(where, mirrored, leaving(mirrored, -1.0, 1.0))]
    n1, n2, films = (1.0, walls.n, walls.films) if where == "air" else (walls.n, 1.0, walls.films[::-1])
    (r_s, r_p), (t_s, t_p) = film_amplitudes(cos_i, n1, films, n2, 1.0)
    result = [(where, mirrored, leaving(mirrored, r_s, r_p))]
    if np.isreal(n2) and n1**2 * (1 - cos_i**2) < n2**2:
        cos_t = math.sqrt(1 - (n1 / n2) ** 2 * (1 - cos_i**2))
        refracted = n1 / n2 * d + (n1 / n2 * cos_i - cos_t) * normal
        result.append(("glass" if where == "air" else "air", refracted, leaving(refracted, t_s, t_p)))
    return result


def mirror_exits(slope, theta):
    """Exits of a mirror groove in its cross-plane: {(bounces, theta_r in degrees): share}.

    theta_r is negative on the source's side.
    """
    table = {}
    for leaving in groove(slope, theta):
        angle = math.degrees(math.atan2(leaving.direction[0], leaving.direction[2]))
        key = leaving.bounces, round(-angle, 6) + 0.0  # light comes from +x: its side counts negative
        table[key] = table.get(key, 0.0) + leaving.share
    return table


def turned(theta, measure, n_phi=256):
    """Mean over the groove's orientation of `measure(phi)`, as a measurement that turns the specimen sees it.

    Midpoint rule over a quarter turn, which symmetry makes the whole.
    """
    if theta == 0:
        n_phi = 1
    phi = (np.arange(n_phi) + 0.5) * (0.5 * math.pi / n_phi)
    return np.mean([measure(angle) for angle in phi], axis=0)


def albedo(slope, theta, phi, walls, up=True, bounces=None):
    """Share of unpolarised light that leaves upwards (or downwards), of all or of some number of bounces."""
    return sum(
        e.share * e.weight
        for e in groove(slope, theta, phi, walls)
        if (e.direction[2] > 0) == up and (bounces is None or e.bounces == bounces)
    )
