from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def nbrdf() -> Path:
    """Neural fits of measured materials, which lie beside the project and not in it."""
    root = Path(os.environ.get("GONIO_TEST_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
    path = root / "nbrdf" / "nbrdf_weights.npz"
    if not path.exists():
        pytest.skip(f"{path} is not here; GONIO_TEST_DATA names the folder that holds nbrdf/")
    return path
