"""From points to leaf features."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from riemlayer.geometry import LocalPlanes
from riemlayer.numerics import outer6, segment_max, segment_mean, segment_sum
from riemlayer.octree import Level

POINT_FEATURES = 20


class PointStem(nn.Module):
    """Sub-cell surface position: a small MLP per point, pooled per leaf (ours).

    Each point is described by its offset in the leaf with second-order terms and by the local plane
    it lies on (normal without sign, shape of the covariance, offset from the centroid); the MLP's
    mean and maximum over the leaf join the mean offset and the logarithm of the count. Only local
    offsets enter, so a shift by whole cells changes nothing. With `normals` it sees the points'
    oriented normals too.

    Shapes: points (N, 3), normals (N, 3) -> (n, width); `leaf` (N,), `planes` of the level below
    the leaves.
    """

    def __init__(self, width: int, normals: bool = False) -> None:
        super().__init__()
        inputs = POINT_FEATURES + 3 * normals
        self.points = nn.Sequential(
            nn.Linear(inputs, width), nn.GELU(), nn.Linear(width, width), nn.GELU()
        )
        self.join = nn.Linear(2 * width + 4, width)

    def forward(
        self,
        points: Tensor,
        leaf: Tensor,
        level: Level,
        planes: LocalPlanes,
        node: Tensor,
        *normals: Tensor,
    ) -> Tensor:
        offset, summary = leaf_summary(points, leaf, level)
        plane = planes.point_features(points, node)  # (N, 11)
        x = self.points(torch.cat((offset, outer6(offset), plane, *normals), -1))
        pooled = (segment_mean(x, leaf, len(level)), segment_max(x, leaf, len(level)))
        return self.join(torch.cat((*pooled, summary.to(x.dtype)), -1))


class LeafStem(nn.Module):
    """The paper's octree input: mean offset in the leaf and the logarithm of its count."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.join = nn.Linear(4, width)

    def forward(
        self, points: Tensor, leaf: Tensor, level: Level, planes: LocalPlanes, node: Tensor
    ) -> Tensor:
        return self.join(leaf_summary(points, leaf, level)[1])


def leaf_summary(points: Tensor, leaf: Tensor, level: Level) -> tuple[Tensor, Tensor]:
    """Offsets (N, 3) of points in their leaves, in [-1, 1]; per leaf, mean offset and log count."""
    offset = (points - level.centres().to(points.dtype)[leaf]) * (2 / level.cell_size)
    count = segment_sum(torch.ones_like(points[:, :1]), leaf, len(level))
    mean = segment_sum(offset, leaf, len(level)) / count
    return offset, torch.cat((mean, count.log()), -1)
