"""Neural fits of measured materials (Sztrajman et al. 2021) as MERL files.

python -m tests.formats.nbrdf WEIGHTS.npz gold-metallic-paint OUT.binary
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from gonio.formats import merl


def decode(weights, name, wi, wo):
    """A MERL material of the neural fits at any directions, shape (N, 3)."""
    w = [weights[f"merl/{name}|{n}"] for n in range(6)]
    half = wi + wo
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    theta_h = np.arccos(np.clip(half[:, 2], -1, 1))
    phi_h = np.arctan2(half[:, 1], half[:, 0])
    x = np.cos(phi_h) * wi[:, 0] + np.sin(phi_h) * wi[:, 1]
    y = np.cos(phi_h) * wi[:, 1] - np.sin(phi_h) * wi[:, 0]
    turned = (
        np.cos(theta_h) * x - np.sin(theta_h) * wi[:, 2],
        y,
        np.sin(theta_h) * x + np.cos(theta_h) * wi[:, 2],
    )
    a = np.stack([np.sin(theta_h), np.zeros(len(wi)), np.cos(theta_h), *turned], axis=-1)
    a = np.maximum(a @ w[0] + w[1], 0)
    a = np.maximum(a @ w[2] + w[3], 0)
    return np.maximum(np.exp(a @ w[4] + w[5]) - 1, 0)


if __name__ == "__main__":
    source, material, target = sys.argv[1:]
    networks = np.load(source)
    merl.write_function(lambda wi, wo: decode(networks, material, wi, wo), Path(target))
