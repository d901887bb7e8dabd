from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from microgeometry.specimen import Specimen, parse_specimen


@pytest.fixture
def topography_dir() -> Path:
    """Folder of real height maps, which are not part of the project."""
    beside = Path(__file__).resolve().parents[2].parent / "shared" / "data"
    folder = Path(os.environ.get("GONIO_TEST_DATA", beside)) / "topography"
    if not folder.is_dir():
        pytest.skip(f"no real height maps at {folder}; GONIO_TEST_DATA names the folder above")
    return folder


@pytest.fixture
def specimen_of(tmp_path):
    """Build a specimen from the keys of [surface], files relative to tmp_path."""

    def build(kind: str, folder: Path = tmp_path, **keys) -> Specimen:
        return parse_specimen({"surface": {"kind": kind, **keys}, "material": {"kind": "mirror"}}, folder)

    return build


@pytest.fixture
def tile_of(specimen_of):
    """Build a surface from its keys and realise it."""

    def build(kind: str, seed: int = 0, **keys):
        return specimen_of(kind, **keys).surface.realise(seed)

    return build


def z_score(values, expected):
    """Distance of the mean from its expected value in standard errors, and the relative standard error."""
    values = np.asarray(values)
    std_error = values.std(ddof=1) / np.sqrt(len(values))
    return abs(values.mean() - expected) / std_error, std_error / expected
