"""`DivergenceGuard`: a run that diverges ends, before its weights are spoiled."""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import Any

import lightning as L
import torch
from torch import Tensor


class DivergedError(RuntimeError):
    """The loss is not finite, or has exploded; the message says when and what mends it."""


class DivergenceGuard(L.Callback):
    """Ends a run whose loss or gradient is not finite, or whose loss stays far above its median.

    A loss that is not finite ends the run before the backward pass, a gradient that is not finite
    before the optimiser's step: the weights never take either. Ranks decide together.

    Args:
        factor: a loss above this many times its running median is in doubt.
        window: losses that the median is taken of; doubtful ones are not among them.
        patience: doubtful losses in a row that end the run.

    Raises:
        ValueError: factor is not above 1, window or patience is not positive, or the trainer has
            precision 16-mixed, which scales losses and skips infinite gradients by itself.
        DivergedError: by the hooks, on every rank.
    """

    def __init__(self, factor: float = 10.0, window: int = 200, patience: int = 50) -> None:
        if not factor > 1:
            raise ValueError(f"factor must be above 1, got {factor}")
        for name, value in (("window", window), ("patience", patience)):
            if value < 1:
                raise ValueError(f"{name} must be at least 1, got {value}")
        self.factor, self.patience = factor, patience
        self.losses: deque[float] = deque(maxlen=window)
        self.doubtful = 0

    def setup(self, trainer: L.Trainer, pl_module: Any, stage: str) -> None:
        """Refuses a precision that this cannot judge."""
        if trainer.precision == "16-mixed":
            raise ValueError(
                "precision must not be 16-mixed with a DivergenceGuard, whose losses are scaled; "
                "train in bf16-mixed or leave the guard out"
            )

    @property
    def in_doubt(self) -> bool:
        """Whether the last loss was far above the median."""
        return self.doubtful > 0

    def on_before_backward(self, trainer: L.Trainer, pl_module: Any, loss: Tensor) -> None:
        """Judges a loss, by its mean over the ranks."""
        mean: Any = trainer.strategy.reduce(loss.detach().clone(), reduce_op="mean")
        value = float(mean)
        if not math.isfinite(value):
            raise DivergedError(self._told(trainer, f"the loss is {value}"))
        full = len(self.losses) == self.losses.maxlen
        if full and value > self.factor * median(self.losses):
            self.doubtful += 1
        else:
            self.doubtful = 0
            self.losses.append(value)
        if self.doubtful >= self.patience:
            often = f"the loss, {value:.3g}, has been above {self.factor:g} times its median, "
            often += f"{median(self.losses):.3g}, for {self.doubtful} batches"
            raise DivergedError(self._told(trainer, often))

    def on_before_optimizer_step(self, trainer: L.Trainer, pl_module: Any, optimizer: Any) -> None:
        """Judges the gradients, which are the same on all ranks."""
        gradients = [x.grad for x in pl_module.parameters() if x.grad is not None]
        if not bool(torch.nn.utils.get_total_norm(gradients).isfinite()):
            raise DivergedError(self._told(trainer, "the gradient is not finite"))

    def state_dict(self) -> dict[str, Any]:
        """The losses that the median is taken of, for checkpoints."""
        return {"losses": list(self.losses)}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Goes on with these losses."""
        self.losses.extend(state_dict["losses"])

    @staticmethod
    def _told(trainer: L.Trainer, what: str) -> str:
        saved = [str(x.best_model_path) for x in trainer.checkpoint_callbacks]  # pyright: ignore
        kept = next(filter(None, saved), None)
        mend = f"go on from {kept} (--ckpt_path)" if kept else "start again"
        return (
            f"training diverged at step {trainer.global_step}: {what}; "
            f"{mend} with a lower learning rate, or look at the data of that step"
        )
