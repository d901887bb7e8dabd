"""Seeds of statistical tests, and one thread for the small matrices of the references."""

from __future__ import annotations

import pytest
from threadpoolctl import threadpool_limits

from tests.oracles.measuring import seed_of


@pytest.fixture
def seed(request):
    """Fixed by the test's name, never tuned."""
    return seed_of(request.node.name)


@pytest.fixture(autouse=True)
def _one_thread():
    """BLAS threads wait for each other longer than they work, on a busy machine tenfold."""
    with threadpool_limits(1, user_api="blas"):
        yield
