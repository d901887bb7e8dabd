from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def real() -> Path:
    """Measured materials and published fits of them, which lie beside the project and not in it."""
    root = Path(os.environ.get("GONIO_TEST_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
    for path in (root / "nbrdf" / "nbrdf_weights.npz", root / "merl_fits", root / "rgl", root / "ualoft"):
        if not path.exists():
            pytest.skip(f"{path} is not here; GONIO_TEST_DATA names the folder that holds it")
    return root
