"""The benchmark's loop in Mitsuba: left out where it cannot run, and right where it can."""

from __future__ import annotations

import importlib.util
import os

import pytest

from gonio.bench import beside_mitsuba
from microgeometry.specimen import parse_specimen

SPEC = {
    "surface": {"kind": "gaussian", "alpha": 0.5, "samples": 32, "size": 8},
    "material": {"kind": "mirror"},
}


@pytest.fixture(scope="module")
def tile():
    return parse_specimen(SPEC).surface.realise(0)


def test_left_out_without_mitsuba(tile, monkeypatch):
    monkeypatch.delenv("MITSUBA_PYTHON", raising=False)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    lines = []
    assert beside_mitsuba.run(tile, {0: 1e6}, 1024, lines.append) is None
    assert "MITSUBA_PYTHON" in lines[-1]


def test_left_out_where_it_fails(tile, monkeypatch):
    monkeypatch.setenv("MITSUBA_PYTHON", "false")
    lines = []
    assert beside_mitsuba.run(tile, {0: 1e6}, 1024, lines.append) is None
    assert "LLVM 16 or later" in lines[-1]


@pytest.mark.skipif(
    "MITSUBA_PYTHON" not in os.environ, reason="MITSUBA_PYTHON names no Python with Mitsuba 3"
)
def test_it_loses_nothing_and_is_compared_angle_by_angle(tile):
    lines = []
    found = beside_mitsuba.run(tile, {0: 1e6, 60: 2e6}, 1 << 14, lines.append)
    if found is None:
        pytest.skip(f"the LLVM variant does not run here: {lines[-1]}")
    assert [angle["theta_i_deg"] for angle in found["angles"]] == [0, 60]
    for angle in found["angles"]:
        assert angle["mitsuba"]["albedo"] == pytest.approx(1.0, abs=1e-3)
        assert angle["ratio"] == pytest.approx(
            angle["paths_per_second"] / angle["mitsuba"]["paths_per_second"]
        )
