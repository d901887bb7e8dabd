"""Kernels of the arithmetic coder of `gonio.table.compress.arithmetic`: decisions, numbers, blocks, flags.

Encoder and decoder are one: each step takes what it is to write and returns what stands there, so that they
cannot learn different things. The state, the bytes, and what is known of each decision are arrays:
the probability of 0, of `ONE`, and how often it was asked.
"""

from __future__ import annotations

import numpy as np

from gonio.core.jit import kernel

ONE = 1 << 16  # of probabilities
_LEAST = 24
_TOP = 1 << 24
_KNOWN = 180  # decisions after which a probability is learnt no slower
_RATES = (ONE / (np.arange(_KNOWN + 1) + 1.6)).astype(np.int64)

_SIZES = 14  # decisions on how large a number is, each with a probability of its own
_NEAR, _FAR = 12, 16  # classes of neighbours and of frequencies
_PLACE = _SIZES + 1
_BOXES = 2 * _NEAR * _PLACE + _FAR * 2  # where the probabilities of boxes begin
_BITS = 32
_FLAGS = _BOXES + 4 * _BITS * _BITS
_N_FLAGS = 512
DECISIONS = _FLAGS + _N_FLAGS

# The coder's numbers: low end, range, byte held back, how many bytes of 255 after it, place in the bytes, code
_LOW, RANGE, _CACHE, PENDING, AT, _CODE, DECODES = range(7)


@kernel(allocates=False)
def _shift(data, state):
    """Write the highest byte of the low end, with the carry it may have brought."""
    low = state[_LOW]
    if low < 0xFF000000 or low >= 0x100000000:
        carry = low >> 32
        byte = state[_CACHE]
        for _ in range(state[PENDING]):
            data[state[AT]] = (byte + carry) & 0xFF
            state[AT] += 1
            byte = 0xFF
        state[PENDING] = 0
        state[_CACHE] = (low >> 24) & 0xFF
    state[PENDING] += 1
    state[_LOW] = (low & 0x00FFFFFF) << 8


@kernel(allocates=False)
def finish(data, state):
    """Write what the bytes lack; `AT` is then where they end."""
    # the number in the range with the most zeros at its end, which need not be written
    for bits in range(32, -1, -1):
        unit = 1 << bits
        number = (state[_LOW] + unit - 1) // unit * unit
        if number < state[_LOW] + state[RANGE]:
            state[_LOW] = number
            break
    for _ in range(5):
        _shift(data, state)


@kernel(allocates=False)
def _next(data, state):
    byte = 0
    if state[AT] < data.shape[0]:
        byte = data[state[AT]]
        state[AT] += 1
    return byte


@kernel(allocates=False)
def begin(data, state):
    """Read the first bytes."""
    for _ in range(4):
        state[_CODE] = (state[_CODE] << 8) | _next(data, state)


@kernel(allocates=False)
def _decide(bit, chance, data, state):
    """Code one decision whose probability to be 0 is given; returns it."""
    bound = (state[RANGE] >> 16) * chance
    if state[DECODES]:
        bit = 0 if state[_CODE] < bound else 1
        if bit == 0:
            state[RANGE] = bound
        else:
            state[_CODE] -= bound
            state[RANGE] -= bound
        while state[RANGE] < _TOP:
            state[RANGE] <<= 8
            state[_CODE] = (state[_CODE] << 8) | _next(data, state)
        return bit
    if bit == 0:
        state[RANGE] = bound
    else:
        state[_LOW] += bound
        state[RANGE] -= bound
    while state[RANGE] < _TOP:
        state[RANGE] <<= 8
        _shift(data, state)
    return bit


@kernel(allocates=False)
def _learn(bit, k, chances, seen):
    n = seen[k]
    aim = ONE if bit == 0 else 0
    chances[k] += ((aim - chances[k]) * _RATES[n]) >> 16
    chances[k] = min(max(chances[k], _LEAST), ONE - _LEAST)
    seen[k] = min(n + 1, _KNOWN)


@kernel(allocates=False)
def _bit(bit, k, data, state, chances, seen):
    bit = _decide(bit, chances[k], data, state)
    _learn(bit, k, chances, seen)
    return bit


@kernel(allocates=False)
def _bit_of_two(bit, k, j, data, state, chances, seen):
    bit = _decide(bit, (chances[k] + chances[j]) >> 1, data, state)
    _learn(bit, k, chances, seen)
    _learn(bit, j, chances, seen)
    return bit


@kernel(allocates=False)
def _number(x, k, data, state, chances, seen):
    """A number from 1: how many bits it has, each decision with a probability of its own, then the bits."""
    bits = 0
    while bits < _BITS - 2:
        if _bit(1 if x >> (bits + 1) else 0, k + bits, data, state, chances, seen) == 0:
            break
        bits += 1
    found = 1
    for at in range(bits - 1, -1, -1):
        found = (found << 1) | _decide((x >> at) & 1, ONE >> 1, data, state)
    return found


