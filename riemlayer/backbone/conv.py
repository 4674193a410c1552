"""Octree convolutions: gather, one matrix product, a backward that gathers again (no scatter)."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from riemlayer.octree import Level

PART = 1 << 22
"""Gathered numbers multiplied at once where no gradient is asked for, 8 MB in bfloat16: blocks of
32 MB and more come fresh from the system at every call, which takes longer than the product."""


class OctreeConv(nn.Module):
    """3x3x3 convolution over the occupied nodes of a level: y_i = sum_k W_k x_{n(i, k)} + b.

    Equal to a dense 3-D convolution with zero padding, restricted to the occupied nodes. Matrix
    products run in the autocast type.

    Shapes: x (n, in) -> (n, out).

    >>> from riemlayer.octree import build_octree
    >>> tree = build_octree(torch.rand(50, 3), torch.zeros(50, dtype=torch.long), depth=3)
    >>> conv = OctreeConv(4, 8)
    >>> conv(torch.rand(len(tree.level(3)), 4), tree.level(3)).shape[1]
    8
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(_initial(27 * inputs, outputs, fan=27 * inputs))
        self.bias = nn.Parameter(torch.zeros(outputs))

    def forward(self, x: Tensor, level: Level) -> Tensor:
        x, weight = _autocast(x, self.weight)
        if torch.is_grad_enabled():
            y = _Conv.apply(x, weight, level.neighbours)
        else:
            y = _in_parts(x, weight, level.neighbours)
        return y + self.bias.to(x.dtype)

    def extra_repr(self) -> str:
        return f"{self.weight.shape[0] // 27} -> {self.weight.shape[1]}"


class OctreeDown(nn.Module):
    """2x2x2 convolution of stride 2, from a level to the next coarser one: (n, in) -> (m, out)."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(_initial(8 * inputs, outputs, fan=4 * inputs))
        self.bias = nn.Parameter(torch.zeros(outputs))

    def forward(self, x: Tensor, fine: Level, coarse: Level) -> Tensor:
        x, weight = _autocast(x, self.weight)
        return _Down.apply(x, weight, *_links(fine, coarse)) + self.bias.to(x.dtype)

    def extra_repr(self) -> str:
        return f"{self.weight.shape[0] // 8} -> {self.weight.shape[1]}"


class OctreeUp(nn.Module):
    """Transposed 2x2x2 convolution of stride 2, to the next finer level: (m, in) -> (n, out)."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(_initial(inputs, 8 * outputs, fan=inputs))
        self.bias = nn.Parameter(torch.zeros(outputs))

    def forward(self, x: Tensor, coarse: Level, fine: Level) -> Tensor:
        x, weight = _autocast(x, self.weight)
        return _Up.apply(x, weight, *_links(fine, coarse)) + self.bias.to(x.dtype)

    def extra_repr(self) -> str:
        return f"{self.weight.shape[0]} -> {self.weight.shape[1] // 8}"


def _initial(rows: int, columns: int, fan: int) -> Tensor:
    return torch.randn(rows, columns) / math.sqrt(fan)


def _autocast(x: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    device = x.device.type
    if torch.is_autocast_enabled(device):
        dtype = torch.get_autocast_dtype(device)
        return x.to(dtype), weight.to(dtype)
    return x, weight


def _links(fine: Level, coarse: Level) -> tuple[Tensor, Tensor]:
    """Children (m, 8) of the coarse nodes, and the place (n,) of each fine node among them."""
    assert fine.parent is not None and coarse.children is not None  # adjacent levels of one octree
    return coarse.children, fine.parent * 8 + (fine.key & 7)


def _columns(x: Tensor, index: Tensor) -> Tensor:
    """Rows of x (n, C) named by index (m, k), side by side as (m, k C); row n is zeros."""
    padded = torch.cat((x, x.new_zeros(1, x.shape[1])))
    return padded.index_select(0, index.flatten()).view(len(index), -1)


def _in_parts(x: Tensor, weight: Tensor, neighbours: Tensor) -> Tensor:
    """What `_Conv` answers, for when nothing has to be kept for a gradient."""
    padded = torch.cat((x, x.new_zeros(1, x.shape[1])))
    parts = [
        padded.index_select(0, index.flatten()).view(len(index), -1) @ weight
        for index in neighbours.split(max(1, PART // len(weight)))
    ]
    return torch.cat(parts)


class _Conv(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x: Tensor, weight: Tensor, neighbours: Tensor) -> Tensor:
        columns = _columns(x, neighbours)  # (n, 27 C)
        ctx.save_for_backward(columns, weight, neighbours)
        return columns @ weight

    @staticmethod
    def backward(ctx, grad: Tensor):
        columns, weight, neighbours = ctx.saved_tensors
        grad = grad.contiguous()
        dx = dw = None
        if ctx.needs_input_grad[0]:  # x_j met W_k at the node that j sees at the mirrored offset
            blocks = weight.unflatten(0, (27, -1)).flip(0)  # (27, C, D)
            dx = _columns(grad, neighbours) @ blocks.mT.flatten(0, 1)  # (n, C)
        if ctx.needs_input_grad[1]:
            dw = columns.mT @ grad
        return dx, dw, None


class _Down(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x: Tensor, weight: Tensor, children: Tensor, place: Tensor) -> Tensor:
        columns = _columns(x, children)  # (m, 8 C)
        ctx.save_for_backward(columns, weight, place)
        return columns @ weight

    @staticmethod
    def backward(ctx, grad: Tensor):
        columns, weight, place = ctx.saved_tensors
        spread = (grad @ weight.mT).view(8 * len(columns), -1)  # (8 m, C)
        return spread.index_select(0, place), columns.mT @ grad, None, None


class _Up(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x: Tensor, weight: Tensor, children: Tensor, place: Tensor) -> Tensor:
        ctx.save_for_backward(x, weight, children)
        return (x @ weight).view(8 * len(x), -1).index_select(0, place)  # (n, D)

    @staticmethod
    def backward(ctx, grad: Tensor):
        x, weight, children = ctx.saved_tensors
        columns = _columns(grad.contiguous(), children)  # (m, 8 D)
        return columns @ weight.mT, x.mT @ columns, None, None
