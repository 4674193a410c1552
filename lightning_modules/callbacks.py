"""Callbacks: running average of the weights, export of the field."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import lightning as L
import torch


class ExponentialAverage(L.Callback):
    """Exponential moving average of the field's weights, validated and exported in their place.

    Args:
        decay: of the average a step; early on it is (1 + n) / (10 + n).
        export: folder that `save_pretrained` writes the averaged field to, at every validation and
            at the end.
    """

    def __init__(self, decay: float = 0.999, export: str | None = None) -> None:
        self.decay, self.export = decay, export
        self.average: dict[str, torch.Tensor] = {}
        self._own: dict[str, torch.Tensor] = {}

    def on_train_batch_end(
        self, trainer: L.Trainer, pl_module: Any, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Moves the average towards the weights."""
        n = trainer.global_step
        weight = 1 - min(self.decay, (1 + n) / (10 + n))
        state = {k: x.detach() for k, x in pl_module.field.state_dict().items()}
        if not self.average:
            self.average = {k: x.clone() for k, x in state.items()}
        lerp = torch._foreach_lerp_  # pyright: ignore[reportPrivateImportUsage]
        lerp(list(self.average.values()), list(state.values()), weight)

    def on_validation_start(self, trainer: L.Trainer, pl_module: Any) -> None:
        """Puts the average in the field's place."""
        if self.average:
            self._own = {k: x.clone() for k, x in pl_module.field.state_dict().items()}
            pl_module.field.load_state_dict(self.average)

    def on_validation_end(self, trainer: L.Trainer, pl_module: Any) -> None:
        """Exports the average and puts the weights back."""
        writes = trainer.is_global_zero and not trainer.sanity_checking
        if self.average and self.export and writes:
            pl_module.field.save_pretrained(Path(self.export))
        if self._own:
            pl_module.field.load_state_dict(self._own)
            self._own = {}

    def on_train_end(self, trainer: L.Trainer, pl_module: Any) -> None:
        """Exports the average of the last step, also of a run too short for a validation."""
        self.on_validation_start(trainer, pl_module)
        self.on_validation_end(trainer, pl_module)

    def state_dict(self) -> dict[str, Any]:
        """The average, for checkpoints."""
        return {"average": self.average}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Continues an average."""
        self.average = state_dict["average"]
