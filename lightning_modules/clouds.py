"""`CloudDataModule`: clouds without ground truth, for self-supervised fine-tuning."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import lightning as L
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from lightning_modules.datamodule import Batch, SeededSampler
from riemlayer.data.augment import rotation
from riemlayer.data.load import load_shape


class CloudDataset(Dataset):
    """Item (i, seed) -> (N, 3): the cloud of file i in the cube, turned at random by `seed`."""

    def __init__(self, files: Sequence[Path], points: int) -> None:
        self.files, self.points = list(files), points

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, item: tuple[int, int]) -> Tensor:
        i, seed = item
        generator = torch.Generator().manual_seed(seed)
        points = torch.from_numpy(load_shape(self.files[i], self.points).points)
        points = points[torch.randperm(len(points), generator=generator)[: self.points]]
        points = points @ rotation(1.0, generator).T
        low, high = points.amin(0), points.amax(0)
        return (points - (low + high) / 2) * (2 / (high - low).max())


class CloudDataModule(L.LightningDataModule):
    """Clouds from files of any kind that `riemlayer.data.load.load_shape` reads.

    Args:
        files: the files.
        batch_size: clouds a step.
        points: most points of a cloud.
        seed: of order and rotations.

    Raises:
        ValueError: there is no file.
    """

    def __init__(
        self, files: Sequence[str | Path], batch_size: int = 1, points: int = 10_000, seed: int = 0
    ) -> None:
        super().__init__()
        if not files:
            raise ValueError("files must name at least one cloud, got none")
        self.data = CloudDataset([Path(f) for f in files], points)
        self.batch_size, self.seed = batch_size, seed

    def train_dataloader(self) -> DataLoader:
        """Clouds in a new order each epoch."""
        trainer = self.trainer
        ranks = (trainer.global_rank, trainer.world_size) if trainer else (0, 1)
        sampler = SeededSampler(len(self.data), self.seed, True, *ranks)
        return DataLoader(self.data, self.batch_size, sampler=sampler, collate_fn=pack)

    def transfer_batch_to_device(
        self, batch: Batch, device: torch.device, dataloader_idx: int
    ) -> Batch:
        """Moves a batch; called by the trainer."""
        return batch.to(device)


def pack(clouds: list[Tensor]) -> Batch:
    """Clouds one after the other."""
    counts = torch.tensor([len(x) for x in clouds])
    index = torch.arange(len(clouds)).repeat_interleave(counts)
    return Batch(torch.cat(clouds), index, None)
