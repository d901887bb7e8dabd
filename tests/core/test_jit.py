"""Kernels: what is compiled for whom."""

from __future__ import annotations

from pathlib import Path

import pytest
from numba.core.caching import FunctionCache

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


@pytest.mark.skipif(jit.disabled or jit.fcntl is None, reason="nothing is compiled, or no locks")
@pytest.mark.parametrize(
    "cache", [lambda: _half._cache, lambda: _half.called._cache], ids=["python", "kernels"]
)
def test_processes_write_to_a_cache_one_after_the_other(monkeypatch, cache):
    def save(self, sig, data):
        # flock tells one opening of a file from another, of the same process too
        with open(Path(self.cache_path, "lock")) as file, pytest.raises(BlockingIOError):
            jit.fcntl.flock(file, jit.fcntl.LOCK_EX | jit.fcntl.LOCK_NB)
        saved.append(sig)

    saved = []
    monkeypatch.setattr(FunctionCache, "save_overload", save)
    for sig in ("first", "second"):  # the lock was let go
        cache().save_overload(sig, None)
    assert saved == ["first", "second"]


def test_a_cache_that_was_emptied_is_made_again(tmp_path):
    with jit._alone(tmp_path / "gone"):
        assert (tmp_path / "gone").is_dir()
