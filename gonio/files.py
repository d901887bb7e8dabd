"""Writing files so that nothing half-written ever stands under the final name."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from microgeometry.errors import InputError


@contextmanager
def atomic(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Write a file under a temporary name beside it and rename it when the block succeeds.

    Where the block or the disk fails, the temporary file is removed and what stood under `path` before
    is still there. The temporary name ends in the suffix of `path`, for libraries that look at it.

    Parameters
    ----------
    path : path
        The final name; its folder must exist.

    Yields
    ------
    Path
        An existing empty file in the same folder, to be overwritten.

    Raises
    ------
    OSError
        The folder is missing or not writable, or the disk is full; the message names `path`.
    """
    path = Path(path)
    temporary: Path | None = None
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.stem[:80]}-", suffix=path.suffix, dir=path.parent)
        os.close(handle)
        temporary = Path(name)
        yield temporary
        _flush(temporary)
        # mkstemp makes files private; give the result the mode any new file would have
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
    except OSError as error:
        # h5py and OpenEXR raise OSError without errno; what matters to the reader is which file failed
        reason = error.strerror or str(error)
        raise OSError(error.errno, f"{path} could not be written: {reason}") from error
    finally:
        if temporary is not None:
            with suppress(FileNotFoundError):
                temporary.unlink()


def check_writable(path: str | os.PathLike[str]) -> None:
    """Fail now rather than after a long run: can a file of this name be written?

    Raises
    ------
    InputError
        The folder is missing or not writable.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist; create it first")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise InputError(f"{path}: the folder {path.parent} is not writable; choose another")


def _flush(path: Path) -> None:
    """Force the content to disk, so that the rename never overtakes it in a power failure."""
    with open(path, "rb+") as file:
        os.fsync(file.fileno())


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
