"""The program `riemlayer`."""

from __future__ import annotations

import signal
import sys
from typing import Annotated

import typer

from riemlayer.cli import (
    about,
    decal,
    export,
    finetune,
    maps,
    predict,
    prepare,
    regions,
    training,
    viewer,
)
from riemlayer.cli.command import Commands, unwrapped

app = typer.Typer(
    cls=Commands,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
for group in (maps, regions, decal, viewer, prepare, training, finetune, predict, export, about):
    group.register(app)


def root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """Exponential and logarithmic maps of any 3-D shape, from the shell.

    Answers are in the file's own units and order. Exit code 0: well; 2: input that cannot be used,
    in one line; 1: a failure of ours.
    """
    if version:
        from riemlayer import __version__

        typer.echo(f"riemlayer {__version__}")
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())


app.callback(invoke_without_command=True, help=unwrapped(root))(root)


def main() -> None:
    """The console script."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # unwinds, tidies up
    app()
