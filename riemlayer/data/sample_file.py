"""Sample files: one shape, one safetensors file, written whole or not at all."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save

RECIPE = "1"
"""Version of the preparation; raise it when samples change."""


def write_sample(
    path: str | Path, tensors: Mapping[str, NDArray], metadata: Mapping[str, str]
) -> None:
    """Writes one sample atomically: a hidden temporary file, fsync, then a rename (ours).

    Args:
        path: `<folder>/<name>.safetensors`.
        tensors: arrays of the sample.
        metadata: strings kept in the file's header.

    Raises:
        OSError: the disk is full or not writable; nothing is left behind.
    """
    with whole_or_not_at_all(path) as file:
        file.write(_serialise(tensors, metadata))


@contextmanager
def whole_or_not_at_all(path: str | Path) -> Iterator[BinaryIO]:
    """A hidden temporary file that takes the name `path` once it is on the disk (ours).

    Raises:
        OSError: the disk is full or not writable; nothing is left behind.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(temporary, "w+b") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def _serialise(tensors: Mapping[str, NDArray], metadata: Mapping[str, str]) -> bytes:
    """safetensors bytes with sorted metadata: the library's own order changes from run to run."""
    data = save({name: np.ascontiguousarray(x) for name, x in tensors.items()}, dict(metadata))
    body = 8 + int.from_bytes(data[:8], "little")
    header = json.loads(data[8:body])
    header["__metadata__"] = dict(sorted(metadata.items()))
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + data[body:]


def remove_stale(folder: str | Path, age: float = 600.0) -> int:
    """Removes temporary files older than `age` seconds, left by killed runs; how many (ours)."""
    removed = 0
    for file in Path(folder).glob(".*.tmp"):
        with suppress(FileNotFoundError):  # another run was quicker
            if time.time() - file.stat().st_mtime > age:
                file.unlink()
                removed += 1
    return removed
