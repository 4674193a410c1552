"""`ExpLogHeadFitting`: the heads alone, on look-ups that were made before."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import lightning as L
import torch
from torch import Tensor
from torch.utils.data import DataLoader

from lightning_modules.lookups import MAPS, LookUps, read_look_ups
from lightning_modules.pretrain import ExpLogPretraining
from riemlayer.heads.branch import MapHead
from riemlayer.losses import Asked, LossWeights, map_losses


class ExpLogHeadFitting(ExpLogPretraining):
    """Trains gates and decoders of a field whose backbone stays as it is (ours).

    So do Log's tangent plane and what points of its fans count, which was settled before heads were
    told anything. The losses are those of `ExpLogPretraining` but Eqs (3) and (4), which need the
    field.

    Args:
        start_from: packaged name or folder of the weights that the look-ups were made with.
        losses: weights of Eq. (1); `rec`, `pairs`, `prior`, `validity` and `relative` count.
        learning_rate, weight_decay, warmup: see `ExpLogPretraining`.
        gates_only: decoders stay as they are, too: few weights, which learn from few shapes.

    Examples:
        >>> data = LookUpModule(["lookups/0.safetensors"])  # doctest: +SKIP
        >>> L.Trainer(max_steps=5000).fit(ExpLogHeadFitting("base"), data)  # doctest: +SKIP
    """

    def __init__(
        self,
        start_from: str,
        losses: LossWeights | None = None,
        learning_rate: float = 1e-3,
        weight_decay: float = 1e-3,
        warmup: int = 100,
        gates_only: bool = False,
    ) -> None:
        losses = losses or LossWeights(geo=0, cyc=0, pairs=0.05, prior=0.2, relative=True)
        super().__init__("base", losses, learning_rate, weight_decay, warmup, start_from)
        self.hparams["config"] = self.field.config.to_dict()  # for the export of checkpoints
        self.gates_only = gates_only

    def training_step(self, batch: dict[str, LookUps], batch_idx: int) -> Tensor:
        losses: dict[str, Tensor] = {}
        for name in MAPS:
            head: MapHead = getattr(self.field, f"{name}_head")
            losses |= head_losses(head, batch[name], name, self.losses)
        total = torch.stack([losses[f"{name}/total"] for name in MAPS]).sum()
        self.log_dict({f"train/{k}": x for k, x in losses.items()}, batch_size=1)
        self.log("loss", total, prog_bar=True, logger=False, batch_size=1)
        return total

    def parameter_groups(self) -> list[dict[str, Any]]:
        """Those of the heads, or of their gates."""
        heads = [getattr(self.field, f"{name}_head") for name in MAPS]
        parts = [head.gate for head in heads] if self.gates_only else heads
        return [{"params": [x for part in parts for x in part.parameters()]}]


def head_losses(head: MapHead, told: LookUps, name: str, weights: LossWeights) -> dict[str, Tensor]:
    """The terms of Eq. (1) that ask one head alone, and their sum, `name/total`."""
    rows = told.told.to(told.z.dtype)
    assert head.gate is not None  # look-ups are made of heads with one
    prior, trust = head.gate(list(told.priors.unbind(-2)), [rows], told.site)
    vector, logit = head.answer(told.z, told.x, prior, (rows,), told.site, trust)
    vector, logit, prior = (y[:, 1:] for y in (vector, logit, prior))
    labels = told.valid, told.known
    weight = weights.weigh(told.length, labels)
    at = told.x[:, 1:] if name == "log" else None
    terms = map_losses(Asked(vector, logit, prior, told.truth, labels, weight, at), weights)
    return {f"{name}/{term}": loss for term, loss in terms.items()}


class LookUpModule(L.LightningDataModule):
    """Batches of look-ups: every step sees sources of many shapes.

    Args:
        paths: files that `python -m lightning_modules.lookups` wrote, of one field.
        sources: S of a batch.
    """

    def __init__(self, paths: Sequence[str | Path], sources: int = 48) -> None:
        super().__init__()
        self.paths, self.sources = list(paths), sources

    def setup(self, stage: str) -> None:
        """Reads the files; called by the trainer."""
        self.told = read_look_ups(self.paths)

    def train_dataloader(self) -> DataLoader:
        """Sources in a new order each epoch."""
        size = len(self.told["exp"].z)
        return DataLoader(
            range(size),  # pyright: ignore[reportArgumentType]
            self.sources,
            shuffle=True,
            drop_last=size > self.sources,
            collate_fn=self._rows,
        )

    def _rows(self, index: list[int]) -> dict[str, LookUps]:
        chosen = torch.tensor(index)
        return {name: told.rows(chosen) for name, told in self.told.items()}

    def transfer_batch_to_device(
        self, batch: dict[str, LookUps], device: torch.device, dataloader_idx: int
    ) -> dict[str, LookUps]:
        """Moves a batch; called by the trainer."""
        return {name: told.map(lambda x: x.to(device)) for name, told in batch.items()}
