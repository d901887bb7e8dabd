"""What can go wrong while tracing, as one exception."""

from __future__ import annotations


class TraceError(RuntimeError):
    """A run that must not be trusted: too many rays lost, or no progress; the message says why and the remedy."""
