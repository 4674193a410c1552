"""Checks of clouds: points, the batch they are packed in, their normals."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from riemlayer.checks.tensors import check_finite, check_same_device, check_tensor, check_vectors

MIN_POINTS = 4
"""Fewer points than this span no volume and have no local plane with a residual."""


def check_points(points: Any, batch: Any = None) -> None:
    """`points` is a cloud one can encode: (N, 3), floating, finite, N >= 4, not all in one place.

    Args:
        points: (N, 3) points in the user's own length unit.
        batch: (N,) int64 index of each point's shape, or None for one shape; checked too, so that
            every single shape has what one cloud must have.

    Raises:
        TypeError: not a tensor, or not floating.
        ValueError: wrong shape, too few points, NaN or infinity, all points of a shape equal.

    Example:
        >>> check_points(torch.zeros(2, 3))
        Traceback (most recent call last):
        ValueError: `points` must hold at least 4 points, got 2; sample the shape more densely
    """
    check_tensor("points", points)
    if points.ndim != 2 or points.shape[1] != 3:
        mend = "; for several clouds concatenate them and pass `batch`" if points.ndim == 3 else ""
        raise ValueError(f"`points` must have shape (N, 3), got {tuple(points.shape)}{mend}")
    if points.shape[0] < MIN_POINTS:
        raise ValueError(
            f"`points` must hold at least {MIN_POINTS} points, got {points.shape[0]}; "
            "sample the shape more densely"
        )
    check_finite("points", points)
    if batch is None:
        batch = points.new_zeros(points.shape[0], dtype=torch.int64)
    else:
        check_batch(batch, points.shape[0])
        check_same_device("batch", batch, points)
    _check_extent(points, batch)


def _check_extent(points: Tensor, batch: Tensor) -> None:
    """No shape of the packed cloud has all its points in one place."""
    starts = torch.searchsorted(
        batch, batch.unique()
    )  # (B,) sorted batch: first point of each shape
    first = torch.repeat_interleave(points[starts], batch.bincount(), dim=0)  # (N, 3)
    moved = torch.zeros_like(starts, dtype=torch.bool)
    moved[batch[(points != first).any(-1)]] = True
    if not moved.all():
        which = (
            "all are"
            if len(moved) == 1
            else f"those of shape {int(moved.logical_not().nonzero()[0])} are"
        )
        raise ValueError(
            f"`points` must not all be equal, {which} in one place, so the shape has no size; "
            "remove it or check how it was loaded"
        )


def check_batch(batch: Any, n: int) -> None:
    """`batch` says which shape each of `n` packed points belongs to: int64, sorted, from 0.

    Args:
        batch: (N,) index of each point's shape.
        n: N, the number of points.

    Raises:
        TypeError: not an int64 tensor.
        ValueError: wrong length, unsorted, negative, or a shape with fewer than 4 points.

    Example:
        >>> check_batch(torch.tensor([0, 0, 0, 0, 1, 1, 1, 1]), 8)
    """
    if not isinstance(batch, Tensor) or batch.dtype != torch.int64:
        got = batch.dtype if isinstance(batch, Tensor) else type(batch).__name__
        raise TypeError(
            f"`batch` must be a torch.int64 tensor, got {got}; convert with batch.long()"
        )
    if batch.shape != (n,):
        raise ValueError(
            f"`batch` must have shape ({n},), one index for each point, got {tuple(batch.shape)}"
        )
    if (batch.diff() < 0).any():
        raise ValueError(
            "`batch` must be sorted, got a decreasing step; "
            "order both with order = batch.argsort(stable=True)"
        )
    if n and batch[0] < 0:
        raise ValueError(f"`batch` must not be negative, got {int(batch[0])}; count shapes from 0")
    if n and batch[-1] >= n:
        raise ValueError(
            f"`batch` must number shapes 0, 1, 2, ..., got {int(batch[-1])} for {n} points; "
            "renumber with batch.unique(return_inverse=True)[1]"
        )
    counts = batch.bincount()
    if (counts < MIN_POINTS).any():
        i = int((counts < MIN_POINTS).nonzero()[0])
        raise ValueError(
            f"`batch` must give every shape at least {MIN_POINTS} points, got {int(counts[i])} in "
            f"shape {i}; drop that shape or renumber with batch.unique(return_inverse=True)[1]"
        )


def check_normals(normals: Any, points: Tensor) -> None:
    """`normals` are unit vectors, one a point of the cloud.

    Raises:
        TypeError: not a tensor, or not floating.
        ValueError: wrong shape, dtype or device, NaN or infinity, a normal not of length 1.

    Example:
        >>> check_normals(torch.zeros(4, 3), torch.rand(4, 3))
        Traceback (most recent call last):
        ValueError: `normals` must have length 1 within 1%, got 0; drop points without a normal
    """
    check_vectors("normals", normals, like=points)
    if normals.shape != points.shape:
        raise ValueError(
            f"`normals` must have the shape of `points` {tuple(points.shape)}, got "
            f"{tuple(normals.shape)}; pass one normal a point"
        )
    length = normals.detach().norm(dim=-1)
    if (off := (length - 1).abs()).max() > 0.01:
        raise ValueError(
            f"`normals` must have length 1 within 1%, got {float(length[off.argmax()]):g}; "
            "drop points without a normal"
        )
