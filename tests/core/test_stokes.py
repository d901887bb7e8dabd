"""Stokes vectors against Jones vectors and against 3 x 3 polarisation ray tracing.

The referee carries the field itself, a complex 3-vector, through the same interfaces by
P = r_s s s^T + r_p p' p^T (Yun, Crabtree & Chipman 2011, "Three-dimensional polarization ray-tracing
calculus I"), with Fresnel's formulas written out here.
"""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest

from gonio.core.films import film_amplitudes
from gonio.core.optics import fresnel_amplitudes, fresnel_transmission, refract
from gonio.core.phase import RAYLEIGH, phase_value, rayleigh_polarisation
from gonio.core.stokes import mueller, perpendicular, rotation

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
UNPOLARISED = (1.0, 0.0, 0.0, 0.0)
POLARISER = (1.0, 0.0, 0.0)  # passes s


def unit(v):
    return np.asarray(v, float) / np.linalg.norm(v)


def stokes_of(field, e, d):
    """(I, Q, U, V) of a complex field vector."""
    one, two = field @ e, field @ np.cross(d, e)
    return (*(abs(one) ** 2 + abs(two) ** 2 * np.array([1, -1])), *_parts(2 * one * two.conjugate()))


def _parts(z):
    return z.real, z.imag


def rotate(q, u, e, d, e_new):
    """Q and U against another axis, as `rotation` says."""
    c, s = rotation(e, d, e_new)
    return c * q + s * u, c * u - s * q


def turned(stokes, e, d, e_new):
    i, q, u, v = stokes
    return (i, *rotate(q, u, tuple(e), tuple(d), tuple(e_new)), v)


def reflected(stokes, e, d, n, eta, k):
    """Stokes vector, axis and direction after a mirror, by the kernels."""
    s = perpendicular(tuple(d), tuple(n))
    r_s, r_p = fresnel_amplitudes(-float(np.dot(d, n)), eta, k)
    after = mueller(*turned(stokes, e, d, s), abs(r_s) ** 2, abs(r_p) ** 2, r_s * r_p.conjugate())
    return after, s, d - 2 * np.dot(d, n) * n


def field_reflected(field, d, n, eta, k):
    """The same for the field itself."""
    s = unit(np.cross(d, n))
    out = d - 2 * (d @ n) * n
    cosine, index = -(d @ n), complex(eta, k)
    q = cmath.sqrt(index**2 - (1 - cosine**2) + 0j)
    r_s = (cosine - q) / (cosine + q)
    r_p = (index**2 * cosine - q) / (index**2 * cosine + q)
    return r_s * (s @ field) * s + r_p * (np.cross(d, s) @ field) * np.cross(out, s), out


def field_refracted(field, d, n, eta):
    """Beyond a lossless interface, scaled so that |field|^2 is power."""
    s = unit(np.cross(d, n))
    cosine = -(d @ n)
    cos_t = math.sqrt(1 - (1 - cosine**2) / eta**2)
    out = d / eta + (cosine / eta - cos_t) * n
    t_s = 2 * cosine / (cosine + eta * cos_t)
    t_p = 2 * cosine / (eta * cosine + cos_t)
    field = t_s * (s @ field) * s + t_p * (np.cross(d, s) @ field) * np.cross(out, s)
    return field * math.sqrt(eta * cos_t / cosine), out


def test_rotation_by_hand():
    # linear at 30 degrees to x: against an axis at 30 degrees it is all Q
    psi = math.radians(30)
    e_new = (math.cos(psi), math.sin(psi), 0.0)
    assert rotate(math.cos(2 * psi), math.sin(2 * psi), X, Z, e_new) == pytest.approx((1.0, 0.0), abs=1e-15)
    # seen along -z, the same axis stands at -30 degrees, so x-polarised light is at +30 of it
    assert rotate(1.0, 0.0, X, (0.0, 0.0, -1.0), e_new) == pytest.approx((0.5, math.sqrt(0.75)), abs=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, math.pi / 4, math.pi / 2, 2.0, math.pi])
