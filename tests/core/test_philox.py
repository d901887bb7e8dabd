"""Philox4x32-10 against the known answers published with it (Random123, kat_vectors)."""

from __future__ import annotations

import pytest

from gonio.core.philox import philox4x32, uniforms, unit

ONES = 0xFFFFFFFF


@pytest.mark.parametrize(
    ("counter", "key", "answer"),
    [
        ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        ((ONES,) * 4, (ONES,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xA4093822, 0x299F31D0),
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_published_vectors(counter, key, answer):
    assert tuple(int(x) for x in philox4x32(*counter, *key)) == answer


def test_numbers_are_inside_the_open_interval():
    assert unit(0) == 0.5 / 2**32
    assert unit(2**32 - 1) == 1 - 0.5 / 2**32


def test_every_word_of_counter_and_key_matters():
    base = uniforms(1, 2, 3, 4, 5, 6)
    for place in range(6):
        words = [1, 2, 3, 4, 5, 6]
        words[place] += 1
        assert set(uniforms(*words)).isdisjoint(base)
