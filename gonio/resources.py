"""Where the example specimens and scenes lie."""

from __future__ import annotations

from pathlib import Path

from microgeometry.errors import InputError


def data_folder() -> Path:
    """The project's ``data`` folder: beside the packages in a checkout, inside this one when installed.

    Raises
    ------
    InputError
        Neither is there: the installation is not whole.
    """
    here = Path(__file__).resolve().parent
    for folder in (here.parent / "data", here / "_data"):
        if (folder / "specimens").is_dir():
            return folder
    raise InputError(f"{here / '_data'}: the example data is missing; install gonio again")