def test_rotation_there_and_back(angle):
    d = unit([1, 2, -2])
    e = unit([2, -1, 0])
    e_new = math.cos(angle) * e + math.sin(angle) * np.cross(d, e)
    q, u = rotate(0.3, -0.7, tuple(e), tuple(d), tuple(e_new))
    assert q * q + u * u == pytest.approx(0.3**2 + 0.7**2, rel=1e-14)  # the degree of polarisation
    assert rotate(q, u, tuple(e_new), tuple(d), tuple(e)) == pytest.approx((0.3, -0.7), abs=1e-15)


def test_rotation_keeps_polarisation_on_axes_rounded_to_single_precision():
    e_new = tuple(1.0000002 * np.array([0.6, 0.8, 1e-7]))
    q, u = rotate(0.3, -0.7, X, Z, e_new)
    assert q * q + u * u == pytest.approx(0.3**2 + 0.7**2, rel=1e-14)


@pytest.mark.parametrize("degrees", [0, 20, 45, 70, 90])
def test_malus(degrees):
    """Behind two polarisers at an angle a: I cos^2(a) / 2, and a third at 45 between crossed ones lets 1/8 pass."""
    a = math.radians(degrees)
    light = mueller(*UNPOLARISED, *POLARISER)
    assert light == (0.5, 0.5, 0.0, 0.0)
    axis = (math.cos(a), math.sin(a), 0.0)
    light = mueller(*turned(light, X, Z, axis), *POLARISER)
    assert light[0] == pytest.approx(0.5 * math.cos(a) ** 2, abs=1e-16)
    light = mueller(*turned(light, axis, Z, Y), *POLARISER)
    assert light[0] == pytest.approx(0.5 * math.cos(a) ** 2 * math.sin(a) ** 2, abs=1e-16)


def test_mueller_is_the_jones_matrix():
    rng = np.random.default_rng(3)
    for _ in range(100):
        e_s, e_p, a_s, a_p = rng.normal(size=4) + 1j * rng.normal(size=4)
        before = stokes_of(e_s * np.array(X) + e_p * np.array(Y), X, Z)
        after = stokes_of(a_s * e_s * np.array(X) + a_p * e_p * np.array(Y), X, Z)
        intensities = abs(a_s) ** 2, abs(a_p) ** 2
        assert mueller(*before, *intensities, a_s * a_p.conjugate()) == pytest.approx(after, abs=1e-13)


def test_positive_v_turns_clockwise_for_who_faces_the_source():
    # a quarter-wave plate with a_p = -i makes E = (1, -i) of light at 45 degrees
    assert mueller(2.0, 0.0, 2.0, 0.0, 1.0, 1.0, (-1j).conjugate()) == (2.0, 0.0, 0.0, 2.0)
    # exp(-i omega t) turns (1, -i) from +x to -y: seen from +z, where the light goes, with x to the right, clockwise
    later = (np.array([1.0, -1j]) * cmath.exp(-0.1j)).real
    assert later == pytest.approx([math.cos(0.1), -math.sin(0.1)])


@pytest.mark.parametrize(
    ("d", "n"),
    [
        (Z, (0.0, 0.0, -1.0)),
        ((0.0, 0.0, -1.0), Z),
        ((0.6, 0.0, -0.8), (-0.6, 0.0, 0.8)),
        ((1e-12, 0.0, -1.0), Z),
        ((1e-9, 0.0, -1.0), Z),
        ((0.48, 0.64, -0.6), Z),
    ],
)
def test_perpendicular(d, n):
    s = perpendicular(d, n)
    assert np.linalg.norm(s) == pytest.approx(1.0, abs=1e-15)
    assert np.dot(s, d) == pytest.approx(0.0, abs=1e-11)
    assert np.dot(s, n) == pytest.approx(0.0, abs=1e-11)
    if np.linalg.norm(np.cross(d, n)) > 1e-9:
        assert s == pytest.approx(tuple(unit(np.cross(d, n))), abs=1e-15)