@kernel(allocates=False)
def _value(x, near, far, data, state, chances, seen):
    """One number, from the classes of its neighbours and of its frequency."""
    k = near * _PLACE
    if _bit_of_two(1 if x else 0, k, 2 * _NEAR * _PLACE + 2 * far, data, state, chances, seen) == 0:
        return 0
    negative = _decide(1 if x < 0 else 0, ONE >> 1, data, state)
    size = 1
    x = abs(x)
    while size <= _SIZES:
        bit = 1 if x > size else 0
        if size == 1:
            far_k = 2 * _NEAR * _PLACE + 2 * far + 1
            bit = _bit_of_two(bit, k + size, far_k, data, state, chances, seen)
        else:
            bit = _bit(bit, k + size, data, state, chances, seen)
        if bit == 0:
            break
        size += 1
    if size > _SIZES:
        size += _number(x - _SIZES, _BOXES + 3 * _BITS * _BITS, data, state, chances, seen) - 1
    return -size if negative else size


@kernel(allocates=False)
def _class_of(weight):
    """0, 1, 2, 3, 4, 5-6, 7-8, 9-12, 13-16, ... as 0, 1, 2, ..."""
    if weight < 5:
        return weight
    found, step = 5, 2
    while weight > 4 + step and found < _NEAR - 1:
        weight -= step
        found += 1
        if found % 2 == 1:
            step *= 2
    return found


@kernel(allocates=False)
def code_blocks(numbers, data, state, chances, seen):
    """Blocks of numbers, (n, a, b, c, d), from or to the bytes; 1 where the bytes ask for more than a block."""
    n, a, b, c, d = numbers.shape
    sizes = (a, b, c, d)
    box = (_BOXES, _BOXES + _BITS, _BOXES + 2 * _BITS, _BOXES + 3 * _BITS)
    before = 0
    for block in range(n):
        extent_a, extent_b, extent_c, extent_d = 0, 0, 0, 0
        if not state[DECODES]:
            for i in range(a):
                for r in range(b):
                    for p in range(c):
                        for s in range(d):
                            if numbers[block, i, r, p, s] != 0:
                                extent_a, extent_b = max(extent_a, i + 1), max(extent_b, r + 1)
                                extent_c, extent_d = max(extent_c, p + 1), max(extent_d, s + 1)
        filled = _bit(1 if extent_a else 0, _FLAGS - 2 + before, data, state, chances, seen)
        before = filled
        if filled == 0:
            continue
        extent_a = _number(extent_a, box[0], data, state, chances, seen)
        extent_b = _number(extent_b, box[1], data, state, chances, seen)
        extent_c = _number(extent_c, box[2], data, state, chances, seen)
        extent_d = _number(extent_d, box[3], data, state, chances, seen)
        if extent_a > sizes[0] or extent_b > sizes[1] or extent_c > sizes[2] or extent_d > sizes[3]:
            return 1
        for i in range(extent_a):
            for r in range(extent_b):
                for p in range(extent_c):
                    for s in range(extent_d):
                        weight = 0
                        if p > 0:
                            weight += 2 * abs(numbers[block, i, r, p - 1, s])
                        if r > 0:
                            weight += 2 * abs(numbers[block, i, r - 1, p, s])
                        if i > 0:
                            weight += 2 * abs(numbers[block, i - 1, r, p, s])
                        if s > 0:
                            weight += 2 * abs(numbers[block, i, r, p, s - 1])
                        if p > 1:
                            weight += abs(numbers[block, i, r, p - 2, s])
                        if r > 1:
                            weight += abs(numbers[block, i, r - 2, p, s])
                        if r > 0 and p > 0:
                            weight += abs(numbers[block, i, r - 1, p - 1, s])
                        place = i + r + p + s
                        far = 0
                        while place > 0 and far < _FAR // 2 - 1:
                            place >>= 1
                            far += 1
                        if s > 0:
                            far += _FAR // 2
                        numbers[block, i, r, p, s] = _value(
                            numbers[block, i, r, p, s], _class_of(weight), far, data, state, chances, seen
                        )
    return 0


@kernel(allocates=False)
def code_flags(flags, data, state, chances, seen):
    """Flags, (n, m), from or to the bytes."""
    for i in range(flags.shape[0]):
        for r in range(flags.shape[1]):
            k = 0
            if r > 0:
                k = 1 + flags[i, r - 1]
            if i > 0:
                k += 3 * (1 + flags[i - 1, r])
            flags[i, r] = _bit(flags[i, r], _FLAGS + k, data, state, chances, seen)
