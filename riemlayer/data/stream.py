"""Samples read out of shards by their place in them: from a folder, a server or an object store."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from riemlayer.data.augment import Augmentation
from riemlayer.data.dataset import ShapeDataset, check_sample, held_out
from riemlayer.data.shards import MANIFEST


def is_sharded(root: str | Path) -> bool:
    """Whether a root is a URL, or a folder of shards."""
    return "://" in str(root) or any(Path(root).glob("shard-*.tar"))


class ShardedSamples:
    """The samples of one or several folders of shards, read one by one, never a bad one.

    A sample is one range request, its checksum that of the manifest. One that cannot be read is
    named in a warning and counted, and the next good one takes its place, so that ranks keep equal
    numbers of samples and a resumed run draws what the undisturbed one drew.

    Args:
        roots: folders or URLs, such as `s3://bucket/shards`, of whatever fsspec opens.
        corrupt: fraction of samples that may be unreadable.

    Raises:
        FileNotFoundError: a root has no manifest.
        ValueError: a manifest is not one of `riemlayer.data.shards.pack`.
    """

    def __init__(self, roots: Iterable[str | Path], corrupt: float = 0.01) -> None:
        self.shards: list[str] = []
        tables = [self._read_manifest(str(root)) for root in roots]
        self.table: NDArray = np.concatenate(tables)
        self.corrupt = corrupt
        self.unreadable = torch.zeros(len(self.table), dtype=torch.bool).share_memory_()
        """Which samples were found to be so, by any process that loads data."""

    def _read_manifest(self, root: str) -> NDArray:
        import fsspec

        url = f"{root.rstrip('/')}/{MANIFEST}"
        try:
            with fsspec.open(url, "rt", encoding="utf-8") as file:
                lines = [json.loads(line) for line in file]  # pyright: ignore
            found = [x for x in lines if "failed" not in x]
            number = {name: i for i, name in enumerate(dict.fromkeys(x["shard"] for x in found))}
            first = len(self.shards)
            rows = [
                (x["name"], first + number[x["shard"]], x["offset"], x["bytes"], x["sha256"])
                for x in found
            ]
        except FileNotFoundError as error:
            message = f"{url} is missing: write it with riemlayer prepare --shards"
            raise FileNotFoundError(message) from error
        except (json.JSONDecodeError, KeyError, TypeError) as error:
            raise ValueError(f"{url} must be the manifest of shards: {error!r}") from error
        self.shards += [f"{root.rstrip('/')}/{name}" for name in number]
        longest = max((len(row[0]) for row in rows), default=1)
        columns = [("name", f"U{longest}"), ("shard", "i4"), ("offset", "i8"), ("bytes", "i8")]
        return np.array(rows, dtype=[*columns, ("sha256", "S64")])

    def __len__(self) -> int:
        return len(self.table)

    def split(self, fraction: float) -> tuple[list[int], list[int]]:
        """Indices of training and of validation samples; a name's hash decides its side."""
        held = [held_out(str(name), fraction) for name in self.table["name"]]
        return [i for i, out in enumerate(held) if not out], [
            i for i, out in enumerate(held) if out
        ]

    def read(self, chosen: Sequence[int], i: int) -> dict[str, Tensor]:
        """Tensors of sample chosen[i], or of the next one in `chosen` that is good.

        Raises:
            ValueError: more than the fraction `corrupt` of all samples are unreadable.
        """
        for j in range(len(chosen)):
            k = chosen[(i + j) % len(chosen)]
            try:
                return self.load(k)
            except Exception as error:  # whatever the file system raises
                self._count(k, error)
        raise ValueError(f"none of {len(chosen)} samples can be read; prepare the shards again")

    def _count(self, k: int, error: Exception) -> None:
        row, known = self.table[k], bool(self.unreadable[k])
        self.unreadable[k] = True
        bad, most = int(self.unreadable.sum()), self.corrupt * len(self)
        which = f"sample {row['name']} of {self.shards[row['shard']]} cannot be read: {error}"
        if bad > most:
            message = f"{bad} of {len(self)} samples are unreadable, more than corrupt allows"
            raise ValueError(f"{message} ({self.corrupt:g} of them); the last: {which}") from error
        if not known:
            warnings.warn(f"{which}; another takes its place ({bad} so far)", stacklevel=2)

    def names(self) -> list[str]:
        """Of all samples, in the order of the manifests."""
        return [str(name) for name in self.table["name"]]

    def load(self, k: int) -> dict[str, Tensor]:
        """Tensors of sample k itself.

        Raises:
            Exception: it cannot be read; whatever the file system raises, or ValueError.
        """
        from safetensors.torch import load

        return check_sample(load(self.fetch(k)), str(self.table["name"][k]))

    def fetch(self, k: int) -> bytes:
        """The file of sample k.

        Raises:
            OSError: the file system's own error.
            ValueError: the checksum is not that of the manifest.
        """
        from fsspec.core import url_to_fs

        row = self.table[k]
        files, path = url_to_fs(self.shards[row["shard"]])  # cached, and a new one after a fork
        start, size = int(row["offset"]), int(row["bytes"])
        data = files.cat_file(path, start=start, end=start + size)
        if len(data) > size:
            raise ValueError("the server ignores ranges: it must answer requests for a part")
        if hashlib.sha256(data).hexdigest() != row["sha256"].decode():
            raise ValueError(f"checksum of {len(data)} bytes differs from the manifest's")
        return data


class StreamedShapes(ShapeDataset):
    """`ShapeDataset` on samples in shards.

    Args:
        samples: where they are.
        chosen: their indices, such as those of `samples.split`.
        augmentation, sources, vectors, tau: see `ShapeDataset`.
    """

    def __init__(
        self,
        samples: ShardedSamples,
        chosen: Sequence[int],
        augmentation: Augmentation,
        sources: int = 13,
        vectors: int = 768,
        tau: float = 0.5,
    ) -> None:
        super().__init__([], augmentation, sources, vectors, tau)
        self.samples, self.chosen = samples, chosen

    def __len__(self) -> int:
        return len(self.chosen)

    def read(self, i: int) -> dict[str, Tensor]:
        """Tensors of shape i."""
        return self.samples.read(self.chosen, i)