def test_right_angle_groove_of_glass():
    """Two reflections at 45 degrees, n = 1.5: (R_s^2 + R_p^2)/2 = .004269, where (R_s + R_p)^2/4 is .002524."""
    light, e, d = UNPOLARISED, np.array(X), np.array([0.0, 0.0, -1.0])
    for n in (unit([1, 0, 1]), unit([-1, 0, 1])):
        light, e, d = reflected(light, e, d, n, 1.5, 0.0)
    assert d == pytest.approx([0.0, 0.0, 1.0], abs=1e-15)
    assert light[0] == pytest.approx(0.004269, abs=5e-7)
    assert light[0] == pytest.approx(0.5 * (0.0920133**2 + 0.0084664**2), rel=1e-4)


def test_fresnel_rhomb():
    """Two total reflections at 54 degrees 37 in n = 1.51 turn light at 45 degrees circular (Born & Wolf, 1.5.4)."""
    theta = math.radians(54 + 37 / 60)
    r_s, r_p = fresnel_amplitudes(math.cos(theta), 1 / 1.51, 0.0)
    light = (1.0, 0.0, 1.0, 0.0)
    for _ in range(2):
        light = mueller(*light, abs(r_s) ** 2, abs(r_p) ** 2, r_s * r_p.conjugate())
    # delta_p - delta_s = -45 degrees each: r_s r_p* turns U by +45 and, r_p being opposite, by 180
    assert light == pytest.approx((1.0, 0.0, 0.0, 1.0), abs=2e-3)


HELIX = {
    "metals": [(0.2, 3.4), (1.1, 6.8), (2.9, 3.1)],
    "total reflections": [(1 / 1.5, 0.0), (1 / 1.5, 0.0), (1 / 2.4, 0.0)],
    "glass": [(1.5, 0.0), (0.8, 0.0), (1.33, 0.0)],
    "mixed": [(1 / 1.5, 0.0), (0.2, 3.4), (1.5, 0.01)],
}


@pytest.mark.parametrize("field", [(1.0, 0.0), (1.0, 1.0), (1.0, 1j), (0.3 - 0.2j, 0.9j)], ids=str)
@pytest.mark.parametrize("mirrors", HELIX.values(), ids=HELIX.keys())
def test_three_mirrors_in_a_helix(mirrors, field):
    """Each plane of incidence is turned against the last one: frames, phases and signs all at once."""
    # directions of a helix, one turn in four steps, and the normals halfway between them
    directions = [unit([math.cos(1.5 * j), math.sin(1.5 * j), 0.4]) for j in range(4)]
    d, e = directions[0], unit(np.cross(directions[0], [0.1, -0.7, 0.3]))
    vector = field[0] * e + field[1] * np.cross(d, e)
    light, out = stokes_of(vector, e, d), d
    for (eta, k), after in zip(mirrors, directions[1:], strict=True):
        n = unit(after - out)
        light, e, d = reflected(light, e, out, n, eta, k)
        vector, out = field_reflected(vector, out, n, eta, k)
        assert out == pytest.approx(after, abs=1e-15)
    axis = unit(np.cross(d, [0.9, 0.1, -0.2]))
    assert turned(light, e, d, axis) == pytest.approx(stokes_of(vector, axis, d), abs=1e-14)
    # one pure state stays one: nothing depolarises
    assert light[0] ** 2 == pytest.approx(sum(x * x for x in light[1:]), rel=1e-12)
    if all(k == 0 and eta < 0.7 for eta, k in mirrors):
        assert light[0] == pytest.approx(abs(field[0]) ** 2 + abs(field[1]) ** 2, rel=1e-14)


def test_through_a_prism():
    """In by one face, totally reflected by the second, out by the third, in three different planes."""
    e, d = np.array(X), np.array([0.0, 0.0, -1.0])
    vector = 0.6 * e + 0.8j * np.cross(d, e)
    light, out = stokes_of(vector, e, d), d
    faces = [
        (unit([0.3, 0.2, 1.0]), 1.5),
        (unit([1.0, 0.0, 0.9]), 1 / 1.5),
        (unit([-0.9, 0.5, -0.1]), 1 / 1.5),
    ]
    for n, eta in faces:
        s = perpendicular(tuple(d), tuple(n))
        beyond, cos_t = refract(tuple(d), tuple(n), eta)
        if cos_t == 0.0:
            light, e, d = reflected(light, e, d, n, eta, 0.0)
            vector, out = field_reflected(vector, out, n, eta, 0.0)
        else:
            light = mueller(*turned(light, e, d, s), *fresnel_transmission(-float(d @ n), eta))
            e, d = s, np.array(beyond)
            vector, out = field_refracted(vector, out, n, eta)
        assert d == pytest.approx(out, abs=1e-15)
    assert cos_t > 0.0  # out again
    axis = unit(np.cross(d, [0.9, 0.1, -0.2]))
    assert turned(light, e, d, axis) == pytest.approx(stokes_of(vector, axis, d), abs=1e-14)


