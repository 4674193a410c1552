"""What a run costs while it trains: shapes and queries a second, memory."""

from __future__ import annotations

from typing import Any

import lightning as L
import psutil
import torch
from lightning.pytorch.callbacks import ThroughputMonitor

from lightning_modules.datamodule import Batch


class Throughput(ThroughputMonitor):
    """Lightning's `ThroughputMonitor`, counting the shapes and queries of a `Batch`.

    Logs `train/device/samples_per_sec` (shapes) and `train/device/items_per_sec` (queries), and on
    several ranks `train/global/...`, the sum over the ranks as if all were as fast as the first.

    Args:
        window: batches that the rates are averaged over.
    """

    def __init__(self, window: int = 50) -> None:
        super().__init__(shapes_of, queries_of, window_size=window)


def shapes_of(batch: Batch) -> int:
    """Clouds of a packed batch."""
    return int(batch.batch[-1]) + 1


def queries_of(batch: Batch) -> int:
    """Queries (p, v) of a packed batch with ground truth."""
    return batch.truth.v.shape[:2].numel()


class Memory(L.Callback):
    """Logs `train/memory_mb` of the first rank's process and, on a GPU, `train/gpu_memory_mb`.

    The process's is what it holds now, the GPU's the most that tensors took so far; megabytes are
    2^20 bytes. Needs psutil.
    """

    def __init__(self) -> None:
        self.process = psutil.Process()

    def on_train_batch_end(
        self, trainer: L.Trainer, pl_module: Any, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Logs."""
        used = {"train/memory_mb": self.process.memory_info().rss / 2**20}
        device = trainer.strategy.root_device
        if device.type == "cuda":
            used["train/gpu_memory_mb"] = torch.cuda.max_memory_allocated(device) / 2**20
        pl_module.log_dict(used)
