"""`ExpLogPretraining`: Sec. 3.3 as a LightningModule."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import lightning as L
import torch
from lightning.pytorch.callbacks import Timer
from torch import Tensor
from torch.optim.lr_scheduler import LambdaLR

from lightning_modules.datamodule import Batch
from riemlayer.config import FieldConfig
from riemlayer.field import ExpLogField
from riemlayer.losses import LossWeights, explog_losses


class ExpLogPretraining(L.LightningModule):
    """Supervised training of an `ExpLogField` on traced geodesics.

    AdamW with a short warm-up and linear decay to 0 at the trainer's `max_steps` (appendix B), or
    at its `max_time` where it has no last step.

    Args:
        preset: `base`, `paper` or `tiny`.
        losses: weights of Eq. (1).
        learning_rate, weight_decay: the paper's by default.
        warmup: steps of linear warm-up (ours; the paper has none).
        start_from: packaged name or folder of weights to start from.
        config: in the place of `preset`, as a `FieldConfig` or what its `to_dict` gives.
    """

    flops_per_batch: int | None = None
    """Not counted; Lightning's `ThroughputMonitor` asks for it."""

    def __init__(
        self,
        preset: str = "base",
        losses: LossWeights | None = None,
        learning_rate: float = 1e-3,
        weight_decay: float = 1e-4,
        warmup: int = 200,
        start_from: str | None = None,
        config: FieldConfig | dict[str, Any] | None = None,
    ) -> None:
        super().__init__()
        if isinstance(config, dict):
            config = FieldConfig.from_dict(config)
        self.save_hyperparameters(ignore=["losses", "config"])
        if config is not None:  # checkpoints hold plain values
            self.hparams["config"] = config.to_dict()
        self.losses = losses or LossWeights()
        self.learning_rate, self.weight_decay, self.warmup = learning_rate, weight_decay, warmup
        self.field = (
            ExpLogField.from_pretrained(start_from).train()
            if start_from
            else ExpLogField(config or FieldConfig.preset(preset))
        )

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        surface = self.field.encode_in_cube(batch.points, batch.batch, batch.normals)
        losses = explog_losses(surface, batch.truth, self.losses)
        names = {f"train/{name}": loss for name, loss in losses.items()}
        self.log_dict(names, batch_size=len(batch.truth.p))
        self.log(
            "loss", losses["total"], prog_bar=True, logger=False, batch_size=len(batch.truth.p)
        )
        return losses["total"]

    @torch.no_grad()
    def validation_step(self, batch: Batch, batch_idx: int) -> None:
        surface = self.field.encode_in_cube(batch.points, batch.batch, batch.normals)
        truth, shape = batch.truth, batch.truth.shape[:, None]
        good = truth.valid & truth.known
        exp, _ = surface.decode_exp(truth.p[:, None], truth.v, shape)
        log, _ = surface.decode_log(truth.p[:, None], truth.q, shape)
        near = good & (truth.v.norm(dim=-1) < 0.1)
        off_exp, off_log = (exp - truth.q).norm(dim=-1), (log - truth.v).norm(dim=-1)
        metrics = {
            "val/exp": off_exp[good].mean(),
            "val/log": off_log[good].mean(),
            "val/exp_near": off_exp[near].mean(),
            "val/log_near": off_log[near].mean(),
        }
        self.log_dict(metrics, prog_bar=True, batch_size=len(truth.p), sync_dist=True)

    def configure_gradient_clipping(
        self,
        optimizer: Any,
        gradient_clip_val: float | None = None,
        gradient_clip_algorithm: str | None = None,
    ) -> None:
        """By norm; Lightning itself refuses to clip for a fused optimiser."""
        if gradient_clip_val:
            norm = torch.nn.utils.clip_grad_norm_(self.field.parameters(), gradient_clip_val)
            self.log("train/gradient_norm", norm)

    def configure_optimizers(self) -> dict[str, Any]:
        optimizer = torch.optim.AdamW(
            self.parameter_groups(), self.learning_rate, weight_decay=self.weight_decay, fused=True
        )
        spent = self._spent()

        def factor(step: int) -> float:
            return min((step + 1) / max(1, self.warmup), 1.0) * max(0.0, 1 - spent(step))

        schedule = {"scheduler": LambdaLR(optimizer, factor), "interval": "step"}
        return {"optimizer": optimizer, "lr_scheduler": schedule}

    def parameter_groups(self) -> list[dict[str, Any]]:
        """What the optimiser moves, and at which rates."""
        return [{"params": list(self.field.parameters())}]

    def _spent(self) -> Callable[[int], float]:
        """Share of the trainer's steps, or else of its time, that is spent at a step."""
        steps = max(1, self.trainer.estimated_stepping_batches)
        timers = [x for x in self.trainer.callbacks if isinstance(x, Timer)]  # pyright: ignore
        if math.isfinite(steps) or not timers:
            return lambda step: step / steps

        def spent(step: int) -> float:
            elapsed, left = timers[0].time_elapsed(), timers[0].time_remaining()
            return 0.0 if left is None else elapsed / max(elapsed + left, 1e-9)

        return spent
