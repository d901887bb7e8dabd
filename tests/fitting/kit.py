"""Lobes as the validation kit takes them, and their albedo."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fitting.models import LOBES
from fitting.models.dispatch import eval_many, pdf_many, sample_many
from gonio.validation import Report, validate


@dataclass(frozen=True)
class Kit:
    """A lobe's reflection, or its transmission if `through`, of light from above, or from `below`.

    All directions are turned up to the upper hemisphere.
    """

    name: str
    shape: dict[str, float]
    weights: tuple[float, float] = (1.0, 1.0)
    through: bool = False
    below: bool = False

    def eval(self, wi, wo):
        return self._upper(eval_many, wi, wo)[:, None]

    def pdf(self, wi, wo):
        return self._upper(pdf_many, wi, wo)

    def sample(self, wi, u):
        lobe = LOBES[self.name]
        wi_side, wo_side = self._sides
        drawn = sample_many(lobe.kind, self._packed, wi * wi_side, np.ascontiguousarray(u[:, :2]))
        wo = drawn * wo_side
        return wo, self.pdf(wi, wo)

    def validate(self, theta_i: tuple[float, ...], n: int) -> Report:
        return validate(
            self.eval,
            self.sample,
            self.pdf,
            f"{self.name} {self.shape} {self.through} {self.below}",
            theta_i,
            n,
            reciprocal=not self.through,
            isotropic=LOBES[self.name].isotropic,
        )

    @property
    def _sides(self):
        return (
            np.array([1.0, 1.0, -1.0 if self.below else 1.0]),
            np.array([1.0, 1.0, -1.0 if self.below != self.through else 1.0]),
        )

    @property
    def _packed(self):
        return LOBES[self.name].pack(self.shape, self.weights)

    def _upper(self, function, wi, wo):
        wi, wo = np.broadcast_arrays(np.asarray(wi, float), np.asarray(wo, float))
        wi, wo = wi.reshape(-1, 3), wo.reshape(-1, 3)
        wi_side, wo_side = self._sides
        values = function(
            LOBES[self.name].kind,
            self._packed,
            wi * wi_side,
            wo * wo_side,
        )
        return np.where((wi[:, 2] > 0) & (wo[:, 2] > 0), values, 0.0)


def albedo(
    name: str,
    shape: dict[str, float],
    theta_i: float,
    weights: tuple[float, float] = (1.0, 1.0),
    through: bool = False,
    nodes: int = 400,
) -> float:
    """Directional albedo of a lobe (its transmittance if `through`) by Gauss quadrature; theta_i in degrees."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    theta, phi = 0.25 * np.pi * (x + 1.0), 0.5 * np.pi * (x + 1.0)
    t, f = np.meshgrid(theta, phi, indexing="ij")
    wo = np.stack([np.sin(t) * np.cos(f), np.sin(t) * np.sin(f), np.cos(t)], axis=-1).reshape(-1, 3)
    angle = math.radians(theta_i)
    values = Kit(name, shape, weights, through).eval([[-math.sin(angle), 0.0, math.cos(angle)]], wo)
    cosines = np.cos(theta) * np.sin(theta) * w
    return float(np.einsum("tf,t,f->", values.reshape(nodes, nodes), cosines, w)) * 0.25 * np.pi**2
