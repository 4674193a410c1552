"""Prepared shapes on disk as a torch data set of training samples."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor
from torch.utils.data import Dataset

from riemlayer.data.augment import Augmentation, TrainingSample, training_sample

REQUIRED = ("vertices", "faces", "p", "normal", "v", "q", "divergence", "complete")


def read_sample(path: str | Path) -> dict[str, Tensor]:
    """Tensors of one prepared shape, read through a memory map.

    Raises:
        ValueError: the file is truncated, corrupt, or lacks a tensor; the message names the file.
    """
    try:
        with safe_open(path, framework="pt") as file:
            sample = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise ValueError(f"sample file {path} is truncated or corrupt: {error}") from error
    return check_sample(sample, f"file {path}")


def check_sample(sample: dict[str, Tensor], what: str) -> dict[str, Tensor]:
    """The sample; ValueError names `what` lacks a tensor."""
    missing = [name for name in REQUIRED if name not in sample]
    if missing:
        raise ValueError(f"sample {what} lacks {missing}; prepare it again")
    return sample


def sample_files(roots: str | Path | Sequence[str | Path]) -> list[Path]:
    """Sample files in one or several folders, by name; unfinished files are not among them.

    Raises:
        FileNotFoundError: there is none.
    """
    folders = [roots] if isinstance(roots, str | Path) else roots
    files = sorted(f for root in folders for f in Path(root).glob("[!.]*.safetensors"))
    if not files:
        raise FileNotFoundError(f"no *.safetensors samples in {[str(f) for f in folders]}")
    return files


def split(files: Sequence[Path], fraction: float) -> tuple[list[Path], list[Path]]:
    """Training and validation files; the hash of its name decides a file's side for good."""
    train, held = [], []
    for file in files:
        (held if held_out(file.stem, fraction) else train).append(file)
    return train, held


def held_out(name: str, fraction: float) -> bool:
    """Whether a shape of this name belongs to the validation set."""
    return zlib.crc32(name.encode()) % 10_000 < fraction * 10_000


class ShapeDataset(Dataset):
    """Item (i, seed) -> `TrainingSample`: the cloud and the sources of shape i, drawn by `seed`.

    The seed comes with the index so that a resumed run draws what the undisturbed one would have.

    Args:
        files: sample files.
        augmentation: what may happen to a cloud.
        sources, vectors: S and K of an item.
        tau: threshold of the filter, Eq. (8); infinity: no filter.
    """

    def __init__(
        self,
        files: Sequence[Path],
        augmentation: Augmentation,
        sources: int = 13,
        vectors: int = 768,
        tau: float = 0.5,
    ) -> None:
        self.files, self.augmentation = list(files), augmentation
        self.sources, self.vectors, self.tau = sources, vectors, tau

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, item: tuple[int, int]) -> TrainingSample:
        i, seed = item
        generator = torch.Generator().manual_seed(seed)
        return training_sample(
            self.read(i),
            self.augmentation,
            generator,
            self.sources,
            self.vectors,
            self.tau,
        )

    def read(self, i: int) -> dict[str, Tensor]:
        """Tensors of shape i."""
        return read_sample(self.files[i])
