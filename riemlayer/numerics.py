"""Safe norms, scatter-free segment reductions and the linear algebra of 3x3 matrices."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

import torch
from torch import Tensor
from torch.autograd.graph import saved_tensors_hooks
from torch.nn import functional as F
from torch.utils.checkpoint import checkpoint

T = TypeVar("T")


def safe_norm(x: Tensor) -> Tensor:
    """|x| along the last axis (kept), with a finite gradient at 0 (ours).

    The square is clamped before the root: clamping the root would leave a NaN gradient at 0.

    >>> safe_norm(torch.tensor([[3.0, 4.0], [0.0, 0.0]])).squeeze(-1).round(decimals=4)
    tensor([5., 0.])
    """
    return x.square().sum(-1, keepdim=True).clamp_min(torch.finfo(x.dtype).tiny).sqrt()


def falloff(d: Tensor) -> Tensor:
    """Eq. (9): (max(0, 1 - d^2))^2, from 1 at the centre of a chart to 0 at its border d = 1."""
    return (1 - d.square()).clamp_min(0).square()


def normalise(x: Tensor) -> Tensor:
    """x / |x| along the last axis; the zero vector stays zero."""
    return x / x.square().sum(-1, keepdim=True).clamp_min(1e-24).sqrt()


def dot(a: Tensor, b: Tensor, dim: int = -1) -> Tensor:
    """Inner products along a dimension of three: of columns faster than a product and its sum.

    >>> dot(torch.tensor([1.0, 2.0, 3.0]), torch.tensor([4.0, 5.0, 6.0]))
    tensor(32.)
    """
    (x, y, z), (u, v, w) = a.unbind(dim), b.unbind(dim)
    return torch.addcmul(torch.addcmul(x * u, y, v), z, w)


def product(first: Tensor, *others: Tensor) -> Tensor:
    """Matrix product of all, in their own precision: halves of autocast are for networks (ours)."""
    with torch.autocast(first.device.type, enabled=False):
        for other in others:
            first = first @ other
    return first


def recomputed(function: Callable[..., T], *args: object) -> T:
    """function(*args), of which the graph is made anew by the backward pass instead of kept (ours).

    Transforms of `torch.func` cannot do that: under them the graph is kept.

    >>> x = torch.tensor([3.0], requires_grad=True)
    >>> recomputed(torch.square, x).backward()
    >>> x.grad
    tensor([6.])
    """
    if not torch.is_grad_enabled():
        return function(*args)
    try:
        with saved_tensors_hooks(lambda x: x, lambda x: x):
            pass  # to ask whether hooks, which checkpoints need, are allowed here
    except RuntimeError:
        return function(*args)
    found: Any = checkpoint(function, *args, use_reentrant=False, preserve_rng_state=False)
    return found


def segment_sum(x: Tensor, index: Tensor, size: int) -> Tensor:
    """Sum of the rows of `x` (N, C) with the same `index` (N,): (size, C); empty groups give 0."""
    return x.new_zeros(size, *x.shape[1:]).index_add(0, index, x)


def segment_mean(x: Tensor, index: Tensor, size: int) -> Tensor:
    """Mean of the rows of `x` (N, C) with the same `index` (N,): (size, C); empty groups give 0."""
    count = segment_sum(x.new_ones(len(x), 1), index, size)
    return segment_sum(x, index, size) / count.clamp_min(1)


def segment_max(x: Tensor, index: Tensor, size: int) -> Tensor:
    """Maximum of the rows of `x` (N, C) with the same `index` (N,): (size, C); empty groups give 0.

    Rows that tie for a maximum share its gradient equally.
    """
    return _SegmentMax.apply(x, index, size)


class _SegmentMax(torch.autograd.Function):
    """Backward compares with the maximum: 20 times faster on a CPU than `scatter_reduce`'s own."""

    @staticmethod
    def forward(ctx, x: Tensor, index: Tensor, size: int) -> Tensor:
        out = x.new_zeros(size, x.shape[1])
        out = out.scatter_reduce(0, index[:, None].expand_as(x), x, "amax", include_self=False)
        ctx.save_for_backward(x, index, out)
        return out

    @staticmethod
    def backward(ctx, grad: Tensor):
        x, index, out = ctx.saved_tensors
        hit = (x == out[index]).to(x.dtype)
        ties = segment_sum(hit, index, len(out)).clamp_min(1)
        return hit * (grad / ties)[index], None, None


def weighted_rows(table: Tensor, index: Tensor, weight: Tensor) -> Tensor:
    """Weighted sums of table rows, sum_k weight[q, k] table[index[q, k]]: (n, C), (Q, k) -> (Q, C).

    Fused on the way forward; differentiable in `table` and `weight`, also in forward mode.

    >>> weighted_rows(torch.eye(3), torch.tensor([[0, 2]]), torch.tensor([[0.5, 0.25]]))
    tensor([[0.5000, 0.0000, 0.2500]])
    """
    if not torch.is_grad_enabled():
        with suppress(NotImplementedError):  # forward mode, which goes on below
            return F.embedding_bag(index, table, per_sample_weights=weight, mode="sum")
    return _WeightedRows.apply(table, index, weight)  # pyright: ignore[reportReturnType]


