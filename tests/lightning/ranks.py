"""Trains a tiny field on prepared spheres: what tests call, and start on two ranks."""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from typing import Any

import lightning as L
import torch

import riemlayer.field
from lightning_modules import (
    AtomicCheckpointIO,
    DivergenceGuard,
    ExpLogDataModule,
    ExpLogPretraining,
    SoundCheckpoint,
)
from riemlayer.data.augment import Augmentation
from riemlayer.losses import LossWeights

LOSSES = LossWeights(geo=0, cyc=0, pairs=0.05, relative=True)


class Gradients(L.Callback):
    """Keeps the gradients of the first optimiser step, and writes them down."""

    def __init__(self, out: Path) -> None:
        self.out, self.first = out, {}

    def on_before_optimizer_step(self, trainer: Any, pl_module: Any, optimizer: Any) -> None:
        if not self.first:
            pairs = pl_module.field.named_parameters()
            self.first = {k: x.grad.clone() for k, x in pairs if x.grad is not None}
            torch.save(self.first, self.out / f"gradients{trainer.global_rank}.pt")


class Progress(L.Callback):
    """Tells the tests which process is at which step; pauses so that they can act."""

    def __init__(self, out: Path, pause: float) -> None:
        self.out, self.pause = out, pause

    def on_train_batch_end(self, trainer: Any, *_: Any) -> None:
        (self.out / f"rank{trainer.global_rank}").write_text(f"{os.getpid()} {trainer.global_step}")
        time.sleep(self.pause)


def fit(
    folder: Path,
    out: Path,
    steps: int = 1,
    batch_size: int = 1,
    pause: float = 0.0,
    resume: bool = False,
    model: Any = None,
    callbacks: tuple = (),
    **options: Any,
) -> L.Trainer:
    """Trains; last.ckpt in `out` after every step."""
    torch.manual_seed(1)
    trainer = L.Trainer(
        accelerator="cpu",
        max_steps=steps,
        limit_val_batches=0,
        enable_progress_bar=False,
        enable_model_summary=False,
        use_distributed_sampler=False,
        plugins=[AtomicCheckpointIO()],
        callbacks=[
            *callbacks,
            DivergenceGuard(window=5, patience=3),
            Progress(out, pause),
            SoundCheckpoint(out, "last", every_n_train_steps=1, enable_version_counter=False),
        ],
        **{"logger": False} | options,
    )
    data = ExpLogDataModule(
        [str(folder)],
        batch_size,
        sources=3,
        vectors=16,
        augmentation=Augmentation(points=(600, 800)),
        validation=0.2,
    )
    model = model or ExpLogPretraining("tiny", LOSSES, warmup=3)
    trainer.fit(model, data, ckpt_path=out / "last.ckpt" if resume else None)
    return trainer


def main() -> None:
    riemlayer.field._has_bfloat16 = lambda device: False  # gradients are compared to 1e-5
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--steps", type=int, default=1)
    parser.add_argument("--pause", type=float, default=0.0)
    parser.add_argument("--resume", action="store_true")
    given = parser.parse_args()
    fit(**vars(given), callbacks=(Gradients(given.out),), strategy="ddp", devices=2)


if __name__ == "__main__":
    main()
