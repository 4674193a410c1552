"""`riemlayer finetune`."""

from __future__ import annotations

import shutil
import sys
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from riemlayer.cli.command import Answer, command
from riemlayer.cli.errors import UserError
from riemlayer.cli.loaded import check_weights
from riemlayer.cli.output import whole_folder
from riemlayer.cli.training import (
    PANEL,
    Folder,
    accelerator,
    check_folder,
    library_run,
    precision,
)

DECAY = 0.99
"""Of the averaged weights, a step."""


def register(app: typer.Typer) -> None:
    """Adds the subcommand of this file."""
    command(app, "riemlayer finetune DIR -o runs/tuned --steps 500", PANEL, bar=False)(finetune)


def finetune(
    samples: Annotated[
        list[Path],
        typer.Argument(
            metavar="DIR...",
            help="Folders by `riemlayer prepare`; with --self-supervised files of shapes, or "
            "folders of them.",
        ),
    ],
    out: Folder,
    steps: Annotated[int, typer.Option(help="Training steps.", min=1)] = 500,
    start_from: Annotated[
        str, typer.Option(help="Packaged name, folder or hub id of the weights to start from.")
    ] = "base",
    keep: Annotated[
        float, typer.Option(help="Weight of the distance to these weights: 0.01 stays near.", min=0)
    ] = 0.0,
    self_supervised: Annotated[
        bool, typer.Option("--self-supervised", help="No ground truth: consistency alone.")
    ] = False,
    rate: Annotated[float, typer.Option(help="Learning rate of the heads.", min=0)] = 5e-4,
    unfreeze_at: Annotated[
        int, typer.Option(help="Step from which the backbone learns too; -1: never.", min=-1)
    ] = 100,
    sources: Annotated[int, typer.Option(help="Sources a step.", min=1)] = 26,
    vectors: Annotated[int, typer.Option(help="Queries a source.", min=2)] = 384,
    seed: Annotated[int, typer.Option(help="Of everything drawn at random.", min=0)] = 0,
) -> Answer:
    """Carries a trained field to your own domain; a run that stopped is continued.

    OUT/average holds the averaged weights, to be named by --weights or from_pretrained; an earlier
    one is replaced.
    """
    check_folder(out, *samples)
    check_weights(start_from, "--start-from")
    modules = import_module("lightning_modules")
    lightning = import_module("lightning")
    callbacks = import_module("lightning.pytorch.callbacks")
    if self_supervised:
        data = modules.CloudDataModule(shape_files(samples), seed=seed)
    else:
        check_samples(samples)
        folders = [str(folder) for folder in samples]
        data = modules.ExpLogDataModule(folders, 1, sources, vectors, validation=0, seed=seed)
    lightning.seed_everything(seed, verbose=False)
    losses = {"sources": sources, "vectors": vectors} if self_supervised else {}
    model = made(
        modules.ExpLogFineTuning,
        start_from,
        learning_rate=rate,
        unfreeze_at=unfreeze_at,
        keep=keep,
        self_supervised=self_supervised,
        **losses,
    )
    average = modules.ExponentialAverage(DECAY)
    saved = {"every_n_train_steps": min(100, steps), "enable_version_counter": False}
    last = out / "last.ckpt"
    resumed = last.is_file()
    with library_run():
        trainer = lightning.Trainer(
            accelerator=accelerator(),
            precision=precision(),
            max_steps=steps,
            gradient_clip_val=1.0,
            limit_val_batches=0,
            logger=False,
            enable_model_summary=False,
            enable_progress_bar=sys.stderr.isatty(),
            plugins=[modules.AtomicCheckpointIO()],
            callbacks=[
                average,
                modules.DivergenceGuard(),
                callbacks.Timer(),
                modules.SoundCheckpoint(out, "last", **saved),
            ],
        )
        trainer.fit(model, datamodule=data, ckpt_path=str(last) if resumed else None)
    model.field.load_state_dict(average.average)
    weights = out / "average"
    with whole_folder(weights) as folder:
        model.field.cpu().save_pretrained(folder)
        shutil.rmtree(weights, ignore_errors=True)
    facts = {"out": str(out), "weights": str(weights), "checkpoint": str(last)}
    facts |= {"steps": trainer.global_step, "resumed": resumed}
    return Answer(facts, f"{weights}: weights after {trainer.global_step} steps")


def made(kind: Any, start_from: str, **options: Any) -> Any:
    """The model to train; weights that cannot be read are the user's."""
    try:
        return kind(start_from, **options)
    except (ValueError, OSError) as error:
        raise UserError(f"--start-from {start_from}: {error}") from error


def check_samples(folders: list[Path]) -> None:
    """Refuses folders without prepared shapes."""
    from riemlayer.data.dataset import sample_files

    try:
        sample_files(folders)
    except FileNotFoundError as error:
        raise UserError(f"{error}; make some with riemlayer prepare") from error


def shape_files(paths: list[Path]) -> list[Path]:
    """Files of shapes among the paths and in the folders among them."""
    from riemlayer.data.readers import SUFFIXES

    files = []
    for path in paths:
        if not path.exists():
            raise UserError(f"{path} does not exist; check the name and the folder")
        inside = sorted(path.rglob("*")) if path.is_dir() else [path]
        found = [x for x in inside if x.suffix.lower() in SUFFIXES]
        if not found:
            raise UserError(f"{path} must be or hold shapes ({' '.join(SUFFIXES)}), found none")
        files += found
    return files
