"""Measuring specimens for the tests, and judging tables by their own error bars."""

from __future__ import annotations

import math
import zlib

import numpy as np
from scipy import stats

from gonio.trace.measure import measure
from microgeometry.specimen import parse_specimen

COARSE = {"theta_step_deg": 15, "phi_step_deg": 30}
FLAT = {"kind": "flat"}
NONE = {"kind": "none"}
MIRROR = {"kind": "mirror"}
BLACK = {"kind": "black"}
INF = math.inf

# One correction for multiple comparisons over all tests of this package: they compare about this many numbers,
# and all together may fail by chance once in a thousand runs.
COMPARISONS = 20_000
SMALLEST_P = 1e-3 / COMPARISONS


def glass(eta=1.5):
    return {"kind": "dielectric", "eta": eta}


def lambert(albedo):
    return {"kind": "lambert", "albedo": albedo}


def gaussian(alpha, samples=64, size=8, **keys):
    return {"kind": "gaussian", "alpha": alpha, "samples": samples, "size": size, **keys}


def groove(slope_deg, **keys):
    return {"kind": "v_groove", "slope_deg": slope_deg, **keys}


def layer(surface, material, **medium):
    """A [[layer]] table; with keywords, of a medium."""
    table = {"surface": surface, "material": material}
    return {**table, "medium": medium} if medium else table


def trace(layers, rays, seed, folder=".", **grid):
    """Table of a list of layers, or of one, by the estimator that assumes nothing."""
    layers = [layers] if isinstance(layers, dict) else layers
    specimen = parse_specimen({"layer": layers, "grid": {**COARSE, **grid}}, folder)
    return measure(specimen, rays=rays, seed=seed, estimator="analog")


def seed_of(name):
    """Seed fixed by a test's name, and never tuned."""
    return zlib.crc32(name.encode())


def agrees(measured, std_error, expected, batches, precision=None):
    """Assert that measured numbers scatter about the expected ones as their error bars say.

    A mean over b batches follows Student's t of b - 1 degrees of freedom. A number with no scatter (all batches
    equal) must be exact to 1e-9.

    Parameters
    ----------
    measured, std_error : array_like
    expected : array_like
    batches : int
    precision : float, optional
        The error bars themselves must not exceed this: or else the test could not fail.
    """
    measured, std_error = np.broadcast_arrays(np.asarray(measured, float), np.asarray(std_error, float))
    deviation = measured - np.broadcast_to(np.asarray(expected, float), measured.shape)
    assert np.isfinite(measured).all()
    exact = std_error < 1e-12
    assert np.all(np.abs(deviation[exact]) <= 1e-9), (
        f"no scatter, yet off by {np.abs(deviation[exact]).max():.3g}"
    )
    if precision is not None:
        assert std_error.max() <= precision, f"error bars up to {std_error.max():.3g}: the test is too weak"
    if exact.all():
        return
    z = deviation[~exact] / std_error[~exact]
    p = 2 * stats.t.sf(np.abs(z), batches - 1)
    worst = int(np.argmin(p))
    assert p[worst] > SMALLEST_P, (
        f"{np.count_nonzero(p < SMALLEST_P)} of {z.size} numbers off; the worst by {z[worst]:.1f} sigma: measured "
        f"{measured[~exact][worst]:.6g} +- {std_error[~exact][worst]:.2g}, expected "
        f"{(measured - deviation)[~exact][worst]:.6g}"
    )


def agrees_albedo(table, expected, precision=None, channel=0):
    """Assert the directional albedo of every row of a table, or of a part of one (shape (rows,))."""
    agrees(
        table.row_albedo[:, channel],
        table.albedo_std_error[:, channel],
        expected,
        batches_of(table),
        precision,
    )


def agrees_cells(table, expected, min_hits=200, channel=0, where=None):
    """Assert cell values against an array, or a number; cells of few hits have no Gaussian error and are left out."""
    expected = np.broadcast_to(np.asarray(expected, float), table.values.shape[:3])
    chosen = table.hits >= min_hits
    if where is not None:
        chosen = chosen & where
    assert chosen.any()
    agrees(
        table.values[..., channel][chosen],
        table.std_error[..., channel][chosen],
        expected[chosen],
        batches_of(table),
    )


def batches_of(table):
    """Batches behind the error bars; parts of a table do not say: at least 32."""
    return table.provenance.get("batches", 32)


def ledger_adds_up(table):
    """Assert that every path's energy is in the ledger, and every absorbed part in its column."""
    ledger = table.ledger
    ends = sum(ledger[name] for name in ("reflected", "transmitted", "absorbed", "killed", "lost"))
    assert math.isclose(ends, ledger["paths"], rel_tol=1e-11), (ends, ledger["paths"])
    parts = [energy for name, energy in ledger.items() if name.startswith("absorbed:")]
    if parts:
        assert math.isclose(sum(parts), ledger["absorbed"], rel_tol=1e-9, abs_tol=1e-9 * ledger["paths"])
    # as the instrument itself allows: a path that meets a crease may be lost to rounding
    assert ledger["lost"] <= max(1.0, 1e-6 * ledger["paths"])


def keeps_all_light(table, trapped=0.0):
    """Assert that everything leaves, above or below, in every row: each path keeps its whole weight.

    `trapped` is the share of paths that may still be bouncing at the cap: total reflection between the flat
    facets of a glass prism holds some for as long as one follows them.
    """
    ledger_adds_up(table)
    killed, paths = table.ledger["killed"], table.ledger["paths"]
    assert killed <= trapped * paths, f"{killed:.0f} of {paths:.0f} paths were cut off by the cap on bounces"
    total = table.row_albedo.copy()
    if "transmission" in table.parts:
        total += table.parts["transmission"].row_albedo
    missing = (table.ledger["lost"] + killed) * len(total) / paths
    assert np.abs(total - 1.0).max() <= 1e-9 + missing, total
    assert abs(table.ledger["absorbed"]) <= 1e-6


def cell_means(f, table, points=4, row=0):
    """Mean of a BRDF f(mu_i, mu_o, delta_phi) over every cell of a row, weighted by projected solid angle."""
    mu_i = math.cos(table.theta_i[row])
    x, w = np.polynomial.legendre.leggauss(points)
    x, w = 0.5 * (x + 1), 0.5 * w
    sin2 = np.sin(table.theta_r_edges) ** 2
    s = sin2[:-1, None] + np.diff(sin2)[:, None] * x  # uniform in sin^2 is uniform in projected solid angle
    phi = table.delta_phi_edges[:-1, None] + np.diff(table.delta_phi_edges)[:, None] * x
    mu_o = np.sqrt(1 - s)
    values = f(mu_i, mu_o[:, :, None, None], phi[None, None])
    values = np.broadcast_to(values, (*mu_o.shape, *phi.shape))
    return np.einsum("rapb,a,b->rp", values, w, w)
