"""Checks of tensors: kind, shape, broadcasting, indices."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor


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
