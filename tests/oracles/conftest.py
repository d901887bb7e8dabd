"""Seeds of statistical tests."""

from __future__ import annotations

import pytest

from tests.oracles.measuring import seed_of


@pytest.fixture
def seed(request):
    """Fixed by the test's name, never tuned."""
    return seed_of(request.node.name)
