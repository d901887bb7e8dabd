"""The one exception for bad input, used by every package."""

from __future__ import annotations


class InputError(ValueError):
    """Input that cannot be used.

    The message is one line that names what is wrong and where, the value found, what is allowed and
    what to do. The command line prints it as it stands and exits with status 2.
    """
