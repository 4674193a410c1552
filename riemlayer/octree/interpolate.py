"""Trilinear look-up of node features at any point of the cube."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from riemlayer.numerics import weighted_rows
from riemlayer.octree.build import HALF_WIDTH, Level

PAIRS = 1 << 24
"""Pairs of query and node compared at once: 64 MB of distances."""


class Corners(NamedTuple):
    """The eight nodes around each query, and their trilinear weights."""

    node: Tensor
    """(Q, 8); n where there is no node."""
    weight: Tensor
    """(Q, 8), 0 where there is no node; they do not yet sum to 1."""

    @property
    def in_support(self) -> Tensor:
        """(Q,) bool: at least one of the eight nodes exists and counts."""
        return self.weight.sum(-1) > 1e-6


def corners(level: Level, x: Tensor, batch: Tensor) -> Corners:
    """Nodes around queries `x` (Q, 3) of shapes `batch` (Q,), differentiable in `x`.

    Queries beyond the outermost cell centres are moved onto them, so no weight is ever negative.
    """
    node, weight = corner_columns(level, x.T, batch)
    return Corners(node.T, weight.T)


def corner_columns(level: Level, x: Tensor, batch: Tensor) -> tuple[Tensor, Tensor]:
    """`corners` of columns (3, Q), as node and weight (8, Q): sums over corners are faster so."""
    t = x / level.cell_size + (HALF_WIDTH / level.cell_size - 0.5)
    cell, weight = trilinear(t.clamp(0, (1 << level.depth) - 1))
    node = level.octants(cell, batch)
    return node, weight * (node < len(level))


def trilinear(t: Tensor) -> tuple[Tensor, Tensor]:
    """Lowest of eight cells around columns (..., 3, Q), in cells, and the weights (..., 8, Q)."""
    cell = t.detach().int()
    fraction = t - cell
    wx, wy, wz = torch.stack((1 - fraction, fraction), -3).unbind(-2)  # (..., 2, Q)
    weight = (wx[..., None, :] * wy[..., None, :, :])[..., None, :] * wz[..., None, None, :, :]
    return cell, weight.flatten(-4, -2)


def nearest_node(level: Level, x: Tensor, batch: Tensor, chunk: int | None = None) -> Tensor:
    """Node (Q,) of the same shape whose centre is nearest to each query, by brute force."""
    centres, shape = level.centres().to(x.dtype), level.batch()
    parts, chunk = [], chunk or max(1, PAIRS // len(level))
    for xs, bs in zip(x.split(chunk), batch.split(chunk), strict=True):
        distance = torch.cdist(xs, centres)
        parts.append(distance.masked_fill(bs[:, None] != shape, torch.inf).argmin(-1))
    return torch.cat(parts) if parts else batch.new_zeros(0)


def interpolate(features: Tensor, level: Level, x: Tensor, batch: Tensor) -> tuple[Tensor, Tensor]:
    """Trilinear interpolation of node features at `x` (Sec. 3.1): values (Q, C), in_support (Q,).

    Weights are renormalised over the nodes that exist. A query with none of its eight nodes takes
    the feature of the nearest node of its shape and has `in_support` False.

    Args:
        features: (n, C) of `level`.
        x: (Q, 3) in the cube; differentiable.
        batch: (Q,) int64, shape of each query.
    """
    node, weight, supported = _renormalised(level, x, batch)
    if not bool(supported.all()):
        lost = ~supported
        nearest = torch.zeros_like(batch)
        nearest[lost] = nearest_node(level, x.detach()[lost], batch[lost])
        node = torch.where(lost[:, None], nearest[:, None], node)
        weight = torch.where(lost[:, None], torch.full_like(weight, 1 / 8), weight)
    return weighted_rows(features, node, weight), supported


def interpolate_or_zero(features: Tensor, level: Level, x: Tensor, batch: Tensor) -> Tensor:
    """As `interpolate`, with zeros off the support: for points that need not lie on the surface."""
    node, weight, _ = _renormalised(level, x, batch)
    return weighted_rows(features, node, weight)


def _renormalised(level: Level, x: Tensor, batch: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    node, weight = corner_columns(level, x.T, batch)
    total = weight.sum(0)
    supported = total.detach() > 1e-6
    weight = weight / total.clamp_min(1e-6)
    return node.clamp_max(len(level) - 1).T, weight.T, supported
