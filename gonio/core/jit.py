"""The numba decorator, and nothing else: every compiled kernel of the project goes through `kernel`.

numba caches compiled code on disk but notices only edits of the file a function stands in; an edit of
a helper in another file leaves the caller's cache silently stale. So the cache directory carries a hash
of every source a kernel may call into: any edit starts a new cache, and a second process that runs the
same sources compiles nothing.

With NUMBA_DISABLE_JIT=1 kernels are the plain Python functions they are written as.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba
from numba.core import config as _numba_config
from numba.core.caching import FunctionCache
from numba.core.registry import CPUDispatcher

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

config: Any = _numba_config  # its attributes are set at import, where mypy does not see them

__all__ = ["disabled", "kernel"]

_ROOT = Path(__file__).resolve().parents[2]
# Packages with kernels, lowest floor first. A kernel may call into its own floor and those below.
_FLOORS = ("gonio", "fitting", "renderer")
_UNUSED_DAYS = 30

disabled: bool = bool(config.DISABLE_JIT)
"""True when kernels run as plain Python (NUMBA_DISABLE_JIT=1)."""


def kernel(function: Callable | None = None, *, inline: bool = False, allocates: bool = True) -> Any:
    """Compile a function for numba's nopython mode, cached across processes, free of the interpreter's lock.

    Parameters
    ----------
    function : callable
        The function; its arguments' types select the specialisation, and an argument that is None
        removes the branches that ask for it.
    inline : bool
        Inline into the caller at numba's level, for small helpers that return tuples.
    allocates : bool
        Say False where neither the function nor what it inlines makes an array: numba then leaves out
        the counting of references to its array arguments, an atomic operation for each at every call.

    Returns
    -------
    callable
        The dispatcher. Division by zero follows IEEE (inf, nan) as in numpy.
    """

    def decorate(f: Callable) -> Any:
        if disabled:
            return f
        previous = config.CACHE_DIR
        directory = cache_directory(_floor_of(f))
        try:
            options: dict[str, Any] = {
                "nopython": True,
                "boundscheck": None,  # as NUMBA_BOUNDSCHECK says
                "nogil": True,
                "error_model": "numpy",
                "fastmath": {"contract"},
                "inline": "always" if inline else "never",
                "_nrt": allocates,
                "no_cfunc_wrapper": True,  # for C and for functions as values: nobody has use for one
            }
            config.CACHE_DIR = str(directory)
            entry: Any = _Kernel(f, targetoptions=options)
            entry._cache = _Cache(f)
            config.CACHE_DIR = str(directory / "called")
            entry.called = CPUDispatcher(f, targetoptions={**options, "no_cpython_wrapper": True})
            entry.called._cache = _Cache(f)
            return entry
        finally:
            config.CACHE_DIR = previous

    return decorate if function is None else decorate(function)


@lru_cache
def cache_directory(package: str) -> Path:
    """Directory of the compiled kernels of `package`, named after a hash of the sources they depend on.

    Lies under ``GONIO_CACHE_DIR``, else under ``XDG_CACHE_HOME`` or ``~/.cache``, in ``gonio/``.
    """
    if package in _FLOORS:
        roots = [_ROOT / name for name in _FLOORS[: _FLOORS.index(package) + 1]]
    else:  # a package of somebody else's, on top of all floors
        roots = [_ROOT / name for name in _FLOORS] + [_ROOT / package]
    digest = hashlib.sha256(numba.__version__.encode())
    for root in roots:
        for source in sorted(root.rglob("*.py")):
            digest.update(source.relative_to(_ROOT).as_posix().encode())
            digest.update(source.read_bytes())
    home = os.environ.get("GONIO_CACHE_DIR") or Path(
        os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "gonio"
    )
    directory = Path(home) / f"{package}-{digest.hexdigest()[:16]}"
    if not directory.exists():
        directory.mkdir(parents=True, exist_ok=True)
        _remove_unused(directory.parent)
    return directory


class _Kernel(CPUDispatcher):
    """A kernel as Python calls it. Kernels call `called`: the same without the code that unpacks Python's objects.

    Most kernels are only ever called by kernels, and that code takes numba an eighth of its time.
    """

    called: Any

    def get_call_template(self, args: Any, kws: Any) -> Any:
        return self.called.get_call_template(args, kws)

    def get_overload(self, sig: Any) -> Any:
        return self.called.get_overload(sig)


class _Cache(FunctionCache):
    """numba's cache, to which processes write one after the other.

    numba numbers the files of a function's specialisations: two processes that save different ones at a time
    may take the same number, and from then on one's code is run for the other's types.
    """

    def save_overload(self, sig: Any, data: Any) -> None:
        with _alone(Path(self.cache_path)):
            super().save_overload(sig, data)


@contextmanager
def _alone(directory: Path) -> Iterator[None]:
    """Hold a lock that other processes wait for, where the file system has any; who is killed lets go of it."""
    directory.mkdir(parents=True, exist_ok=True)  # somebody may have emptied the cache
    with open(directory / "lock", "w") as file:
        with suppress(OSError):
            if fcntl is not None:
                fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _floor_of(function: Callable) -> str:
    return (function.__module__ or "").partition(".")[0]


def _remove_unused(home: Path) -> None:
    """Delete caches that no process has opened for a month: sources change, old kernels never return."""
    for old in home.glob("*-" + "[0-9a-f]" * 16):
        if time.time() - old.stat().st_mtime > _UNUSED_DAYS * 86400:
            shutil.rmtree(old, ignore_errors=True)
