"""Where real measurements lie; tests that need them skip where they are absent."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

_BESIDE = Path(__file__).resolve().parents[3] / "shared" / "data"


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of real data: $GONIO_TEST_DATA, else shared/data beside the project."""
    folder = Path(os.environ.get("GONIO_TEST_DATA") or _BESIDE)
    if not folder.is_dir():
        pytest.skip(f"no real data at {folder}; set GONIO_TEST_DATA to their folder")
    return folder
