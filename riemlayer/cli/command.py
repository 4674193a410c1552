"""How a function becomes a subcommand: options in groups, --json, --debug, exit codes."""

from __future__ import annotations

import inspect
import json
import math
import sys
import traceback
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from dataclasses import MISSING, dataclass, fields
from functools import wraps
from inspect import Parameter
from typing import Annotated, Any, get_type_hints

import typer
from typer.core import TyperGroup

from riemlayer.cli.errors import judge
from riemlayer.cli.progress import progress


@dataclass(frozen=True)
class Answer:
    """What a subcommand found out."""

    facts: dict[str, Any]
    """Plain values, printed as one JSON object by --json."""
    text: str
    """For people."""


Command = Callable[..., Answer | None]
"""A subcommand; None where it has said everything itself."""


class Options:
    """Base of the dataclasses that stand for several options of a subcommand."""


JSON = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
DEBUG = Annotated[bool, typer.Option("--debug", help="Show tracebacks of errors.")]


def command(
    app: typer.Typer, example: str, panel: str, bar: bool = True, **settings: Any
) -> Callable[[Command], Command]:
    """Registers a function as a subcommand of its name.

    Its parameters are options as in typer, or classes of `Options`, whose fields are options.

    Args:
        app: where to.
        example: a call, shown below the help.
        panel: heading under which `riemlayer --help` lists it.
        bar: False for one that draws its own progress bar.
        settings: further ones of `typer.Typer.command`.
    """

    def register(function: Command) -> Command:
        groups, flat = _flatten(function)

        @wraps(function)
        def run(*, as_json: bool, debug: bool, **values: Any) -> None:
            for name, (kind, names) in groups.items():
                values[name] = kind(**{own: values.pop(own) for own in names})
            token = _as_json.set(as_json)
            try:
                with progress(bar):
                    answer = function(**values)
                if answer is not None:
                    announce(answer)
            finally:
                _as_json.reset(token)

        keyword = Parameter.KEYWORD_ONLY
        flags = [
            Parameter("as_json", keyword, default=False, annotation=JSON),
            Parameter("debug", keyword, default=False, annotation=DEBUG),
        ]
        run.__signature__ = inspect.Signature([*flat, *flags])  # pyright: ignore
        run.__annotations__ = {x.name: x.annotation for x in [*flat, *flags]}
        epilog = f"For instance: [bold]{example}[/bold]"
        app.command(help=unwrapped(function), epilog=epilog, rich_help_panel=panel, **settings)(run)
        return function

    return register


_as_json: ContextVar[bool] = ContextVar("as_json", default=False)


def announce(answer: Answer) -> None:
    """Prints an answer as the user wants it; by hand where the command does not end with it."""
    typer.echo(json.dumps(_strict(answer.facts)) if _as_json.get() else answer.text)


def _strict(value: Any) -> Any:
    """Plain values without NaN and infinity, which JSON does not have: null in their place."""
    if isinstance(value, dict):
        return {key: _strict(x) for key, x in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(x) for x in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def unwrapped(function: Callable) -> str:
    """Its docstring, one line a paragraph: the terminal's width is not the source's."""
    return "\n\n".join(" ".join(x.split()) for x in (inspect.getdoc(function) or "").split("\n\n"))


def _flatten(
    function: Command,
) -> tuple[dict[str, tuple[type[Options], list[str]]], list[Parameter]]:
    """The groups among a function's parameters, and all options one by one."""
    hints = get_type_hints(function, include_extras=True)
    groups, flat = {}, []
    for name, parameter in inspect.signature(function).parameters.items():
        kind = hints[name]
        if not (isinstance(kind, type) and issubclass(kind, Options)):
            annotated = parameter.replace(annotation=kind, kind=Parameter.KEYWORD_ONLY)
            flat.append(annotated)
            continue
        own, inner = fields(kind), get_type_hints(kind, include_extras=True)  # pyright: ignore
        groups[name] = kind, [x.name for x in own]
        for x in own:
            default = Parameter.empty if x.default is MISSING else x.default
            flat.append(
                Parameter(x.name, Parameter.KEYWORD_ONLY, default=default, annotation=inner[x.name])
            )
    return groups, flat


class Commands(TyperGroup):
    """The program: whatever is raised becomes one line on stderr and an exit code."""

    def main(
        self, args: Sequence[str] | None = None, prog_name: str | None = None, **extra: Any
    ) -> None:
        """Runs one subcommand and exits: 0 well, 2 bad input, 1 a failure of ours."""
        args = sys.argv[1:] if args is None else list(args)
        extra["standalone_mode"] = False
        try:
            code = super().main(args, "riemlayer", **extra) or 0
        except typer.Abort:
            code = 130
        except Exception as error:
            code = self._tell(error, args)
        sys.exit(code)

    def _tell(self, error: Exception, args: Sequence[str]) -> int:
        code, message = judge(error)
        if "--debug" in args:
            traceback.print_exception(error)
        if "--json" in args:
            typer.echo(json.dumps({"error": message, "exit_code": code}))
        own = " ".join(["riemlayer", *(x for x in args[:1] if x in self.commands)])
        typer.echo(f"{own}: {message}", err=True)
        return code
