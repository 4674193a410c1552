"""`ExpLogDataModule`: prepared shapes as batches, resumable to the step."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from functools import partial
from typing import Any

import lightning as L
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Sampler

from riemlayer.data.augment import Augmentation, TrainingSample
from riemlayer.data.dataset import ShapeDataset, sample_files, split
from riemlayer.data.stream import ShardedSamples, StreamedShapes, is_sharded
from riemlayer.losses import Truth


class Batch:
    """A packed batch of clouds and their ground truth, where there is any."""

    def __init__(
        self, points: Tensor, batch: Tensor, truth: Truth | None, normals: Tensor | None = None
    ) -> None:
        self.points, self.batch, self._truth, self.normals = points, batch, truth, normals

    @property
    def truth(self) -> Truth:
        """Raises ValueError where there is none."""
        if self._truth is None:
            raise ValueError("the clouds have no ground truth: train with self_supervised=True")
        return self._truth

    def to(self, device: torch.device) -> Batch:
        """The same batch on another device."""
        truth = self._truth
        if truth is not None:
            truth = Truth(*(getattr(truth, f.name).to(device) for f in fields(Truth)))
        normals = None if self.normals is None else self.normals.to(device)
        return Batch(self.points.to(device), self.batch.to(device), truth, normals)


def collate(samples: list[TrainingSample]) -> Batch:
    """Pack the clouds of several samples one after the other."""
    counts = torch.tensor([len(s.points) for s in samples])
    index = torch.arange(len(samples))
    parts = {f.name: torch.cat([getattr(s.truth, f.name) for s in samples]) for f in fields(Truth)}
    parts["shape"] = index.repeat_interleave(torch.tensor([len(s.truth.p) for s in samples]))
    points = torch.cat([s.points for s in samples])
    normals = [s.normals for s in samples if s.normals is not None]
    return Batch(
        points,
        index.repeat_interleave(counts),
        Truth(**parts),
        torch.cat(normals) if normals else None,
    )


class SeededSampler(Sampler[tuple[int, int]]):
    """Endless-looking epochs of (index, seed), a function of (seed, epoch) alone.

    A run that starts again at step n of an epoch draws what the undisturbed run drew there. Each of
    `world` ranks draws every world-th item, so together they draw an epoch once; the last
    size % world items of an order, which differ from epoch to epoch, wait for the next.
    """

    def __init__(self, size: int, seed: int, shuffle: bool, rank: int = 0, world: int = 1) -> None:
        self.size, self.seed, self.shuffle = size, seed, shuffle
        self.rank, self.world = rank, world
        self.epoch, self.begun = 0, (0, 0)

    def __len__(self) -> int:
        return self.size // self.world

    def __iter__(self) -> Iterator[tuple[int, int]]:
        epoch = self.epoch if self.shuffle else 0
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + epoch)
        order = (
            torch.randperm(self.size, generator=generator)
            if self.shuffle
            else torch.arange(self.size)
        )
        seeds = torch.randint(1 << 60, (self.size,), generator=generator)
        resumed, seen = self.begun
        start = seen if self.shuffle and epoch == resumed else 0
        own = slice(start + self.rank, self.world * len(self), self.world)
        yield from zip(order[own].tolist(), seeds[own].tolist(), strict=True)

    def set_epoch(self, epoch: int) -> None:
        """Called by the trainer before each epoch."""
        self.epoch = epoch

    def resume(self, epoch: int, seen: int) -> None:
        """Go on in an epoch of which all ranks together have drawn `seen` items."""
        self.epoch, self.begun = epoch, (epoch, seen)


class ExpLogDataModule(L.LightningDataModule):
    """Training and validation shapes from prepared samples: files, or shards to stream.

    Args:
        roots: folders of samples, written by `riemlayer.data.prepare`; or folders and URLs of
            shards, written by `riemlayer.data.shards.pack`, such as `s3://bucket/shards`.
        batch_size: shapes a step.
        sources, vectors: sources a shape and queries a source; 13 x 768 is the paper's 10,000.
        augmentation: what may happen to a training cloud.
        validation: fraction of the shapes held out, by the hash of their names.
        limit_validation: most validation shapes.
        seed: of order and augmentation.
        workers: processes that load data.
        tau: threshold of the filter, Eq. (8), in training; validation is always filtered by 0.5.
        corrupt: fraction of samples in shards that may be unreadable before the run stops.
    """

    def __init__(
        self,
        roots: list[str],
        batch_size: int = 1,
        sources: int = 13,
        vectors: int = 768,
        augmentation: Augmentation | None = None,
        validation: float = 0.03,
        limit_validation: int = 32,
        seed: int = 0,
        workers: int = 0,
        tau: float = 0.5,
        corrupt: float = 0.01,
    ) -> None:
        super().__init__()
        self.roots, self.batch_size = roots, batch_size
        self.sources, self.vectors = sources, vectors
        self.augmentation = augmentation or Augmentation()
        self.validation, self.limit_validation = validation, limit_validation
        self.seed, self.workers, self.tau, self.corrupt = seed, workers, tau, corrupt
        self.sampler: SeededSampler | None = None

    def setup(self, stage: str) -> None:
        """Lists the samples; called by the trainer."""
        shapes, train, held = self._shapes()
        self.train = shapes(train, self.augmentation, self.sources, self.vectors, self.tau)
        still = Augmentation.none(self.augmentation.normals)
        self.held = shapes(held[: self.limit_validation], still, self.sources, self.vectors)
        self.sampler = self._sampler(len(train), shuffle=True)

    def _shapes(self) -> tuple[Callable[..., ShapeDataset], Sequence[Any], Sequence[Any]]:
        """What makes a data set, and the shapes to train on and to hold out that it takes."""
        if not any(is_sharded(root) for root in self.roots):
            return ShapeDataset, *split(sample_files(self.roots), self.validation)
        samples = ShardedSamples(self.roots, self.corrupt)
        return partial(StreamedShapes, samples), *samples.split(self.validation)

    def train_dataloader(self) -> DataLoader:
        """Shapes in a new order each epoch."""
        return self._loader(self.train, self.sampler)

    def val_dataloader(self) -> DataLoader:
        """The held-out shapes, always the same queries."""
        return self._loader(self.held, self._sampler(len(self.held), shuffle=False))

    def _sampler(self, size: int, shuffle: bool) -> SeededSampler:
        rank, world = (
            (self.trainer.global_rank, self.trainer.world_size) if self.trainer else (0, 1)
        )
        return SeededSampler(size, self.seed, shuffle, rank, world)

    def _loader(self, data: ShapeDataset, sampler: SeededSampler | None) -> DataLoader:
        return DataLoader(
            data,
            self.batch_size,
            sampler=sampler,
            collate_fn=collate,
            num_workers=self.workers,
            persistent_workers=self.workers > 0,
        )

    def transfer_batch_to_device(
        self, batch: Batch, device: torch.device, dataloader_idx: int
    ) -> Batch:
        """Moves a batch; called by the trainer."""
        return batch.to(device)

    def state_dict(self) -> dict[str, Any]:
        """Where in which epoch the run is."""
        trainer = self.trainer
        if trainer is None:
            return {}
        progress: Any = trainer.fit_loop.epoch_loop.batch_progress.current
        a_step = self.batch_size * trainer.world_size
        return {
            "epoch": trainer.current_epoch,
            "seen": progress.processed * a_step,
            "size": len(self.train),
            "shapes_a_step": a_step,
        }

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Continues there, also when new shapes were added since (then at the epoch's start)."""
        assert self.sampler is not None  # the trainer has called setup
        epoch, seen, size = (state_dict[name] for name in ("epoch", "seen", "size"))
        if seen >= size:
            epoch, seen = epoch + 1, 0
        self.sampler.resume(epoch, seen if size == len(self.train) else 0)
