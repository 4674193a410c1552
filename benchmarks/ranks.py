"""What `benchmarks.axes` starts on one rank or several: a training run or a prediction run.

    python -m benchmarks.ranks predict --ranks 2 --clouds FOLDER --weights base

prints shapes a second of all ranks together, in JSON. Clouds are .npz files.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import lightning as L
import torch
from torch.utils.data import DataLoader

from benchmarks import tasks
from lightning_modules import (
    CloudFilesModule,
    ExpLogPredictor,
    ExpLogPretraining,
    PredictionFiles,
)
from lightning_modules.datamodule import Batch

QUERIES = 768
WARM_UP = 2
"""Steps of a training run that do not count."""


class Clock(L.Callback):
    """Seconds from the end of step `WARM_UP` to the end of the run."""

    def on_train_batch_end(self, trainer: Any, *_: Any) -> None:
        if trainer.global_step == WARM_UP:
            self.start = time.perf_counter()
        self.seconds = time.perf_counter() - getattr(self, "start", 0.0)


def trainer(ranks: int, **options: Any) -> L.Trainer:
    """One that says nothing and keeps nothing."""
    return L.Trainer(
        accelerator="cpu",
        devices=ranks,
        strategy="ddp" if ranks > 1 else "auto",
        use_distributed_sampler=False,
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        **options,
    )


def train(options: argparse.Namespace) -> dict[str, float] | None:
    """Steps of one shape a rank, 13 sources with 768 queries each."""
    field = tasks.load_field(options.weights)
    points = tasks.torus(options.points)
    truth = tasks.truth_like(points, options.queries, field.config.radius)
    item = Batch(points, torch.zeros(len(points), dtype=torch.long), truth)
    model, clock = ExpLogPretraining(config=field.config, losses=tasks.TRAINED_WITH), Clock()
    run = trainer(options.ranks, max_steps=WARM_UP + options.steps, callbacks=[clock])
    run.fit(model, DataLoader([item] * 64, batch_size=1, collate_fn=lambda items: items[0]))
    if not run.is_global_zero:
        return None
    return {"shapes_per_second": options.ranks * options.steps / clock.seconds}


def predict(options: argparse.Namespace) -> dict[str, float] | None:
    """Answers for every cloud of a folder, written to a temporary one."""
    field = tasks.load_field(options.weights)
    names = sorted(path.name for path in options.clouds.iterdir())
    with tempfile.TemporaryDirectory() as folder:
        writer = PredictionFiles(Path(folder), {})
        data = CloudFilesModule(options.clouds, names, writer.finished, batch_size=options.batch)
        run = trainer(options.ranks, callbacks=[writer])
        model = ExpLogPredictor(field, options.what)
        run.predict(model, datamodule=data, return_predictions=False)
        sizes = [path.stat().st_size for path in Path(folder).glob("*.npz")]
    if not run.is_global_zero:
        return None
    rate = writer.totals["shapes_per_second"]
    return {"shapes_per_second": rate, "megabytes_a_shape": sum(sizes) / len(sizes) / 2**20}


def answer(arguments: list[str] | None = None) -> dict[str, float] | None:
    """What a command measures; None on all ranks but the first."""
    parser = argparse.ArgumentParser(description="Shapes a second on several ranks.")
    parser.add_argument("task", choices=("train", "predict"))
    parser.add_argument("--weights", default="base")
    parser.add_argument("--ranks", type=int, default=1)
    parser.add_argument("--points", type=int, default=15_000, help="of the cloud to train on")
    parser.add_argument("--queries", type=int, default=QUERIES, help="a source, to train on")
    parser.add_argument("--steps", type=int, default=4)
    parser.add_argument("--clouds", type=Path, help="folder of .npz to predict on")
    parser.add_argument("--what", default="embedding")
    parser.add_argument("--batch", type=int, default=4, help="clouds encoded at once")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module="lightning")
        return train(options) if options.task == "train" else predict(options)


if __name__ == "__main__":
    if (found := answer()) is not None:
        print(json.dumps(found))
