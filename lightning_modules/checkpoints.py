"""Checkpoints that survive: a killed write, a full disk, and a loss that explodes."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import lightning as L
import torch
from lightning.fabric.plugins.io.torch_io import TorchCheckpointIO
from lightning.pytorch.callbacks import ModelCheckpoint

from lightning_modules.files import whole
from lightning_modules.guard import DivergenceGuard


class AtomicCheckpointIO(TorchCheckpointIO):
    """Writes beside the checkpoint, to the disk, and renames: readers see the old or the new one.

    Lightning writes into the system's temporary folder and moves: where that is another file
    system the move is a copy, and a process that is killed in it leaves half a checkpoint.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "last.ckpt"
    >>> AtomicCheckpointIO().save_checkpoint({"global_step": 3}, path)
    >>> AtomicCheckpointIO().load_checkpoint(path)
    {'global_step': 3}
    """

    def save_checkpoint(
        self,
        checkpoint: dict[str, Any],
        path: str | Path,
        storage_options: Any | None = None,
    ) -> None:
        """Writes a checkpoint to a local path; other addresses (s3://...) go Lightning's way.

        Raises:
            OSError: it could not be written, as on a full disk; a former one is as it was.
        """
        if "://" in str(path):
            return super().save_checkpoint(checkpoint, path, storage_options)
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        content = io.BytesIO()
        torch.save(checkpoint, content)
        try:
            with whole(path) as file:
                file.write(content.getbuffer())
        except OSError as error:
            kept = "; the former one is kept" if path.exists() else ""
            told = f"{error.strerror}: checkpoint not written{kept}"
            raise OSError(error.errno, told, str(path)) from error


class SoundCheckpoint(ModelCheckpoint):
    """`ModelCheckpoint` that saves at the end too, and waits while the loss is in doubt.

    While a `DivergenceGuard` of the trainer doubts the loss, the last file is one from before it
    began to explode.
    """

    def on_train_batch_end(
        self,
        trainer: L.Trainer,
        pl_module: L.LightningModule,
        outputs: Any,
        batch: Any,
        batch_idx: int,
    ) -> None:
        """Saves where a save is due and no guard is in doubt."""
        if not in_doubt(trainer):
            super().on_train_batch_end(trainer, pl_module, outputs, batch, batch_idx)

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Saves the last step, also of a run shorter than `every_n_train_steps`."""
        super().on_train_end(trainer, pl_module)
        if not in_doubt(trainer):
            now = {"epoch": trainer.current_epoch, "step": trainer.global_step}
            metrics = trainer.callback_metrics | {k: torch.tensor(x) for k, x in now.items()}
            trainer.save_checkpoint(self.format_checkpoint_name(metrics))


def in_doubt(trainer: L.Trainer) -> bool:
    """Whether a guard of the trainer doubts the loss."""
    callbacks: list[Any] = trainer.callbacks  # pyright: ignore[reportAttributeAccessIssue]
    return any(isinstance(x, DivergenceGuard) and x.in_doubt for x in callbacks)
