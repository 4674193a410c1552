"""PointNet in the place of the octree U-Net: the ablation of Tab. 5."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from riemlayer.config import BackboneConfig
from riemlayer.geometry import LocalPlanes
from riemlayer.numerics import segment_max, segment_mean
from riemlayer.octree import Octree


class PointNet(nn.Module):
    """PointNet (Qi et al. 2017) for segmentation, averaged over the octree's leaves (Tab. 5).

    The first half of an MLP per point makes local features; its second half is pooled by maximum
    over the cloud; both, concatenated, pass another MLP, whose mean over a leaf's points becomes
    the leaf's embedding. So the octree serves for look-up alone. Unlike `OctreeUNet` it sees where
    the points lie in the cube: a shift within the cube changes its answer (one of the whole cloud
    does not, `encode` centres it). Departures: LayerNorm for BatchNorm, so that a cloud has the
    same embedding alone and in a batch; GELU for ReLU; no learned rotations (T-Nets).

    Args:
        config: `encoder` gives the widths before the pool, `decoder` those after it.

    Shapes: points (N, 3) of an octree -> (n, C) on the level of `config.depth`.

    >>> from riemlayer.geometry import local_planes
    >>> from riemlayer.octree import build_octree
    >>> points = torch.rand(50, 3)
    >>> tree = build_octree(points, torch.zeros(50, dtype=torch.long), depth=6, coarsest=2)
    >>> net = PointNet(BackboneConfig(kind="pointnet"))
    >>> net(points, tree, local_planes(points, tree)).shape == (len(tree.level(5)), 256)
    True
    """

    def __init__(self, config: BackboneConfig) -> None:
        super().__init__()
        self.config = config
        e, d = config.encoder, config.decoder
        half = (len(e) + 1) // 2
        self.points = _perceptron(3, *e[:half])
        self.lift = _perceptron(*e[half - 1 :])
        self.local = nn.Linear(e[half - 1], d[0])
        self.whole = nn.Linear(e[-1], d[0], bias=False)
        self.decode = _perceptron(*d)
        self.norm = nn.LayerNorm(d[-1])
        self.head = nn.Linear(d[-1], config.embedding)

    def forward(self, points: Tensor, octree: Octree, planes: LocalPlanes) -> Tensor:
        level, leaf = octree.level(self.config.depth), octree.node(self.config.depth)
        shape = level.batch()[leaf]
        with torch.autocast(points.device.type, enabled=False):  # bfloat16 blurs positions
            x = self.points(points)
        whole = segment_max(self.lift(x), shape, level.batch_size)
        x = self.local(x) + self.whole(whole)[shape]  # a linear map of both, concatenated
        x = segment_mean(self.decode(x), leaf, len(level))
        return self.head(F.gelu(self.norm(x)))

    def extra_repr(self) -> str:
        return f"points -> {self.config.embedding}, depth={self.config.depth}"


def _perceptron(*widths: int) -> nn.Sequential:
    layers = []
    for a, b in pairwise(widths):
        layers += [nn.Linear(a, b), nn.LayerNorm(b), nn.GELU()]
    return nn.Sequential(*layers)
