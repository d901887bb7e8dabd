"""Plane-parallel stacks of interfaces, scattering media and a base, by polarised adding-doubling.

Method: van de Hulst (1980), Multiple Light Scattering, chapters 4 and 7; polarised: Hovenier & van der Mee (1983);
refracting interfaces: de Haan, Bosma & Hovenier (1987), Prahl (1995). Nothing in it is random.

Three choices make it short:

- A direction is known by p = n sin(theta), which refraction leaves alone, and light by L/n^2, which it leaves alone
  too. Nodes in p then serve all media, and an interface is a diagonal matrix. An integral over directions is
  n^2 mu dmu = -p dp times L/n^2.
- Light is a Stokes vector in meridian frames, in Fourier modes of the azimuth: I and Q with cos(m phi), U and V
  with sin(m phi), phi between the directions of travel.
- An operator is D + K W: D what stays in its node (directly transmitted, mirrored), K the diffuse kernel, W the
  quadrature weights. Both are carried, so nodes of weight 0 sample the solution at any angle, as source or
  detector.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tests.oracles.fresnel import amplitudes, snell


class Nodes(NamedTuple):
    """Values of p and their weights p dp (0 at the angles asked for), and the Fourier mode of the azimuth."""

    p: np.ndarray
    w: np.ndarray
    mode: int

    @property
    def stokes(self):
        """Components carried: of mode 0, unpolarised light never lights U and V."""
        return 2 if self.mode == 0 else 4

    @property
    def weights(self):
        """Weights of all Stokes components."""
        return np.repeat(self.w, self.stokes)


def make_nodes(indices, angles_deg=(), edges_deg=(), per_segment=24, mode=0):
    """Nodes for a stack of media of these indices, light above it in the first.

    Parameters
    ----------
    indices : sequence of float
    angles_deg : sequence of float
        Angles in the first medium to sample; they come first, in this order. None is 0: p = 1e-9 stands for it.
    edges_deg : sequence of float
        Angles in the first medium where a quadrature may be cut: then sums over rings are exact.
    per_segment : int
        Gauss-Legendre nodes between two breaks.
    mode : int
    """
    breaks = {0.0, *map(float, indices), *(indices[0] * np.sin(np.radians(edges_deg)))}
    breaks = sorted(b for b in breaks if b <= max(indices) + 1e-12)
    breaks = [b for k, b in enumerate(breaks) if k == 0 or b - breaks[k - 1] > 1e-9]
    x, v = np.polynomial.legendre.leggauss(per_segment)
    p = [np.maximum(indices[0] * np.sin(np.radians(angles_deg)), 1e-9)]
    w = [np.zeros(len(angles_deg))]
    for low, high in pairwise(breaks):
        # in c = sqrt(high^2 - p^2), a cosine: nothing is singular where a medium's light grazes; p dp = c dc
        top = math.sqrt(high**2 - low**2)
        c = 0.5 * top * (x + 1)
        p.append(np.sqrt(high**2 - c**2))
        w.append(0.5 * top * v * c)
    return Nodes(np.concatenate(p), np.concatenate(w), mode)


@dataclass
class Operator:
    """D + K W on Stokes vectors at the N nodes; see the module.

    D is kept as its blocks, shape (N, S, S); K is (N S, N S), W is (N S,).
    """

    d: np.ndarray
    k: np.ndarray
    w: np.ndarray

    def __add__(self, other):
        return Operator(self.d + other.d, self.k + other.k, self.w)

    def __matmul__(self, other):
        k = _times(self.d, other.k) + _times(other.d.transpose(0, 2, 1), self.k.T).T
        return Operator(self.d @ other.d, k + (self.k * self.w) @ other.k, self.w)

    def resolvent(self):
        """(1 - self)^-1, the sum over all reflections to and fro."""
        n, stokes, _ = self.d.shape
        # light trapped in a clear medium by total reflection would go on for ever; none gets there from outside
        trapped = np.einsum("nii->ni", self.d) > 1 - 1e-12
        left = np.eye(stokes) * (1 + 1e-12 * trapped[:, :, None]) - self.d
        e = np.linalg.inv(left)
        whole = -self.k * self.w
        diagonal = np.arange(n)
        whole.reshape(n, stokes, n, stokes)[diagonal, :, diagonal, :] += left
        y = np.linalg.solve(whole, _times(e.transpose(0, 2, 1), self.k.T).T)
        return Operator(e, y, self.w)

    def from_below(self):
        """The same seen from below, of a layer that is its own mirror image: U and V change sign."""
        sign = np.array([1.0, 1.0, -1.0, -1.0])[: self.d.shape[1]]
        signs = np.tile(sign, len(self.d))
        return Operator(self.d * np.outer(sign, sign), self.k * np.outer(signs, signs), self.w)


def _times(blocks, matrix):
    """Block-diagonal times full."""
    n, stokes, _ = blocks.shape
    return (blocks @ matrix.reshape(n, stokes, -1)).reshape(n * stokes, -1)


@dataclass
class Slab:
    """What a part of a stack does to light from above and from below."""

    r: Operator
    t: Operator
    r_below: Operator
    t_below: Operator

    def over(self, other):
        """Put on top of another part: the adding equations."""
        down = (self.r_below @ other.r).resolvent() @ self.t
        up = (other.r @ self.r_below).resolvent() @ other.t_below
        return Slab(
            self.r + self.t_below @ other.r @ down,
            other.t @ down,
            other.r_below + other.t @ self.r_below @ up,
            self.t_below @ up,
        )


def _diagonal(nodes, blocks):
    size = len(nodes.weights)
    return Operator(blocks[:, : nodes.stokes, : nodes.stokes], np.zeros((size, size)), nodes.weights)


def _mueller(a_p, a_s):
    """Mueller matrices (I, Q = p minus s, U, V) of diagonal Jones matrices, shape (..., 4, 4)."""
    pp, ss, cross = np.abs(a_p) ** 2, np.abs(a_s) ** 2, a_p * np.conj(a_s)
    m = np.zeros((*np.shape(a_p), 4, 4))
    m[..., 0, 0] = m[..., 1, 1] = 0.5 * (pp + ss)
    m[..., 0, 1] = m[..., 1, 0] = 0.5 * (pp - ss)
    m[..., 2, 2] = m[..., 3, 3] = cross.real
    m[..., 2, 3], m[..., 3, 2] = -cross.imag, cross.imag
    return m


def interface(nodes, n_above, n_below):
    """Smooth interface of two dielectrics."""
    r, t, r_below, t_below = (np.zeros((len(nodes.p), 4, 4)) for _ in range(4))
    for k, p in enumerate(nodes.p):
        for n1, n2, reflected, transmitted in (
            (n_above, n_below, r, t),
            (n_below, n_above, r_below, t_below),
        ):
            if p >= n1:
                continue
            cos_i = math.sqrt(1 - (p / n1) ** 2)
            a_s, a_p = amplitudes(cos_i, n1, n2)
            reflected[k] = _mueller(a_p, a_s)
            if p < n2:
                cos_t = snell(cos_i, n1, n2)
                # intensity per area of the interface is 1 - R for each; amplitudes from 1 + r_s, n1/n2 (1 + r_p)
                root = np.sqrt(n2 * cos_t.real / (n1 * cos_i))
                transmitted[k] = _mueller(root * n1 / n2 * (1 + a_p), root * (1 + a_s))
    return Slab(*(_diagonal(nodes, blocks) for blocks in (r, t, r_below, t_below)))


def metal(nodes, n_above, n_below):
    """Smooth opaque base of a complex index."""
    r = np.zeros((len(nodes.p), 4, 4))
    for k, p in enumerate(nodes.p):
        if p < n_above:
            a_s, a_p = amplitudes(math.sqrt(1 - (p / n_above) ** 2), n_above, n_below)
            r[k] = _mueller(a_p, a_s)
    return _base(nodes, _diagonal(nodes, r))


def lambert(nodes, n_above, rho):
    """Lambertian base, which depolarises."""
    op = _diagonal(nodes, np.zeros((len(nodes.p), 4, 4)))
    if nodes.mode == 0:
        lit = (nodes.p < n_above).astype(float)
        op.k[0::2, 0::2] = 2 * rho / n_above**2 * np.outer(lit, lit)
    return _base(nodes, op)


def _base(nodes, r):
    nothing = _diagonal(nodes, np.zeros((len(nodes.p), 4, 4)))
    return Slab(r, nothing, nothing, nothing)


def clear(nodes, n, tau):
    """Medium that absorbs only."""
    mu = _cosines(nodes, n)
    with np.errstate(divide="ignore"):
        once = np.where(mu > 0, np.exp(-tau / np.where(mu > 0, mu, 1.0)), 0.0)
    through = _diagonal(nodes, once[:, None, None] * np.eye(4))
    nothing = _diagonal(nodes, np.zeros((len(nodes.p), 4, 4)))
    return Slab(nothing, through, nothing, through)


def medium(nodes, n, tau, albedo, phase):
    """Homogeneous scattering medium of index n.

    Parameters
    ----------
    tau : float
        Optical thickness along the normal.
    albedo : float
    phase : callable or None
        4 pi times the phase function of the cosine between directions of travel, for scattering that
        depolarises; None for Rayleigh's, by dipoles, polarised.
    """
    mu = _cosines(nodes, n)
    lit = mu > 0
    mu = np.where(lit, mu, 1.0)
    stokes = nodes.stokes
    z = _phase_mode(np.concatenate([-mu, mu]), phase, nodes.mode)  # first the light that goes down
    z = z[:, :stokes, :, :stokes].reshape(2 * len(mu) * stokes, -1)
    both = np.repeat(np.concatenate([lit, lit]), stokes)
    z = z * np.outer(both, both)
    m = np.repeat(np.concatenate([mu, mu]), stokes)
    w = np.concatenate([nodes.weights, nodes.weights])
    kernel = albedo / (4 * math.pi * n**2) * z / m  # d mu = p dp / (n^2 mu)

    # doubling from a layer so thin that the mean of the light at its faces (Wiscombe's diamond) is the light in it
    doublings = max(1, math.ceil(math.log2(tau / (2e-5 * mu[lit & (nodes.w > 0)].min()))))
    h = 0.5 * tau / 2**doublings
    e = 1.0 / (m + h)
    y = np.linalg.solve(np.diag(m + h) - h * kernel * w, h * kernel * e)
    k = h * e[:, None] * kernel + y * (m - h) + h * (y * w) @ kernel
    half = len(m) // 2
    down, up = slice(0, half), slice(half, None)
    straight = (e * (m - h) * both)[:half].reshape(-1, stokes, 1) * np.eye(stokes)
    # above, light comes in going down and leaves going up; the layer is its own mirror image, and stays so
    r = Operator(np.zeros_like(straight), k[up, down], nodes.weights)
    t = Operator(straight, k[down, down], nodes.weights)
    for _ in range(doublings):
        down_between = (r.from_below() @ r).resolvent() @ t
        r, t = r + t.from_below() @ (r @ down_between), t @ down_between
    return Slab(r, t, r.from_below(), t.from_below())


def _cosines(nodes, n):
    return np.sqrt(np.maximum(0.0, 1 - (nodes.p / n) ** 2))


def _phase_mode(mu, phase, mode):
    """Fourier mode of 4 pi times the phase matrix, integrated over azimuth: shape (M, 4, M, 4), [out, in]."""
    n_phi = 16 if phase is None else 512
    phi = 2 * math.pi * np.arange(n_phi) / n_phi
    cos_m, sin_m = np.cos(mode * phi) * 2 * math.pi / n_phi, np.sin(mode * phi) * 2 * math.pi / n_phi
    sine = np.sqrt(1 - mu**2)
    z = np.zeros((len(mu), 4, len(mu), 4))
    if phase is not None:  # depolarises
        one = sum(
            c * phase(np.clip(np.outer(mu, mu) + np.outer(sine, sine) * math.cos(angle), -1, 1))
            for angle, c in zip(phi, cos_m, strict=True)
        )
        z[:, 0, :, 0] = one
        return z
    for angle, c, s in zip(phi, cos_m, sin_m, strict=True):
        m = _dipole(mu, sine, angle)
        z[:, :2, :, :2] += m[:, :2, :, :2] * c
        z[:, 2:, :, 2:] += m[:, 2:, :, 2:] * c
        z[:, :2, :, 2:] -= m[:, :2, :, 2:] * s
        z[:, 2:, :, :2] += m[:, 2:, :, :2] * s
    return z


def _dipole(mu, sine, phi):
    """Rayleigh's phase matrix in meridian frames, mean 1 over the sphere: shape (M, 4, M, 4).

    A dipole radiates the projection of the field that drives it: the Jones matrix is made of the scalar
    products of the frames' axes (p along increasing theta, s along increasing phi), and of it the Mueller
    matrix.
    """
    zero = np.zeros_like(mu)
    # of the scattered light at azimuth phi, and of the incident at azimuth 0
    p_o = np.stack([mu * math.cos(phi), mu * math.sin(phi), -sine], axis=-1)
    s_o = np.stack([zero - math.sin(phi), zero + math.cos(phi), zero], axis=-1)
    p_i = np.stack([mu, zero, -sine], axis=-1)
    s_i = np.stack([zero, zero + 1, zero], axis=-1)
    pp, ps, sp, ss = p_o @ p_i.T, p_o @ s_i.T, s_o @ p_i.T, s_o @ s_i.T
    m = np.empty((len(mu), 4, len(mu), 4))
    m[:, 0, :, 0] = (pp**2 + ps**2 + sp**2 + ss**2) / 2
    m[:, 0, :, 1] = (pp**2 - ps**2 + sp**2 - ss**2) / 2
    m[:, 0, :, 2] = pp * ps + sp * ss
    m[:, 1, :, 0] = (pp**2 + ps**2 - sp**2 - ss**2) / 2
    m[:, 1, :, 1] = (pp**2 - ps**2 - sp**2 + ss**2) / 2
    m[:, 1, :, 2] = pp * ps - sp * ss
    m[:, 2, :, 0] = pp * sp + ps * ss
    m[:, 2, :, 1] = pp * sp - ps * ss
    m[:, 2, :, 2] = pp * ss + ps * sp
    m[:, 3, :, 3] = pp * ss - ps * sp
    m[:, 3, :, :3] = 0
    m[:, :3, :, 3] = 0
    return 1.5 * m


def albedo(operator, nodes, node):
    """Share of unpolarised light at a node that leaves, in all directions: DHR from `r`, DHT from `t`; mode 0."""
    return mirrored(operator, node) + nodes.w @ operator.k[0::2, 2 * node]


def mirrored(operator, node):
    """Share of unpolarised light that stays in its node: the delta term; mode 0."""
    return operator.d[node, 0, 0]


def brdf(kernels, out, source):
    """BRDF of unpolarised light, 1/sr, as a function of delta phi (radians).

    `kernels`: the operators of modes 0, 1, ...; `t` instead of `r` is light's basic radiance below: times the
    index there squared, it is the transmitted radiance. Delta phi is pi where light goes on in its azimuth.
    """
    modes = []
    for m, operator in enumerate(kernels):
        stokes = 2 if m == 0 else 4
        modes.append(float(operator.k[stokes * out, stokes * source]))

    def f(delta_phi):
        terms = [k * np.cos(m * (math.pi - delta_phi)) for m, k in enumerate(modes)]
        return terms[0] / (2 * math.pi) + sum(terms[1:]) / math.pi

    return f
