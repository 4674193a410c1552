"""Lays broadcast base points and queries (..., 3) out as S sources with K queries each."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor
from torch.func import jvp, vmap

from riemlayer.heads import MapOutput

FAR = 1e6
"""Coordinates in the cube are held below this: squares of larger ones overflow in float32."""


def lay_out(p: Tensor, x: Tensor, shape: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Sources (S, 3), queries (S, K, 3) and the shape (S,) of each source.

    The trailing batch axes along which `p` (..., 3) and `shape` (...) have size 1 make up K.
    What is farther away than `FAR` is brought nearer.

    >>> p, v = torch.zeros(4, 1, 3), torch.zeros(4, 7, 3)
    >>> [y.shape for y in lay_out(p, v, torch.zeros(4, 1).long())]
    [torch.Size([4, 3]), torch.Size([4, 7, 3]), torch.Size([4])]
    """
    batch = torch.broadcast_shapes(p.shape[:-1], x.shape[:-1], shape.shape)
    own = torch.broadcast_shapes(p.shape[:-1], shape.shape)
    own = (1,) * (len(batch) - len(own)) + own
    split = len(batch)
    while split and own[split - 1] == 1:
        split -= 1
    s, k = math.prod(batch[:split]), math.prod(batch[split:])
    kept = batch[:split] + (1,) * (len(batch) - split)
    return (
        p.expand(*kept, 3).reshape(s, 3).clamp(-FAR, FAR),
        x.expand(*batch, 3).reshape(s, k, 3).clamp(-FAR, FAR),
        shape.expand(kept).reshape(s),
    )


def in_chunks(
    head: Callable[[Tensor, Tensor, Tensor], MapOutput],
    p: Tensor,
    x: Tensor,
    shape: Tensor,
    queries: int,
    sources: int,
) -> MapOutput:
    """`head(p, x, shape)` on at most `queries` queries and `sources` sources at once."""
    s, k = x.shape[:2]
    if s * k == 0:
        return MapOutput(torch.zeros_like(x), x.new_zeros(s, k))
    rows = min(sources, max(1, queries // k))
    outputs = []
    for i in range(0, s, rows):
        part = slice(i, i + rows)
        outputs.append(
            _concatenate([head(p[part], y, shape[part]) for y in x[part].split(queries, 1)], 1)
        )
    return _concatenate(outputs, 0)


def _concatenate(outputs: list[MapOutput], dim: int) -> MapOutput:
    if len(outputs) == 1:
        return outputs[0]
    vectors, validities = zip(*outputs, strict=True)
    return MapOutput(torch.cat(vectors, dim), torch.cat(validities, dim))


def value_and_jacobian(f: Callable[[Tensor], Tensor], x: Tensor) -> tuple[Tensor, Tensor]:
    """f(x) (..., 3) and its Jacobian (..., 3, 3) where row i of f depends on row i of x alone.

    One forward pass carries the three coordinate tangents along (forward mode).
    """

    def push(axis: Tensor) -> tuple[Tensor, Tensor]:
        value, tangent = jvp(f, (x,), (axis.expand_as(x),))  # pyright: ignore[reportAssignmentType]
        return value, tangent

    if x.numel() == 0:
        return f(x), x.new_zeros(*x.shape, 3)
    x = x.contiguous()  # forward mode refuses expanded tensors
    axes = torch.eye(3, dtype=x.dtype, device=x.device)
    return vmap(push, out_dims=(None, -1))(axes)  # pyright: ignore[reportArgumentType]
