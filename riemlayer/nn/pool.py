"""Pooling of features over geodesic cells, and back."""

from __future__ import annotations

import math
from typing import Literal

import torch
from torch import Tensor, nn

from riemlayer.checks import check_shapes, check_tensor
from riemlayer.nn.arguments import check_features, check_sizes
from riemlayer.nn.cells import Cells, geodesic_cells
from riemlayer.numerics import segment_max, segment_mean, segment_sum
from riemlayer.ops import LocalGeometry

REDUCES = ("mean", "max", "attention")


class GeodesicPool(nn.Module):
    """Features of far-apart points, each from the cell of points nearest to it (ours).

    Farthest point sampling and nearest kept points, both by distance along edges: see
    `geodesic_cells`. Within a cell C the features become their mean, their maximum, or

        y = sum_{i in C} softmax_C(a . x_i) x_i

    with learned a. Clouds of a packed batch do not mix.

    For layers on what is kept, ask the same surface for the edges of fewer points:

        geometry = local_geometry(surface.at(cells.index), k=16)

    Args:
        ratio: share of each cloud to keep, in (0, 1], rounded up; or
        count: points of each cloud to keep; all of those that have fewer.
        reduce: "mean", "max" or "attention".
        channels: of the features; for attention only.

    Shapes: x (N, C) -> (M, C), and the `Cells`.

    Raises:
        TypeError, ValueError: not exactly one of ratio and count is given, one is out of range,
            `reduce` is another word, channels does not go with it, `x` has another shape or dtype,
            or the cells are those of another geometry.

    >>> from riemlayer import ExpLogField
    >>> from riemlayer.ops import local_geometry
    >>> points = torch.nn.functional.normalize(torch.randn(300, 3), dim=-1)
    >>> geometry = local_geometry(ExpLogField.from_preset("tiny").encode(points), k=8)
    >>> x, cells = GeodesicPool(ratio=0.1, reduce="max")(points, geometry)
    >>> x.shape, GeodesicUnpool()(x, cells).shape
    (torch.Size([30, 3]), torch.Size([300, 3]))
    """

    def __init__(
        self,
        ratio: float | None = None,
        count: int | None = None,
        reduce: Literal["mean", "max", "attention"] = "mean",
        channels: int | None = None,
    ) -> None:
        super().__init__()
        if (ratio is None) == (count is None):
            raise ValueError(f"give either ratio or count, got ratio={ratio} and count={count}")
        if ratio is not None and not 0 < ratio <= 1:
            raise ValueError(f"ratio must lie in (0, 1], got {ratio}")
        if count is not None:
            check_sizes(count=count)
        if reduce not in REDUCES:
            raise ValueError(f"reduce must be one of {REDUCES}, got {reduce!r}")
        if (channels is not None) != (reduce == "attention"):
            raise ValueError(f"channels must be given for attention only, got {channels}")
        self.ratio, self.count, self.reduce = ratio, count, reduce
        self.score = None if channels is None else nn.Linear(channels, 1, bias=False)

    def forward(
        self, x: Tensor, geometry: LocalGeometry, cells: Cells | None = None
    ) -> tuple[Tensor, Cells]:
        """Pool `x`; `cells`, where they are known already, save the search for them."""
        check_tensor("x", x)
        check_features(x, geometry, x.shape[-1] if self.score is None else self.score.in_features)
        cells = self.cells(geometry) if cells is None else cells
        if len(cells.assignment) != len(x):
            raise ValueError(
                f"cells must be those of the geometry of {len(x)} points, "
                f"got the cells of {len(cells.assignment)}"
            )
        size = len(cells.index)
        if self.score is not None:
            return _attend(x, self.score(x), cells.assignment, size), cells
        reduce = segment_mean if self.reduce == "mean" else segment_max
        return reduce(x, cells.assignment, size), cells

    def cells(self, geometry: LocalGeometry) -> Cells:
        """The cells of a geometry; they depend on no weight."""
        sizes = geometry.batch.bincount().tolist()
        if self.ratio is not None:
            return geodesic_cells(geometry, [math.ceil(self.ratio * n) for n in sizes])
        return geodesic_cells(geometry, [min(self.count or n, n) for n in sizes])

    def extra_repr(self) -> str:
        kept = f"ratio={self.ratio}" if self.count is None else f"count={self.count}"
        return f"{kept}, reduce={self.reduce!r}"


class GeodesicUnpool(nn.Module):
    """Features of each cell's kept point for all of its points: the way back of `GeodesicPool`.

    Pooling the answer, by any of the three reductions, gives `x` again.

    Shapes: x (M, C) -> (N, C).

    Raises:
        ValueError: `x` has another number of rows than there are cells.

    >>> cells = Cells(torch.tensor([0, 2]), torch.tensor([0, 0, 1]), torch.zeros(3), torch.zeros(2))
    >>> GeodesicUnpool()(torch.tensor([[1.0], [5.0]]), cells).squeeze(-1)
    tensor([1., 1., 5.])
    """

    def forward(self, x: Tensor, cells: Cells) -> Tensor:
        check_shapes(x=(x, f"{len(cells.index)} C"))
        return x[cells.assignment]


def _attend(x: Tensor, score: Tensor, index: Tensor, size: int) -> Tensor:
    """Means (size, C) of features (N, C) weighted by the softmax of scores (N, 1) in each group."""
    weight = torch.exp(score - segment_max(score.detach(), index, size)[index])
    return segment_sum(weight * x, index, size) / segment_sum(weight, index, size)
