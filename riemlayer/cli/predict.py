"""`riemlayer predict`."""

from __future__ import annotations

import hashlib
import json
import sys
from dataclasses import dataclass
from enum import StrEnum
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from riemlayer.cli.command import Answer, Options, announce, command
from riemlayer.cli.errors import UserError
from riemlayer.cli.finetune import shape_files
from riemlayer.cli.loaded import load_field
from riemlayer.cli.options import Points, Seed, Weights
from riemlayer.cli.training import PANEL, Folder, accelerator, check_folder, library_run

if TYPE_CHECKING:
    from riemlayer import ExpLogField


class What(StrEnum):
    """What is asked of every cloud."""

    embedding = "embedding"
    log = "log"
    geometry = "geometry"


@dataclass(frozen=True)
class Question(Options):
    """What is asked, and of which field."""

    what: Annotated[
        What,
        typer.Option(help="Embeddings, log maps of some sources, or the edges that layers take."),
    ] = What.embedding
    sources: Annotated[int, typer.Option(help="Sources a cloud, for log.", min=1)] = 8
    neighbours: Annotated[int, typer.Option(help="Of each point, for geometry.", min=1)] = 16
    weights: Weights = "base"
    points: Points = 10_000
    seed: Seed = 0

    def settings(self, field: ExpLogField) -> dict[str, Any]:
        """What the answers depend on."""
        digest = hashlib.sha256()
        for x in field.state_dict().values():
            digest.update(x.numpy().tobytes())
        own = {What.log: {"sources": self.sources}, What.geometry: {"neighbours": self.neighbours}}
        facts = {"what": self.what.value, **own.get(self.what, {})}
        facts |= {"weights": self.weights, "weights_sha256": digest.hexdigest()}
        return facts | {"points": self.points, "seed": self.seed}


@dataclass(frozen=True)
class Ranks(Options):
    """On how many processes, and how."""

    batch_size: Annotated[int, typer.Option(help="Clouds encoded at once.", min=1)] = 4
    devices: Annotated[int, typer.Option(help="Ranks on this machine.", min=1)] = 1
    nodes: Annotated[int, typer.Option(help="Machines, under SLURM or torchrun.", min=1)] = 1
    workers: Annotated[int, typer.Option(help="Processes a rank that read files.", min=0)] = 0


def register(app: typer.Typer) -> None:
    """Adds the subcommand of this file."""
    example = "riemlayer predict DIR -o OUT --what geometry --devices 2"
    command(app, example, PANEL, bar=False)(predict)


def predict(
    folder: Annotated[
        str,
        typer.Argument(
            metavar="DIR",
            help="Folder of meshes and clouds, or folder or URL of shards.",
            show_default=False,
        ),
    ],
    out: Folder,
    question: Question,
    ranks: Ranks,
) -> Answer | None:
    """Answers of a field for every file of a folder: OUT/NAME.npz for DIR/NAME.

    Of shards that `riemlayer prepare --shards` wrote, the vertices of every sample are answered.

    Files that have their answer are skipped, so a run that stopped is continued by the same call.
    Files that cannot be read are named in OUT/failures.jsonl and make the exit code 2.
    """
    names = names_of(folder, out)
    modules = import_module("lightning_modules")
    lightning = import_module("lightning")
    field = load_field(question.weights, "cpu")
    settings = question.settings(field)
    check_settings(out, settings)
    out.mkdir(parents=True, exist_ok=True)
    writer = modules.PredictionFiles(out, settings)
    model = modules.ExpLogPredictor(
        field, question.what.value, question.sources, question.neighbours, question.seed
    )
    data = modules.CloudFilesModule(
        folder,
        names,
        writer.finished,
        question.points,
        question.seed,
        ranks.batch_size,
        ranks.workers,
    )
    several = ranks.devices * ranks.nodes > 1
    with library_run():
        trainer = lightning.Trainer(
            accelerator=accelerator(),
            devices=ranks.devices,
            num_nodes=ranks.nodes,
            strategy="ddp" if several else "auto",
            use_distributed_sampler=False,
            logger=False,
            enable_checkpointing=False,
            enable_model_summary=False,
            enable_progress_bar=sys.stderr.isatty(),
            callbacks=[writer],
        )
        trainer.predict(model, datamodule=data, return_predictions=False)
    if not trainer.is_global_zero:
        return None
    return told(out, writer, len(names) - len(data.todo))


def names_of(folder: str, out: Path) -> list[str]:
    """Files of the folder, by their names in it; or samples of the shards."""
    place = Path(folder)
    if "://" not in folder:
        if not place.is_dir():
            raise UserError(f"{folder} must be a folder of meshes and clouds; make one, or name it")
        check_folder(out, place)
        if out.absolute().resolve().is_relative_to(place.absolute().resolve()):
            raise UserError(
                f"--out {out} lies in {folder}, which is never written to; name another"
            )
    stream = import_module("riemlayer.data.stream")
    if not stream.is_sharded(folder):
        return [str(x.relative_to(place)) for x in shape_files([place])]
    try:
        return stream.ShardedSamples([folder]).names()
    except (OSError, ValueError) as error:
        raise UserError(str(error)) from error


def check_settings(out: Path, settings: dict[str, Any]) -> None:
    """Refuses a folder with answers to another question."""
    path = out / "settings.json"
    if not path.is_file():
        if out.is_dir() and any(out.rglob("*.npz")):
            raise UserError(f"--out {out} holds .npz of something else; name another folder")
        return
    try:
        before = json.loads(path.read_text("utf-8"))
    except ValueError as error:
        raise UserError(f"{path}: must be JSON; name another --out: {error}") from error
    if not isinstance(before, dict):
        raise UserError(f"{path}: must hold the settings of a former run; name another --out")
    other = [k for k in settings | before if before.get(k) != settings.get(k)]
    if other:
        k = other[0]
        raise UserError(
            f"--out {out} holds answers of a run with {k} {before.get(k)}, asked for is "
            f"{settings.get(k)}; name another folder"
        )


def told(out: Path, writer: Any, skipped: int) -> Answer | None:
    """The answer; where files failed it is printed here, and the exit code is 2."""
    totals = writer.totals
    text = f"{out}: {totals['written']} written, {skipped} already there, "
    text += f"{totals['failed']} failed; {totals['shapes_per_second']:.3g} shapes a second"
    answer = Answer({"out": str(out), "skipped": skipped, **totals}, text)
    if not writer.failures:
        return answer
    announce(answer)
    first = writer.failures[0]
    typer.echo(
        f"riemlayer predict: files without an answer: {len(writer.failures)}, named in "
        f"{out / 'failures.jsonl'}, the first: {first.reason}",
        err=True,
    )
    raise typer.Exit(2)
