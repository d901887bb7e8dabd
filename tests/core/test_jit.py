"""Kernels: what is compiled for whom."""

from __future__ import annotations

import pytest

from gonio.core import jit
from gonio.core.jit import kernel


@kernel(allocates=False)
def _half(x):
    return 0.5 * x


@kernel(allocates=False)
def _quarter(x):
    return _half(_half(x))


@pytest.mark.skipif(jit.disabled, reason="NUMBA_DISABLE_JIT: nothing is compiled")
def test_a_kernel_is_wrapped_for_python_only_where_python_calls_it():
    from numba import float64

    _quarter.get_call_template((float64,), {})  # as a kernel that calls it asks for it
    (called,) = _quarter.called.overloads.values()
    assert called.library.get_pointer_to_function(called.fndesc.llvm_cpython_wrapper_name) == 0
    assert not _quarter.overloads
    assert _quarter(3.0) == 0.75
    (wrapped,) = _quarter.overloads.values()
    assert wrapped.library.get_pointer_to_function(wrapped.fndesc.llvm_cpython_wrapper_name) != 0


def test_a_kernel_serves_python_and_kernels():
    assert _half(3) == 1.5
    assert _quarter(3) == 0.75
    assert _half(3.0) == 1.5
