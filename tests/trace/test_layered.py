"""Layered transport where it stops: caps, and what the ledger says then."""

from __future__ import annotations

import math

import pytest

from gonio.trace.measure import measure
from gonio.trace.tracer import MAX_SCATTERINGS
from microgeometry.specimen import parse_specimen


@pytest.mark.slow
@pytest.mark.compiled
def test_light_that_scatters_without_end_is_cut_off_and_not_lost():
    """In a white half-space n scatterings leave a share of about 1/sqrt(n) inside: all else comes back."""
    medium = {"sigma_s": 1.0, "thickness": math.inf}
    specimen = parse_specimen({
        "layer": [{"surface": {"kind": "flat"}, "material": {"kind": "none"}, "medium": medium}],
        "grid": {"theta_i_deg": [0], "theta_step_deg": 15, "phi_step_deg": 30},
    })  # fmt: skip
    ledger = measure(specimen, rays=10_000).ledger
    paths = ledger["paths"]
    assert ledger["lost"] == 0
    assert ledger["reflected"] + ledger["killed"] == pytest.approx(paths, rel=1e-12)
    # H(1) / sqrt(pi n) for light from above (Chandrasekhar's H(1) = 2.9078), within four standard errors
    expected = 2.9078 / math.sqrt(math.pi * MAX_SCATTERINGS)
    assert abs(ledger["killed"] / paths - expected) < 4 * math.sqrt(expected / paths)
