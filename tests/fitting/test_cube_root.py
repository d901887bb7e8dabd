"""The cube root beside the C library's, over all that a double can hold."""

from __future__ import annotations

import numpy as np
import pytest

from fitting.cube_root import cube_root


@pytest.mark.parametrize("exponents", [(-323, -285), (-285, 0), (0, 308)])
def test_it_is_the_cube_root_to_the_last_digits(exponents: tuple[int, int]) -> None:
    x = 10.0 ** np.random.default_rng(0).uniform(*exponents, 2000)
    assert np.array([cube_root(float(v)) for v in x]) == pytest.approx(np.cbrt(x), rel=1e-14, abs=0.0)


def test_cubes_and_zero() -> None:
    assert [cube_root(float(n**3)) for n in range(5)] == pytest.approx([0, 1, 2, 3, 4], rel=1e-14, abs=0.0)
    assert cube_root(0.0) == 0.0
    assert cube_root(-8.0) == pytest.approx(-2.0)
