"""Checkpoints: the state of a measurement in one file beside its table, to go on from after anything."""

from __future__ import annotations

import dataclasses
import glob
import hashlib
import importlib.metadata
import json
import os
import time
import zipfile
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import microgeometry
from gonio.files import atomic
from microgeometry.errors import InputError

if TYPE_CHECKING:
    from gonio.trace.measurement import Measurement

EVERY = 30.0
"""Seconds between checkpoints."""

_SUFFIX = ".checkpoint"
_IDLE = 10.0  # so many times longer than writing it takes, a checkpoint is not written again
_HEADER = "run"


class Checkpoint:
    """The file that an unfinished measurement leaves beside its table: T.h5.checkpoint.

    An uncompressed npz: the tally's and the schedule's arrays, and in ``run`` what fixes the measurement as
    JSON. It is replaced as a whole, so whenever the process ends, it is the last or the one before.

    Parameters
    ----------
    target : path
        The table's file.
    measurement : Measurement
    every : float
        Seconds between checkpoints; 0: none are written.

    Attributes
    ----------
    path : Path

    Raises
    ------
    InputError
        A negative number of seconds, or a file that the specimen names cannot be read.
    """

    def __init__(
        self, target: str | os.PathLike[str], measurement: Measurement, every: float = EVERY
    ) -> None:
        if not 0.0 <= every < float("inf"):
            raise InputError(f"checkpoint: {every:g}; a number of seconds is needed, 0 for none")
        self._target = target = Path(target)
        self.path = target.with_name(target.name + _SUFFIX)
        self._measurement = measurement
        self._identity = identity(measurement)
        self._every = every
        self._due = time.monotonic() + every

    def begin(self, resume: bool) -> bool:
        """Go on from the file, or make sure that there is none.

        Parameters
        ----------
        resume : bool

        Returns
        -------
        bool
            Something was resumed; False where there was nothing to.

        Raises
        ------
        InputError
            The file is of another measurement, damaged, or there although `resume` is False.
        """
        for path in (self.path, self._target):
            _remove_leftovers(path)
        if not self.path.exists():
            return False
        if not resume:
            raise InputError(
                f"{self.path}: an unfinished measurement; add --resume to go on with it, or delete the file to "
                "start anew"
            )
        state = self._read()
        try:
            there = json.loads(state.pop(_HEADER).tobytes())
            _check_same(there, self._identity)
            self._measurement.restore(state)
        except (KeyError, ValueError) as error:
            raise self._damaged(error) from error
        except InputError as error:
            raise InputError(f"{self.path}: {error}, or delete the file to start anew") from error
        return True

    def save_if_due(self) -> None:
        """Write the file if it is time to."""
        if self._every and time.monotonic() >= self._due:
            started = time.monotonic()
            self.save()
            now = time.monotonic()
            self._due = now + max(self._every, _IDLE * (now - started))

    def save(self) -> None:
        """Write the file.

        Raises
        ------
        OSError
            It cannot be written; the one before is still there.
        """
        header = np.frombuffer(json.dumps(self._identity).encode(), np.uint8)
        arrays: dict[str, Any] = {_HEADER: header, **self._measurement.state()}
        with atomic(self.path) as temporary, open(temporary, "wb") as file:
            np.savez(file, **arrays)

    def remove(self) -> None:
        """Remove the file: the table is written."""
        with suppress(FileNotFoundError):
            self.path.unlink()

    def _read(self) -> dict[str, NDArray]:
        try:
            with np.load(self.path, allow_pickle=False) as file:
                return dict(file)
        except (OSError, EOFError, ValueError, zipfile.BadZipFile) as error:
            raise self._damaged(error) from error

    def _damaged(self, error: Exception) -> InputError:
        reason = " ".join(str(error).split())
        return InputError(f"{self.path}: damaged, or no checkpoint ({reason}); delete it to start anew")


def _remove_leftovers(path: Path) -> None:
    """Remove temporary files of `gonio.files.atomic` for this path, left by processes that were killed."""
    for leftover in path.parent.glob(f".{glob.escape(path.stem[:80])}-????????{glob.escape(path.suffix)}"):
        with suppress(OSError):
            leftover.unlink()


def identity(measurement: Measurement) -> dict[str, Any]:
    """What fixes every bit of a measurement, as JSON."""
    specimen = measurement.specimen
    return {"text": specimen.text, "specimen": fingerprint(specimen), **measurement.plan, **versions()}


def fingerprint(thing: Any) -> str:
    """Hash of a specimen, or of any part: of what it says and of the files it names, not of how it says it.

    Raises
    ------
    InputError
        A file it names cannot be read.
    """
    digest = hashlib.sha256()
    _feed(digest, thing)
    return digest.hexdigest()[:16]


def _feed(digest: Any, thing: Any) -> None:
    if dataclasses.is_dataclass(thing):
        digest.update(type(thing).__name__.encode())
        for field in dataclasses.fields(thing):
            if field.name not in ("text", "name"):  # a comment, or another name, changes no number
                digest.update(field.name.encode())
                _feed(digest, getattr(thing, field.name))
    elif isinstance(thing, Path):
        try:
            digest.update(hashlib.sha256(thing.read_bytes()).digest())
        except OSError as error:
            raise InputError(f"{thing}: cannot be read ({error.strerror}); check the path") from error
    elif isinstance(thing, (tuple, list)):
        digest.update(f"{len(thing)}:".encode())
        for item in thing:
            _feed(digest, item)
    elif isinstance(thing, np.ndarray):
        digest.update(f"{thing.dtype}{thing.shape}".encode() + thing.tobytes())
    else:
        digest.update(repr(thing).encode() + b";")


@lru_cache
def versions() -> dict[str, str]:
    """Versions of what makes the numbers, and a hash of the sources: these change without their version."""
    digest = hashlib.sha256()
    for root in (Path(microgeometry.__file__).parent, Path(__file__).parents[1]):
        for source in sorted(root.rglob("*.py")):
            digest.update(source.relative_to(root).as_posix().encode() + source.read_bytes())
    names = ("gonio", "embreex", "numba", "numpy")
    versions = {f"{name} version": importlib.metadata.version(name) for name in names}
    return {**versions, "source code": digest.hexdigest()[:16]}


def _check_same(there: dict[str, Any], here: dict[str, Any]) -> None:
    """Raise InputError with what differs between two identities."""
    if there["specimen"] != here["specimen"]:
        lines = zip(there["text"].splitlines(), here["text"].splitlines(), strict=False)
        where = next((f" ({a.strip()!r} there, {b.strip()!r} here)" for a, b in lines if a != b), "")
        raise InputError(
            f"is of another specimen{where or ', or a file it names has changed'}; give the one it was begun with"
        )
    for name, value in here.items():
        if name not in ("text", "specimen") and there.get(name) != value:
            raise InputError(
                f"was begun with {name} {_word(there.get(name))}, not {_word(value)}; go on with that"
            )


def _word(value: Any) -> str:
    return "none" if value is None else str(value)
