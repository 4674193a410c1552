"""`PredictionFiles`: one file of answers for each cloud, and what the run came to."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
import torch
from lightning.pytorch.callbacks import BasePredictionWriter

from lightning_modules.files import whole
from lightning_modules.predict import Failure, Prediction

SETTINGS, THROUGHPUT, FAILURES = "settings.json", "throughput.json", "failures.jsonl"


class PredictionFiles(BasePredictionWriter):
    """Writes OUT/NAME.npz for the cloud of each file NAME, whole or not at all.

    At the end `throughput.json` says how many shapes a second all ranks together answered, from the
    start to the last file, and `failures.jsonl` names files without an answer.

    Args:
        out: the folder.
        settings: what was asked, kept in `settings.json`.
    """

    def __init__(self, out: Path, settings: dict[str, Any]) -> None:
        super().__init__("batch")
        self.out, self.settings = out, settings
        self.written, self.failures = 0, list[Failure]()
        self.totals: dict[str, Any] = {}

    def target(self, name: str) -> Path:
        """Where the answer of a file goes."""
        return self.out / f"{name}.npz"

    def finished(self, name: str) -> bool:
        """Whether the answer of a file is there."""
        return self.target(name).is_file()

    def setup(self, trainer: L.Trainer, pl_module: L.LightningModule, stage: str) -> None:
        """Starts the clock."""
        super().setup(trainer, pl_module, stage)
        if trainer.is_global_zero:
            write_json(self.out / SETTINGS, self.settings)
        self.start = time.perf_counter()

    def write_on_batch_end(
        self,
        trainer: L.Trainer,
        pl_module: L.LightningModule,
        prediction: Sequence[Prediction | Failure],
        batch_indices: Sequence[int] | None,
        batch: Any,
        batch_idx: int,
        dataloader_idx: int,
    ) -> None:
        """Writes the answers of a batch."""
        for answer in prediction:
            if isinstance(answer, Failure):
                self.failures.append(answer)
                continue
            path = self.target(answer.name)
            path.parent.mkdir(parents=True, exist_ok=True)
            with whole(path) as file:
                np.savez(file, **answer.arrays)  # pyright: ignore[reportArgumentType]
            self.written += 1

    def teardown(self, trainer: L.Trainer, pl_module: L.LightningModule, stage: str) -> None:
        """Puts the counts of all ranks together, those without a file to answer too."""
        own = self.written, [tuple(x) for x in self.failures]
        ranks: list[Any] = [own] * trainer.world_size
        if trainer.world_size > 1:
            torch.distributed.all_gather_object(ranks, own)
        seconds = time.perf_counter() - self.start
        written = sum(count for count, _ in ranks)
        self.failures = sorted(Failure(*x) for _, failures in ranks for x in failures)
        self.totals = {
            "written": written,
            "failed": len(self.failures),
            "ranks": trainer.world_size,
            "seconds": round(seconds, 3),
            "shapes_per_second": round(written / seconds, 3),
        }
        if trainer.is_global_zero:
            lines = "".join(json.dumps(x._asdict()) + "\n" for x in self.failures)
            with whole(self.out / FAILURES) as file:
                file.write(lines.encode())
            write_json(self.out / THROUGHPUT, self.totals)


def write_json(path: Path, facts: dict[str, Any]) -> None:
    """Plain values as a JSON file."""
    with whole(path) as file:
        file.write((json.dumps(facts, indent=1) + "\n").encode())
