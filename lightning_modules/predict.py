"""`ExpLogPredictor`: what a trained field says of many clouds, batched and on several ranks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import lightning as L
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from riemlayer.data.readers import read_shape
from riemlayer.data.stream import ShardedSamples, is_sharded
from riemlayer.field import ExpLogField
from riemlayer.octree import interpolate
from riemlayer.ops import local_geometry
from riemlayer.surface import EncodedSurface

What = Literal["embedding", "log", "geometry"]
Arrays = dict[str, NDArray]
LENGTHS = ("log", "r", "radius")
"""Arrays of an answer that are lengths, and have the unit of the file."""


class Cloud(NamedTuple):
    """A cloud from a file, centred and scaled in double precision."""

    name: str
    """Of the file, relative to the folder."""
    x: Tensor
    """(N, 3) float32 in the cube."""
    points: NDArray[np.float64]
    """(N, 3) in the file's own units."""
    scale: float
    """points = centre + scale * x"""


class Failure(NamedTuple):
    """A file that could not be read, or a cloud that could not be answered."""

    name: str
    reason: str


class Prediction(NamedTuple):
    """The answer of one cloud."""

    name: str
    arrays: Arrays


class CloudFiles(Dataset):
    """Item i -> the `Cloud` of a file or of a sample in shards, or the `Failure` to read it.

    Args:
        folder: what names are relative to; or a folder or URL of shards, whose samples give their
            vertices.
        names: of files that `riemlayer.data.read_shape` reads, or of samples.
        points: samples of a mesh file; the points of a cloud are kept.
        seed: of the samples.
    """

    def __init__(self, folder: str | Path, names: Sequence[str], points: int, seed: int) -> None:
        self.folder, self.names, self.points, self.seed = folder, list(names), points, seed
        self.shards = ShardedSamples([folder]) if is_sharded(folder) else None
        self.place = (
            {} if self.shards is None else {x: i for i, x in enumerate(self.shards.names())}
        )

    def __len__(self) -> int:
        return len(self.names)

    def read(self, name: str) -> NDArray[np.float64]:
        """Points (N, 3) of the file or sample of that name."""
        if self.shards is not None:
            return self.shards.load(self.place[name])["vertices"].double().numpy()
        return read_shape(Path(self.folder) / name).cloud(self.points, self.seed)

    def __getitem__(self, i: int) -> Cloud | Failure:
        name = self.names[i]
        try:
            points = self.read(name)
        except Exception as error:  # a file system raises what it likes
            reason = " ".join(str(error).split())
            return Failure(name, f"{name}: {reason}" if self.place else reason)
        low, high = points.min(0), points.max(0)
        scale = float((high - low).max() / 2)
        x = torch.from_numpy((points - (low + high) / 2) / scale).float()
        return Cloud(name, x, points, scale)


class CloudFilesModule(L.LightningDataModule):
    """The files of a folder, or samples of shards, without an answer yet; each goes to one rank.

    For a trainer with `use_distributed_sampler=False`.

    Args:
        folder, names, points, seed: as for `CloudFiles`.
        finished: whether a name has its answer already.
        batch_size: clouds that are encoded at once.
        workers: processes that read files.
    """

    def __init__(
        self,
        folder: str | Path,
        names: Sequence[str],
        finished: Callable[[str], bool],
        points: int = 10_000,
        seed: int = 0,
        batch_size: int = 4,
        workers: int = 0,
    ) -> None:
        super().__init__()
        self.allow_zero_length_dataloader_with_multiple_devices = True
        self.folder, self.names, self.finished = folder, list(names), finished
        self.points, self.seed = points, seed
        self.batch_size, self.workers = batch_size, workers

    def setup(self, stage: str) -> None:
        """Looks for answers; the first rank's list holds for all, which may be writing already."""
        todo = [name for name in self.names if not self.finished(name)]
        self.todo: list[str] = self.trainer.strategy.broadcast(todo)  # pyright: ignore

    def predict_dataloader(self) -> DataLoader:
        """Every world-th name: Lightning's own sampler refuses fewer names than ranks."""
        assert self.trainer is not None  # it has called setup
        own = self.todo[self.trainer.global_rank :: self.trainer.world_size]
        data = CloudFiles(self.folder, own, self.points, self.seed)
        return DataLoader(
            data, batch_size=self.batch_size, collate_fn=list, num_workers=self.workers
        )


