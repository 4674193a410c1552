"""`riemlayer export`."""

from __future__ import annotations

import json
import pickle
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from riemlayer.cli.command import Answer, command
from riemlayer.cli.errors import UserError
from riemlayer.cli.output import whole_folder
from riemlayer.cli.training import PANEL

NOT_OURS = (pickle.UnpicklingError, EOFError, RuntimeError, ValueError, LookupError, AttributeError)
"""What reading a file that is no checkpoint of ours raises."""


def register(app: typer.Typer) -> None:
    """Adds the subcommands of this file."""
    command(app, "riemlayer export runs/mine/last.ckpt -o weights", PANEL)(export)


def export(
    checkpoint: Annotated[Path, typer.Argument(help="last.ckpt of a training run.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder to make.", metavar="DIR")],
    facts: Annotated[
        Path | None, typer.Option(help="JSON with what else the model card shall say.")
    ] = None,
    samples: Annotated[
        list[Path] | None, typer.Option(help="Folder of the training shapes, to count them.")
    ] = None,
) -> Answer:
    """Weights and model card of a checkpoint, as a folder for --weights and from_pretrained."""
    from riemlayer.storage import CARD, WEIGHTS

    if not checkpoint.is_file():
        raise UserError(f"{checkpoint} is no file; name the last.ckpt of a training run")
    if out.exists():
        raise UserError(f"--out {out} exists; name a new folder")
    if not out.absolute().parent.is_dir():
        raise UserError(f"--out {out}: its folder does not exist; make it with mkdir -p")
    more = {} if facts is None else read_facts(facts)
    write = import_module("lightning_modules.export").export
    with whole_folder(out) as folder:
        try:
            card = Path(write(checkpoint, folder / WEIGHTS, more, samples or ()))
        except NOT_OURS as error:
            reason = " ".join(str(error).split())[:200]
            raise UserError(f"{checkpoint}: must be a checkpoint of pretrain: {reason}") from error
        card.rename(folder / CARD)
    parameters = json.loads((out / CARD).read_text("utf-8"))["training"]["parameters"]
    text = f"{out}: weights of {parameters:,} parameters and their card"
    return Answer({"out": str(out), "parameters": parameters}, text)


def read_facts(path: Path) -> dict[str, Any]:
    """A JSON object from a file."""
    try:
        facts = json.loads(path.read_text("utf-8"))
    except ValueError as error:
        raise UserError(f"--facts {path}: must be JSON: {error}") from error
    if not isinstance(facts, dict):
        raise UserError(f"--facts {path}: must be one JSON object, got {type(facts).__name__}")
    return facts
