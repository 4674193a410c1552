"""`ExpLogFineTuning`: carry a trained field to another domain, with or without ground truth."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from lightning_modules.datamodule import Batch
from lightning_modules.pretrain import ExpLogPretraining
from riemlayer.losses import LossWeights, explog_losses, self_supervised_losses

SUPERVISED = LossWeights(geo=0, cyc=0, pairs=0.05, relative=True)
"""As the packaged weights were trained."""
SELF_SUPERVISED = LossWeights(rec=0, geo=0.1, cyc=1, validity=0)
"""Consistency alone: Eqs (3) and (4)."""


class ExpLogFineTuning(ExpLogPretraining):
    """Further training of a trained field: the heads first, then the backbone at a lower rate.

    Args:
        start_from: packaged name or folder of the weights to start from.
        losses: weights of Eq. (1); by default those of the packaged weights, or the cycle,
            isometric and conformal losses where self-supervised.
        learning_rate: of the heads.
        backbone_rate: of the backbone, as a share of `learning_rate`.
        unfreeze_at: step from which the backbone learns too; -1: never.
        keep: weight of the squared distance to the first weights, |w - w_0|^2 (L2-SP, Li et al.
            2018), which keeps what the field knew of its old domain.
        self_supervised: clouds have no ground truth: learn from consistency alone, between points
            and tangent vectors drawn from each cloud.
        sources, vectors: S and K of these draws.
        weight_decay, warmup: as in `ExpLogPretraining`.

    Raises:
        ValueError: a weight or a rate is negative, or nothing is left to learn from.
    """

    def __init__(
        self,
        start_from: str = "base",
        losses: LossWeights | None = None,
        learning_rate: float = 5e-4,
        backbone_rate: float = 0.3,
        unfreeze_at: int = 100,
        keep: float = 0.0,
        self_supervised: bool = False,
        sources: int = 16,
        vectors: int = 64,
        weight_decay: float = 0.0,
        warmup: int = 50,
    ) -> None:
        for name, value in (("keep", keep), ("backbone_rate", backbone_rate)):
            if value < 0:
                raise ValueError(f"{name} must not be negative, got {value}")
        losses = losses or (SELF_SUPERVISED if self_supervised else SUPERVISED)
        if self_supervised and not (losses.geo or losses.cyc):
            raise ValueError("losses must have geo or cyc above 0 where there is no ground truth")
        super().__init__("base", losses, learning_rate, weight_decay, warmup, start_from)
        self.hparams["config"] = self.field.config.to_dict()  # for the export of checkpoints
        self.backbone_rate, self.unfreeze_at = backbone_rate, unfreeze_at
        self.keep, self.self_supervised = keep, self_supervised
        self.sources, self.vectors = sources, vectors
        self.start = [x.detach().clone() for x in self.field.parameters()] if keep else []

    def on_train_batch_start(self, batch: Batch, batch_idx: int) -> None:
        """Freezes or unfreezes the backbone."""
        learns = 0 <= self.unfreeze_at <= self.global_step
        self.field.backbone.requires_grad_(learns)

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        surface = self.field.encode_in_cube(batch.points, batch.batch, batch.normals)
        if self.self_supervised:
            losses = self_supervised_losses(surface, self.losses, self.sources, self.vectors)
        else:
            losses = explog_losses(surface, batch.truth, self.losses)
        total = losses["total"]
        if self.keep:
            losses["moved"] = self.distance_from_start()
            total = total + self.keep * losses["moved"]
        names = {f"train/{name}": loss for name, loss in losses.items()}
        self.log_dict(names, batch_size=1)
        self.log("loss", total, prog_bar=True, logger=False, batch_size=1)
        return total

    def distance_from_start(self) -> Tensor:
        """|w - w_0|^2 over all weights."""
        pairs = zip(self.field.parameters(), self.start, strict=True)
        return torch.stack([(x - y.to(x.device)).square().sum() for x, y in pairs]).sum()

    def parameter_groups(self) -> list[dict[str, Any]]:
        """Heads, and the backbone at its own rate."""
        backbone = list(self.field.backbone.parameters())
        own = {id(x) for x in backbone}
        heads = [x for x in self.field.parameters() if id(x) not in own]
        rate = self.learning_rate * self.backbone_rate
        return [{"params": heads}, {"params": backbone, "lr": rate}]
