"""Weighted sums of the features of many points, without a row of features for each edge."""

from __future__ import annotations

from typing import NamedTuple, Self

import torch
from torch import Tensor
from torch.nn import functional as F


class Sums(NamedTuple):
    """Which points add up to which row: a sparse matrix (rows, N) but for its values.

    >>> sums = Sums.of(torch.tensor([0, 1, 1]), torch.tensor([2, 0, 2]), rows=3)
    >>> sums.weighted(torch.tensor([[1.0], [10.0]]), torch.tensor([1.0, 0.5, 2.0])).squeeze(-1)
    tensor([ 5.,  0., 21.])
    """

    order: Tensor
    """(P,) int64 that sorts the entries by their row."""
    point: Tensor
    """(P,) int64, point of each sorted entry."""
    start: Tensor
    """(rows,) int64, first sorted entry of each row."""

    @classmethod
    def of(cls, point: Tensor, row: Tensor, rows: int) -> Self:
        """Entries `point`, `row` of any equal shape."""
        order = row.flatten().argsort(stable=True)
        count = row.flatten().bincount(minlength=rows)
        return cls(order, point.flatten()[order], count.cumsum(0) - count)

    def weighted(self, x: Tensor, weight: Tensor) -> Tensor:
        """sum_k weight_k x[point_k] for each row: (N, C), weights like the entries -> (rows, C).

        Fused: the (P, C) products, hundreds of MB for a large cloud, are never in memory. Empty
        rows give 0. Differentiable once, in `x` and in `weight`.
        """
        weight = weight.flatten()[self.order]
        x = x.to(weight.dtype)
        return F.embedding_bag(self.point, x, self.start, mode="sum", per_sample_weights=weight)

    def weighted_complex(self, x: Tensor, radius: Tensor, angle: Tensor) -> Tensor:
        """The same of complex features (N, C) with the weights radius e^{i angle}."""
        table = torch.view_as_real(x).flatten(1)  # (N, 2 C)
        a, b = (self.weighted(table, radius * y) for y in (angle.cos(), angle.sin()))
        a, b = (torch.view_as_complex(y.unflatten(1, (-1, 2)).contiguous()) for y in (a, b))
        return a + 1j * b
