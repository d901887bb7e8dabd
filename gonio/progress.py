"""Progress on the terminal: rate, error so far and time left, on stderr so that stdout stays the result's."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

Report = Callable[[float, str], None]
"""Called by anything that takes long, with the fraction done (0 to 1) and a few words on how it goes."""


@contextmanager
def progress_bar(title: str) -> Iterator[Report]:
    """Show a bar while the block runs; yields the function that moves it.

    Nothing is shown where stderr is not a terminal.
    """
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[words]}"),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task(title, total=1.0, words="")

        def report(fraction: float, words: str = "") -> None:
            bar.update(task, completed=fraction, words=words)

        yield report
