"""`riemlayer export`."""

from __future__ import annotations

import json
import pickle
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from riemlayer.cli.command import Answer, Options, command
from riemlayer.cli.errors import UserError
from riemlayer.cli.loaded import load_field
from riemlayer.cli.options import Force
from riemlayer.cli.output import check_target, whole_file, whole_folder
from riemlayer.cli.progress import stage
from riemlayer.cli.training import PANEL

if TYPE_CHECKING:
    from riemlayer import ExpLogField
    from riemlayer.deploy import Map

NOT_OURS = (pickle.UnpicklingError, EOFError, RuntimeError, ValueError, LookupError, AttributeError)
"""What reading a file that is no checkpoint of ours raises."""


def register(app: typer.Typer) -> None:
    """Adds the subcommands of this file."""
    example = "riemlayer export base --map log --onnx log.onnx"
    command(app, f"riemlayer export runs/mine/last.ckpt -o weights, or {example}", PANEL)(export)


@dataclass(frozen=True)
class Programs(Options):
    """Files that a decoder is written to."""

    which: Annotated[
        Literal["exp", "log"] | None,
        typer.Option("--map", help="Decoder to write as a program.", rich_help_panel="Programs"),
    ] = None
    exported_program: Annotated[
        Path | None,
        typer.Option(metavar="OUT.pt2", help="Program for torch.", rich_help_panel="Programs"),
    ] = None
    onnx: Annotated[
        Path | None,
        typer.Option(metavar="OUT.onnx", help="Program for ONNX.", rich_help_panel="Programs"),
    ] = None
    force: Force = False

    def files(self) -> dict[str, Path]:
        """By option, checked."""
        given = {"--exported-program": self.exported_program, "--onnx": self.onnx}
        files = {option: path for option, path in given.items() if path is not None}
        for option, path in files.items():
            suffix = ".onnx" if option == "--onnx" else ".pt2"
            if path.suffix.lower() != suffix:
                raise UserError(f"{option} must end in {suffix}, got {path}")
            check_target(path, self.force, option=option)
        if files and self.which is None:
            raise UserError(
                f"{' and '.join(files)}: one decoder a file, so say --map exp or --map log"
            )
        if self.which is not None and not files:
            raise UserError("--map is for --exported-program and --onnx; name one of them")
        if "--onnx" in files:
            import_module("onnxscript")
        return files


def export(
    weights: Annotated[
        str,
        typer.Argument(
            help="last.ckpt of a training run; for programs also weights, as for --weights.",
            metavar="CHECKPOINT",
        ),
    ],
    programs: Programs,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder to make.", metavar="DIR")
    ] = None,
    facts: Annotated[
        Path | None, typer.Option(help="JSON with what else the model card shall say.")
    ] = None,
    samples: Annotated[
        list[Path] | None, typer.Option(help="Folder of the training shapes, to count them.")
    ] = None,
) -> Answer:
    """Weights and model card of a checkpoint, as a folder for --weights and from_pretrained.

    With --map, the decoder of Exp or of Log as a program that runs without riemlayer, given what
    riemlayer.deploy.prepare looks up. Encoding and looking up stay in Python.
    """
    files = programs.files()
    if out is None and not files:
        raise UserError("nothing to write; name --out, --exported-program or --onnx")
    found, text = {}, []
    if out is not None:
        found = {"out": str(out), "parameters": pack(Path(weights), out, facts, samples or [])}
        text = [f"{out}: weights of {found['parameters']:,} parameters and their card"]
    elif facts is not None or samples:
        raise UserError("--facts and --samples are for the card in --out; name that")
    if programs.which is not None:
        write_programs(load_field(str(out or weights), "cpu"), programs.which, files)
        found |= {"map": programs.which} | {k: str(path) for k, path in files.items()}
        text += [f"{path}: the decoder of {programs.which}" for path in files.values()]
    return Answer({k.strip("-").replace("-", "_"): v for k, v in found.items()}, "\n".join(text))


def pack(checkpoint: Path, out: Path, facts: Path | None, samples: list[Path]) -> int:
    """Writes the folder of a checkpoint; the number of parameters."""
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
            card = Path(write(checkpoint, folder / WEIGHTS, more, samples))
        except NOT_OURS as error:
            reason = " ".join(str(error).split())[:200]
            raise UserError(f"{checkpoint}: must be a checkpoint of pretrain: {reason}") from error
        card.rename(folder / CARD)
    return json.loads((out / CARD).read_text("utf-8"))["training"]["parameters"]


def write_programs(field: ExpLogField, which: Map, files: dict[str, Path]) -> None:
    """The decoder in every form that was asked for."""
    from torch.export import save

    from riemlayer import deploy

    stage(f"tracing the decoder of {which}")
    program = deploy.export(field, which)
    for option, out in files.items():
        stage(f"writing {out.name}")
        with whole_file(out) as path:
            if option == "--onnx":
                deploy.export_onnx(program, path)
            else:
                save(program, path)


def read_facts(path: Path) -> dict[str, Any]:
    """A JSON object from a file."""
    try:
        facts = json.loads(path.read_text("utf-8"))
    except ValueError as error:
        raise UserError(f"--facts {path}: must be JSON: {error}") from error
    if not isinstance(facts, dict):
        raise UserError(f"--facts {path}: must be one JSON object, got {type(facts).__name__}")
    return facts
