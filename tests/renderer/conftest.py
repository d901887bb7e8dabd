"""What tests of reports share."""

import pytest

from renderer import specimen_picture


@pytest.fixture
def small_pictures(monkeypatch):
    """Pictures of surfaces small and coarse, where their noise is not what is tested."""
    monkeypatch.setattr(specimen_picture, "_WIDTH", 96)
    monkeypatch.setattr(specimen_picture, "_HEIGHT", 72)
    monkeypatch.setattr(specimen_picture, "_SUN_SPP", 4)
    monkeypatch.setattr(specimen_picture, "_SKY_SPP", 4)
