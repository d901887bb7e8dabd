"""The command line: collects every package's commands and turns exceptions into one line.

A command comes from a module registered under the entry-point group ``gonio.commands``, in its tuple
``COMMANDS`` of click commands. Commands raise: InputError (bad input, exit 2), OSError (files, exit 2).
"""

from __future__ import annotations

import importlib.metadata
import sys

import click

from gonio.core.embree import EmbreeError
from gonio.trace.errors import TraceError
from microgeometry.errors import InputError

_GROUP = "gonio.commands"


def build() -> click.Group:
    """The `gonio` command with every registered package's commands in it."""
    group = click.Group(
        "gonio",
        help="A virtual gonioreflectometer: trace a surface, keep its BRDF as a table, fit, render.",
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    )
    group.params.append(
        click.Option(
            ["--version"],
            is_flag=True,
            expose_value=False,
            is_eager=True,
            callback=_version,
            help="Print the version.",
        )
    )
    for entry in sorted(importlib.metadata.entry_points(group=_GROUP), key=lambda e: e.name):
        for command in entry.load().COMMANDS:
            group.add_command(command)
    return group


def main() -> None:
    """Run the command line; the exit status is 0, 1 (a check failed), 2 (bad input) or 130 (Ctrl-C)."""
    try:
        status = build().main(standalone_mode=False)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        _say("interrupted")
        sys.exit(130)
    except (InputError, TraceError, EmbreeError, OSError) as error:
        _say(_describe(error))
        sys.exit(2)
    sys.exit(status if isinstance(status, int) else 0)  # click returns the status of an Exit


def _describe(error: Exception) -> str:
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return " ".join(str(error).split())


def _say(message: str) -> None:
    click.echo(f"gonio: {message}", err=True)


def _version(context: click.Context, _parameter: click.Parameter, value: bool) -> None:
    if value:
        click.echo(importlib.metadata.version("gonio"))
        context.exit()
