"""What the public calls accept: types, shapes, finiteness. The only place that words errors.

Every check returns nothing, or the sizes it worked out; none of them changes its input. A message
names the argument, what was expected, what came, and a mend.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

MIN_POINTS = 4
"""Fewer points than this span no volume and have no local plane with a residual."""


def check_tensor(name: str, x: Any) -> None:
    """`x` is a torch tensor of a real floating-point dtype.

    Args:
        name: the argument's name in the caller's signature.
        x: whatever came.

    Raises:
        TypeError: a number, a list, a numpy array, or a tensor that is not real floating point.
    """
    if not isinstance(x, Tensor):
        kind = f"{type(x).__module__}.{type(x).__qualname__}".removeprefix("builtins.")
        mend = "torch.from_numpy" if kind == "numpy.ndarray" else "torch.tensor"
        raise TypeError(
            f"`{name}` must be a torch.Tensor, got {kind}; make one with {mend}({name})"
        )
    if not x.is_floating_point():
        raise TypeError(
            f"`{name}` must have a floating-point dtype, got {x.dtype}; convert with {name}.float()"
        )


def check_finite(name: str, x: Tensor) -> None:
    """Every entry of `x` is finite.

    Raises:
        ValueError: there is a NaN or an infinity; the message counts the rows concerned.
    """
    finite = x.isfinite()
    if finite.all():
        return
    rows = finite.all(-1) if x.ndim > 1 else finite
    raise ValueError(
        f"`{name}` must be finite, got NaN or infinity in {int((~rows).sum())} of {rows.numel()} "
        f"rows; keep the good ones with {name}[{name}.isfinite().all(-1)]"
    )


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


def check_same_device(name: str, x: Tensor, like: Tensor) -> None:
    """`x` lies on the device of `like`.

    Raises:
        ValueError: it lies elsewhere.
    """
    if x.device != like.device:
        raise ValueError(
            f"`{name}` must be on device {like.device}, got {x.device}; "
            f'move it with {name}.to("{like.device}")'
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


def check_same_kind(name: str, x: Tensor, like: Tensor) -> None:
    """`x` has the dtype of `like` and lies on its device.

    Raises:
        ValueError: it does not.
    """
    if x.dtype != like.dtype:
        raise ValueError(
            f"`{name}` must have dtype {like.dtype} as the field, got {x.dtype}; "
            f"convert with {name}.to({like.dtype})"
        )
    check_same_device(name, x, like)


def check_vectors(name: str, x: Any, like: Tensor, width: int = 3) -> None:
    """`x` holds points or vectors that go with `like`: (..., 3), finite, same dtype and device.

    Args:
        name: the argument's name in the caller's signature, such as `p`, `v` or `q`.
        x: (..., 3) whatever came; no rows at all is fine.
        like: a tensor of the surface, whose dtype and device are asked for.
        width: of the last dimension.

    Raises:
        TypeError: not a tensor, or not floating.
        ValueError: wrong last dimension, dtype or device, NaN or infinity.

    Example:
        >>> check_vectors("v", torch.zeros(5, 2), like=torch.zeros(9, 3))
        Traceback (most recent call last):
        ValueError: `v` must have shape (..., 3), got (5, 2)
    """
    check_tensor(name, x)
    if x.ndim == 0 or x.shape[-1] != width:
        raise ValueError(f"`{name}` must have shape (..., {width}), got {tuple(x.shape)}")
    check_same_kind(name, x, like)
    check_finite(name, x)


def check_broadcast(**tensors: Tensor) -> torch.Size:
    """The common shape of tensors that are combined row by row.

    Args:
        tensors: two or more tensors under the names of the arguments they came as.

    Returns:
        The broadcast shape.

    Raises:
        ValueError: the shapes do not broadcast.

    Example:
        >>> p, v = torch.zeros(4, 3), torch.zeros(4, 7, 3)
        >>> check_broadcast(p=p[:, None], v=v)
        torch.Size([4, 7, 3])
    """
    try:
        return torch.broadcast_shapes(*(x.shape for x in tensors.values()))
    except RuntimeError:
        names = " and ".join(f"`{name}`" for name in tensors)
        shapes = " and ".join(str(tuple(x.shape)) for x in tensors.values())
        first = next(iter(tensors))
        raise ValueError(
            f"{names} must broadcast, got {shapes}; "
            f"for many queries a source pass {first}[:, None] of shape (S, 1, 3) beside (S, K, 3)"
        ) from None


def check_shapes(**named: tuple[Tensor, str]) -> dict[str, int]:
    """Binds axis names across arguments: equal names must have equal sizes.

    Args:
        named: argument name = (tensor, axes), the axes as words: a name such as `S`, or a
            number. A leading `...` stands for any axes at all.

    Returns:
        The size of each axis name.

    Raises:
        ValueError: a tensor does not have the axes given.

    Example:
        >>> check_shapes(p=(torch.zeros(4, 3), "S 3"), v=(torch.zeros(4, 7, 3), "S K 3"))
        {'S': 4, 'K': 7}
        >>> check_shapes(p=(torch.zeros(4, 3), "S 3"), v=(torch.zeros(5, 7, 3), "S K 3"))
        Traceback (most recent call last):
        ValueError: `v` must have shape (S, K, 3) with S=4, got (5, 7, 3)
    """
    bound: dict[str, int] = {}
    for name, (x, spec) in named.items():
        axes = spec.split()
        tail = [axis for axis in axes if axis != "..."]
        sizes = x.shape[max(x.ndim - len(tail), 0) :]
        known = {axis: bound[axis] for axis in tail if axis in bound}
        fits = len(sizes) == len(tail) and (len(tail) < len(axes) or x.ndim == len(tail))
        for axis, size in zip(tail, sizes, strict=False):
            expected = int(axis) if axis.isdecimal() else bound.setdefault(axis, size)
            fits = fits and size == expected
        if not fits:
            where = " with " + ", ".join(f"{k}={v}" for k, v in known.items()) if known else ""
            raise ValueError(
                f"`{name}` must have shape ({', '.join(axes)}){where}, got {tuple(x.shape)}"
            )
    return bound


def check_index(name: str, index: Any, size: int, like: Tensor) -> None:
    """`index` is int64 in [0, size) and broadcasts with the batch axes of `like` (..., 3).

    Raises:
        TypeError: not an int64 tensor.
        ValueError: out of range, on another device, or of a shape that does not broadcast.

    Example:
        >>> check_index("shape", torch.tensor([0, 2]), 2, like=torch.zeros(2, 3))
        Traceback (most recent call last):
        ValueError: `shape` must lie in [0, 2), got values in [0, 2]
    """
    if not isinstance(index, Tensor) or index.dtype != torch.int64:
        got = index.dtype if isinstance(index, Tensor) else type(index).__name__
        raise TypeError(f"`{name}` must be a torch.int64 tensor, got {got}; convert with .long()")
    check_same_device(name, index, like)
    if index.numel() and (int(index.min()) < 0 or int(index.max()) >= size):
        low, high = int(index.min()), int(index.max())
        raise ValueError(f"`{name}` must lie in [0, {size}), got values in [{low}, {high}]")
    check_broadcast(**{name: index[..., None], "p": like})
