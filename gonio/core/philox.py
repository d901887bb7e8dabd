"""Counter-based random numbers: Philox4x32-10 (Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3").

A number is a function of its key and counter, not of what was drawn before, so results do not depend on
the order of work or the number of threads. The tracer keys by (seed, batch) and counts by
(path, path high word, bounce, dimension).
"""

from __future__ import annotations

import numpy as np

from gonio.core.jit import kernel

_M0 = np.uint64(0xD2511F53)
_M1 = np.uint64(0xCD9E8D57)
_W0 = np.uint64(0x9E3779B9)
_W1 = np.uint64(0xBB67AE85)
_LOW = np.uint64(0xFFFFFFFF)
_32 = np.uint64(32)


@kernel(allocates=False, inline=True)
def philox4x32(c0, c1, c2, c3, k0, k1):
    """Ten rounds of Philox4x32 on one counter.

    Parameters
    ----------
    c0, c1, c2, c3 : int
        Counter words; the low 32 bits of each count.
    k0, k1 : int
        Key words; the low 32 bits of each count.

    Returns
    -------
    tuple of 4 uint64
        Four independent words, each below 2**32.
    """
    x0 = np.uint64(c0) & _LOW
    x1 = np.uint64(c1) & _LOW
    x2 = np.uint64(c2) & _LOW
    x3 = np.uint64(c3) & _LOW
    key0 = np.uint64(k0) & _LOW
    key1 = np.uint64(k1) & _LOW
    for _ in range(10):
        product0 = _M0 * x0
        product1 = _M1 * x2
        x0 = (product1 >> _32) ^ x1 ^ key0
        x1 = product1 & _LOW
        x2 = (product0 >> _32) ^ x3 ^ key1
        x3 = product0 & _LOW
        key0 = (key0 + _W0) & _LOW
        key1 = (key1 + _W1) & _LOW
    return x0, x1, x2, x3


@kernel(allocates=False, inline=True)
def unit(word):
    """Map a 32-bit word to the centre of one of 2**32 intervals of (0, 1): never 0, never 1."""
    return (np.float64(word) + 0.5) * 2.3283064365386963e-10


@kernel(allocates=False, inline=True)
def uniforms(c0, c1, c2, c3, k0, k1):
    """Four numbers uniform in (0, 1) for one counter and key; arguments as `philox4x32`."""
    x0, x1, x2, x3 = philox4x32(c0, c1, c2, c3, k0, k1)
    return unit(x0), unit(x1), unit(x2), unit(x3)
