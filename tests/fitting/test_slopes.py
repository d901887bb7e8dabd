"""Derivatives of every lobe by its shape parameters, against differences of the lobe itself."""

from __future__ import annotations

import numpy as np
import pytest

from fitting.models import LOBES
from fitting.models.dispatch import SIDE, lobe_side, lobe_slopes, lobe_terms, lobe_terms_of_sides

from .materials import polar

SEARCHED = [lobe for lobe in LOBES.values() if lobe.parameters and lobe.isotropic]


@pytest.mark.parametrize("lobe", SEARCHED, ids=lambda lobe: lobe.name)
def test_slopes_are_differences(lobe) -> None:
    rng = np.random.default_rng(1)
    for _ in range(12):
        shape = [q.from_unit(rng.uniform(0.4, 0.9)) for q in lobe.parameters]
        wi, wo = polar(rng.uniform(0, 85)), polar(rng.uniform(0, 85), rng.uniform(0, 180))
        p, tangents = (
            lobe.pack(dict(zip((q.name for q in lobe.parameters), shape, strict=True))),
            lobe.tangents(shape),
        )
        out = np.full(8, np.nan)
        values = lobe_terms(lobe.kind, p, wi, wo)
        sides = np.full((2, SIDE), np.nan)
        lobe_side(lobe.kind, p, tangents, wi, sides[0])
        lobe_side(lobe.kind, p, tangents, wo, sides[1])
        assert lobe_terms_of_sides(lobe.kind, p, wi, wo, *sides) == pytest.approx(values, rel=1e-14)
        lobe_slopes(lobe.kind, p, tangents, wi, wo, values, *sides, out)
        for j, q in enumerate(lobe.parameters):
            step = 1e-5 * shape[j]
            ends = []
            for sign in (1, -1):
                moved = list(shape)
                moved[j] += sign * step
                packed = lobe.pack(dict(zip((q.name for q in lobe.parameters), moved, strict=True)))
                ends.append(np.array(lobe_terms(lobe.kind, packed, wi, wo)))
            expected = (ends[0] - ends[1]) / (2 * step)
            found = out[2 * j : 2 * j + 2]
            assert found == pytest.approx(
                expected, rel=1e-5, abs=1e-7 * max(values) / abs(shape[j]) + 1e-300
            ), (q.name, shape)
