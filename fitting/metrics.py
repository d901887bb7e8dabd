"""How far a model is from measured values, under every customary metric."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitting.samples import Samples
from microgeometry.errors import InputError

Array = NDArray[np.float64]

OBJECTIVES = ("chi2", "ngan_l2")
"""What a fit can minimise."""


def weights(samples: Samples, objective: str) -> Array:
    """Weight of every squared error e^2 in the objective, shape (N, C).

    chi2: 1/variance. ngan_l2: cos_i^2 sin_i sin_o (Ngan, Durand, Matusik 2005).
    """
    if objective == "chi2":
        if samples.variance is None:
            raise InputError("objective: chi2 needs the table's standard errors and it has none; use ngan_l2")
        return 1.0 / samples.variance
    if objective == "ngan_l2":
        w = samples.cos_i**2 * samples.sin_i * samples.sin_o
        return np.repeat(w[:, None], samples.values.shape[1], axis=1)
    raise InputError(f"objective: {objective!r}; {' or '.join(OBJECTIVES)} is allowed")


def metrics(samples: Samples, model: Array) -> dict[str, float]:
    """Every metric of a model on the same cells; all sums run over cells and channels.

    Parameters
    ----------
    samples : Samples
    model : ndarray, shape (N, C)
        Fitted f_r in 1/sr.

    Returns
    -------
    dict of str to float
        With f measured, g fitted, e = f - g:

        - ngan_l2: sum (e cos_i)^2 sin_i sin_o (Ngan et al. 2005)
        - relative_ngan_l2: the root of ngan_l2 over the same sum with f for e; cosine-weighted RMSE
          relative to the measurement's, 0 where all values are 0
        - low_log: sum (ln(1 + f cos_i) - ln(1 + g cos_i))^2 sin_i (Low et al. 2012)
        - nbrdf: mean |ln(1 + f cos_i) - ln(1 + g cos_i)|
        - cube_root: RMS difference of (f cos_i)^(1/3) (Fores et al. 2012)
        - chi2: sum e^2/variance; only where errors are known
    """
    f = samples.values * samples.cos_i[:, None]
    g = model * samples.cos_i[:, None]
    w = (samples.sin_i * samples.sin_o)[:, None]
    ngan = float(np.sum(w * (f - g) ** 2))
    norm = float(np.sum(w * f**2))
    # noise and interpolation leave values just below 0, where the logarithm and the root mean nothing
    f, g = np.maximum(f, 0.0), np.maximum(g, 0.0)
    log = np.log1p(f) - np.log1p(g)
    out = {
        "ngan_l2": ngan,
        "relative_ngan_l2": float(np.sqrt(ngan / norm)) if norm > 0 else 0.0,
        "low_log": float(np.sum(log**2 * samples.sin_i[:, None])),
        "nbrdf": float(np.mean(np.abs(log))),
        "cube_root": float(np.sqrt(np.mean((np.cbrt(f) - np.cbrt(g)) ** 2))),
    }
    if samples.variance is not None:
        out["chi2"] = float(np.sum((samples.values - model) ** 2 / samples.variance))
    return out
