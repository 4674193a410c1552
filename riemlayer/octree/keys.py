"""Morton keys: cell coordinates and shape index interleaved into one int64."""

from __future__ import annotations

import torch
from torch import Tensor

MAX_DEPTH = 16
"""Three 16-bit coordinates take 48 bits."""
MAX_BATCH = 1 << 12
"""The shape index takes 12 bits above them."""


def spread_bits(x: Tensor) -> Tensor:
    """Move bit i of a 16-bit integer to bit 3i: (...,) int64 -> (...,) int64."""
    x = (x | x << 32) & 0x1F00000000FFFF
    x = (x | x << 16) & 0x1F0000FF0000FF
    x = (x | x << 8) & 0x100F00F00F00F00F
    x = (x | x << 4) & 0x10C30C30C30C30C3
    return (x | x << 2) & 0x1249249249249249


def gather_bits(x: Tensor) -> Tensor:
    """Inverse of `spread_bits`."""
    x = x & 0x1249249249249249
    x = (x | x >> 2) & 0x10C30C30C30C30C3
    x = (x | x >> 4) & 0x100F00F00F00F00F
    x = (x | x >> 8) & 0x1F0000FF0000FF
    x = (x | x >> 16) & 0x1F00000000FFFF
    return (x | x >> 32) & 0xFFFF


def encode_key(cell: Tensor, batch: Tensor, depth: int) -> Tensor:
    """Morton key of cells (N, 3) of shapes `batch` (N,) at `depth`, as (N,) int64.

    Bits 3 depth and above hold the shape, so sorted keys are sorted by shape first.

    Raises:
        ValueError: `depth` over 16, more than 2^12 shapes, or a cell outside the cube.

    >>> encode_key(torch.tensor([[1, 0, 0], [0, 0, 1]]), torch.tensor([0, 1]), depth=2)
    tensor([ 4, 65])
    """
    if not 0 <= depth <= MAX_DEPTH:
        raise ValueError(f"depth must lie in [0, {MAX_DEPTH}] (16 bits a coordinate), got {depth}")
    if batch.numel() and int(batch.max()) >= MAX_BATCH:
        raise ValueError(
            f"batch must hold fewer than {MAX_BATCH} shapes, got {int(batch.max()) + 1}"
        )
    if cell.numel() and (int(cell.min()) < 0 or int(cell.max()) >= 1 << depth):
        raise ValueError(
            f"cell must lie in [0, {1 << depth}) at depth {depth}, "
            f"got [{int(cell.min())}, {int(cell.max())}]"
        )
    x, y, z = (spread_bits(c) for c in cell.unbind(-1))
    return batch << 3 * depth | x << 2 | y << 1 | z


def decode_key(key: Tensor, depth: int) -> tuple[Tensor, Tensor]:
    """Inverse of `encode_key`: cells (N, 3) and shapes (N,)."""
    cell = torch.stack((gather_bits(key >> 2), gather_bits(key >> 1), gather_bits(key)), -1)
    return cell & ((1 << depth) - 1), key >> 3 * depth