class _WeightedRows(torch.autograd.Function):
    """`embedding_bag` forward, which makes no (Q, k, C) intermediate: 10 times faster than rows."""

    generate_vmap_rule = True

    @staticmethod
    def forward(table: Tensor, index: Tensor, weight: Tensor) -> Tensor:
        return F.embedding_bag(index, table, per_sample_weights=weight, mode="sum")

    @staticmethod
    def setup_context(ctx, inputs, output) -> None:
        ctx.save_for_backward(*inputs)
        ctx.save_for_forward(*inputs)

    @staticmethod
    def backward(ctx, grad: Tensor):
        table, index, weight = ctx.saved_tensors
        to_table = to_weight = None
        if ctx.needs_input_grad[0]:
            spread = (grad[:, None] * weight[..., None]).flatten(0, 1)
            to_table = torch.zeros_like(table).index_add(0, index.flatten(), spread)
        if ctx.needs_input_grad[2]:
            to_weight = (table[index] * grad[:, None]).sum(-1)
        return to_table, None, to_weight

    @staticmethod
    def jvp(ctx, table_t: Tensor | None, _, weight_t: Tensor | None) -> Tensor:
        table, index, weight = ctx.saved_tensors
        out = torch.zeros_like(table[index[:, 0]])
        if table_t is not None:
            out = out + (table_t[index] * weight[..., None]).sum(1)
        if weight_t is not None:
            out = out + (table[index] * weight_t[..., None]).sum(1)
        return out


def in_columns(x: Tensor) -> Tensor:
    """`x` (..., 3) with all first coordinates stored first, then all second ones, then all third.

    Elementwise work keeps that order, and sums over the coordinates are several times faster so.
    """
    return x.movedim(-1, 0).contiguous().movedim(0, -1)


def outer6(n: Tensor) -> Tensor:
    """The six entries (xx, yy, zz, xy, xz, yz) of n n^T: a normal without its sign."""
    x, y, z = n.unbind(-1)
    return torch.stack((x * x, y * y, z * z, x * y, x * z, y * z), -1)


def symmetric_eigenvalues(m: Tensor) -> Tensor:
    """Eigenvalues, ascending, of symmetric matrices given by six entries: (..., 6) -> (..., 3).

    Closed form (Smith 1961): 20 times faster on a CPU than a batched `eigh` of 3x3 matrices.

    >>> symmetric_eigenvalues(torch.tensor([3.0, 1.0, 2.0, 0.0, 0.0, 0.0])).round(decimals=4)
    tensor([1., 2., 3.])
    """
    a, b, c, d, e, f = m.unbind(-1)
    mean = (a + b + c) / 3
    off = d * d + e * e + f * f
    spread = ((a - mean) ** 2 + (b - mean) ** 2 + (c - mean) ** 2 + 2 * off) / 6
    p = spread.clamp_min(torch.finfo(m.dtype).tiny).sqrt()
    a, b, c, d, e, f = ((x / p) for x in (a - mean, b - mean, c - mean, d, e, f))
    half_det = (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)) / 2
    limit = 1 - 4 * torch.finfo(m.dtype).eps  # acos has no finite slope at 1
    phi = torch.acos(half_det.clamp(-limit, limit)) / 3
    high = mean + 2 * p * torch.cos(phi)
    low = mean + 2 * p * torch.cos(phi + 2 * math.pi / 3)
    return torch.stack((low, 3 * mean - low - high, high), -1)


def smallest_eigenvector(m: Tensor, low: Tensor) -> Tensor:
    """Unit eigenvector of symmetric matrices (..., 6) for their smallest eigenvalue `low` (...,).

    The largest of the three cross products of the rows of m - low I. Where the matrix is isotropic
    (no direction stands out) the answer is the z axis.
    """
    a, b, c, d, e, f = m.unbind(-1)
    rows = torch.stack((a - low, d, e, d, b - low, f, e, f, c - low), -1).unflatten(-1, (3, 3))
    crosses = torch.linalg.cross(rows, rows.roll(1, -2))  # (..., 3, 3)
    squares = crosses.square().sum(-1)
    best = squares.argmax(-1, keepdim=True)
    n = crosses.gather(-2, best[..., None].expand(*best.shape, 3)).squeeze(-2)
    scale = torch.finfo(m.dtype).eps * m[..., :3].sum(-1, keepdim=True).square()
    flat = squares.gather(-1, best) > scale.square()
    z_axis = torch.zeros_like(n)
    z_axis[..., 2] = 1
    return torch.where(flat, normalise(torch.where(flat, n, z_axis)), z_axis)