class ExpLogPredictor(L.LightningModule):
    """Answers of a field on batches of clouds, in the units of their files.

    Args:
        field: a trained one.
        what: `embedding`: `z` (N, C) of every point. `log`: `sources` (S,) indices of points,
            `log` (S, N, 3) of every point from each, `validity` (S, N). `geometry`: the arrays of
            `riemlayer.ops.LocalGeometry`. All with `points` (N, 3).
        sources: S, drawn from each cloud by `seed`; all points where there are fewer.
        neighbours: k of `geometry`.
        seed: of the sources; a cloud has the same in every batch and on every rank.

    Raises:
        ValueError: what is none of these, or sources or neighbours is not positive.
    """

    def __init__(
        self,
        field: ExpLogField,
        what: What = "embedding",
        sources: int = 8,
        neighbours: int = 16,
        seed: int = 0,
    ) -> None:
        super().__init__()
        if what not in get_args(What):
            raise ValueError(f"what must be one of {' '.join(get_args(What))}, got {what!r}")
        for name, value in (("sources", sources), ("neighbours", neighbours)):
            if value < 1:
                raise ValueError(f"{name} must be at least 1, got {value}")
        self.field, self.what = field, what
        self.sources, self.neighbours, self.seed = sources, neighbours, seed

    def predict_step(
        self, batch: list[Cloud | Failure], batch_idx: int
    ) -> list[Prediction | Failure]:
        """Encodes the clouds of a batch at once, then answers them one by one."""
        answers: list[Prediction | Failure] = [x for x in batch if isinstance(x, Failure)]
        clouds = [x for x in batch if isinstance(x, Cloud)]
        if not clouds:
            return answers
        counts = torch.tensor([len(cloud.x) for cloud in clouds], device=self.device)
        index = torch.arange(len(clouds), device=self.device).repeat_interleave(counts)
        surfaces = self.field.encode(torch.cat([cloud.x for cloud in clouds]), index)
        return answers + [self._answer(x, y) for x, y in zip(clouds, surfaces, strict=True)]

    def _answer(self, cloud: Cloud, surface: EncodedSurface) -> Prediction | Failure:
        try:
            found = getattr(self, f"_{self.what}")(surface)
        except ValueError as error:
            return Failure(cloud.name, f"{cloud.name}: {error}")
        arrays = {name: x.cpu().numpy() for name, x in found.items()}
        for name in LENGTHS:
            if name in arrays:
                arrays[name] = arrays[name] * cloud.scale
        return Prediction(cloud.name, {"points": cloud.points, **arrays})

    def _embedding(self, surface: EncodedSurface) -> dict[str, Tensor]:
        embedding = surface.embedding
        x = (surface.points - surface.centre[surface.batch]) / surface.scale[surface.batch, None]
        return {"z": interpolate(embedding.z, embedding.level, x, surface.batch)[0]}

    def _log(self, surface: EncodedSurface) -> dict[str, Tensor]:
        points, generator = surface.points, torch.Generator().manual_seed(self.seed)
        drawn = torch.randperm(len(points), generator=generator)[: self.sources]
        sources = drawn.sort()[0].to(points.device)
        v, logit = surface.decode_log(points[sources, None], points)
        return {"sources": sources, "log": v, "validity": logit.sigmoid()}

    def _geometry(self, surface: EncodedSurface) -> dict[str, Tensor]:
        found = local_geometry(surface, self.neighbours)._asdict()
        del found["batch"]
        return found