def test_coated_glass_in_reflection_and_transmission():
    """The same with a film's amplitudes; the referee sums the partial waves of the film (Airy)."""
    n_film, n_below, d, wavelength, cosine = 2.1, 1.5, 83e-9, 550e-9, 0.55
    sine = math.sqrt(1 - cosine**2)
    cos_film, cos_below = (math.sqrt(1 - (sine / n) ** 2) for n in (n_film, n_below))
    turn = cmath.exp(2j * math.pi * n_film * cos_film * d / wavelength)

    def partial_waves(r, t):
        """Amplitudes of the stack from r(n1, c1, n2, c2) and t(...) of one interface."""
        top, bottom = (1.0, cosine, n_film, cos_film), (n_film, cos_film, n_below, cos_below)
        under = (n_film, cos_film, 1.0, cosine)
        through, back = 0j, r(*top)
        wave = t(*top)
        for _ in range(200):
            wave *= turn
            through += wave * t(*bottom)
            wave *= r(*bottom) * turn
            back += wave * t(*under)
            wave *= r(*under)
        return back, through

    r_s, t_s = partial_waves(
        lambda n1, c1, n2, c2: (n1 * c1 - n2 * c2) / (n1 * c1 + n2 * c2),
        lambda n1, c1, n2, c2: 2 * n1 * c1 / (n1 * c1 + n2 * c2),
    )
    r_p, t_p = partial_waves(
        lambda n1, c1, n2, c2: (n2 * c1 - n1 * c2) / (n2 * c1 + n1 * c2),
        lambda n1, c1, n2, c2: 2 * n1 * c1 / (n2 * c1 + n1 * c2),
    )
    power = n_below * cos_below / cosine
    films = np.array([[n_film, 0.0]]), np.array([d])
    k_s, k_p, power_s, power_p, cross = film_amplitudes(cosine, 1.0, *films, n_below, 0.0, wavelength)
    field = np.array([0.5 + 0.1j, -0.3j])
    before = stokes_of(np.array([*field, 0]), X, Z)
    for jones, factors in (
        (np.array([r_s, r_p]), (abs(k_s) ** 2, abs(k_p) ** 2, k_s * k_p.conjugate())),
        (math.sqrt(power) * np.array([t_s, t_p]), (power_s, power_p, cross)),
    ):
        assert mueller(*before, *factors) == pytest.approx(
            stokes_of(np.array([*(jones * field), 0]), X, Z), abs=1e-14
        )


def test_rayleigh_scattering_is_the_dipole():
    """The field of a dipole is that part of E that is perpendicular to the new direction: 3/(8 pi) |E_perp|^2."""
    rng = np.random.default_rng(5)
    nothing = np.empty(0)
    for _ in range(100):
        d, out = unit(rng.normal(size=3)), unit(rng.normal(size=3))
        e = unit(np.cross(d, rng.normal(size=3)))
        one, two = rng.normal(size=2) + 1j * rng.normal(size=2)
        vector = one * e + two * np.cross(d, e)
        s = perpendicular(tuple(d), tuple(out))
        cosine = float(d @ out)
        light = mueller(*turned(stokes_of(vector, e, d), e, d, s), *rayleigh_polarisation(cosine))
        light = phase_value(RAYLEIGH, 0.0, nothing, nothing, cosine) * np.array(light)
        dipole = vector - (out @ vector) * out
        assert light == pytest.approx(3 / (8 * math.pi) * np.array(stokes_of(dipole, s, out)), abs=1e-14)
    # a quarter turn polarises all of the light, whatever it was
    assert mueller(*UNPOLARISED, *rayleigh_polarisation(0.0)) == (1.0, 1.0, 0.0, 0.0)
