"""Octree U-Net: from leaf features to the embedding of every leaf (Sec. 3.1, appendix B)."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from riemlayer.backbone.conv import OctreeConv, OctreeDown, OctreeUp
from riemlayer.backbone.stem import LeafStem, PointStem
from riemlayer.config import BackboneConfig
from riemlayer.geometry import LocalPlanes
from riemlayer.octree import Level, Octree


class ResidualBlock(nn.Module):
    """x + conv(gelu(norm(conv(gelu(norm(x)))))), with LayerNorm per node: (n, in) -> (n, out)."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.norm1, self.conv1 = nn.LayerNorm(inputs), OctreeConv(inputs, outputs)
        self.norm2, self.conv2 = nn.LayerNorm(outputs), OctreeConv(outputs, outputs)
        self.skip = nn.Linear(inputs, outputs) if inputs != outputs else nn.Identity()
        nn.init.zeros_(self.conv2.weight)

    def forward(self, x: Tensor, level: Level) -> Tensor:
        y = self.conv1(F.gelu(self.norm1(x)), level)
        return self.skip(x) + self.conv2(F.gelu(self.norm2(y)), level)


class Stage(nn.Module):
    """Residual blocks in a row."""

    def __init__(self, inputs: int, outputs: int, blocks: int) -> None:
        super().__init__()
        widths = [inputs, *[outputs] * blocks]
        self.blocks = nn.ModuleList(ResidualBlock(a, b) for a, b in pairwise(widths))

    def forward(self, x: Tensor, level: Level) -> Tensor:
        for block in self.blocks:
            x = block(x, level)
        return x


class OctreeUNet(nn.Module):
    """U-Net over the octree, from points to one embedding a leaf.

    Shapes: points (N, 3) of an octree, and what else the stem is told of them, (N, 3) normals
    -> (n, C) on the level of `config.depth`.
    """

    def __init__(self, config: BackboneConfig) -> None:
        super().__init__()
        self.config = config
        e, d = config.encoder, config.decoder
        stages = len(e) - 1
        self.stem = PointStem(config.stem, config.normals) if config.stem else LeafStem(e[0])
        self.enter = OctreeConv(config.stem or e[0], e[0])
        self.down = nn.ModuleList(OctreeDown(e[i], e[i + 1]) for i in range(stages))
        self.encode = nn.ModuleList(
            Stage(e[i + 1], e[i + 1], config.encoder_blocks[i]) for i in range(stages)
        )
        self.bottom = nn.Linear(e[-1], d[0])
        self.up = nn.ModuleList(OctreeUp(d[i], d[i + 1]) for i in range(stages))
        self.decode = nn.ModuleList(
            Stage(d[i + 1] + e[stages - 1 - i], d[i + 1], config.decoder_blocks[i])
            for i in range(stages)
        )
        self.norm = nn.LayerNorm(d[-1])
        self.head = nn.Linear(d[-1], config.embedding)

    def forward(self, points: Tensor, octree: Octree, planes: LocalPlanes, *told: Tensor) -> Tensor:
        depths = range(self.config.depth, self.config.depth - len(self.config.encoder), -1)
        levels = [octree.level(d) for d in depths]
        node = octree.node(planes.fine.level.depth)
        x = self.stem(points, octree.node(self.config.depth), levels[0], planes, node, *told)
        x = self.enter(x, levels[0])
        skips = []
        for i, (down, stage) in enumerate(zip(self.down, self.encode, strict=True)):
            skips.append(x)
            x = stage(down(x, levels[i], levels[i + 1]), levels[i + 1])
        x = self.bottom(x)
        for up, stage in zip(self.up, self.decode, strict=True):
            i = len(skips) - 1
            x = torch.cat((up(x, levels[i + 1], levels[i]), skips.pop()), -1)
            x = stage(x, levels[i])
        return self.head(F.gelu(self.norm(x)))

    def extra_repr(self) -> str:
        return f"points -> {self.config.embedding}, depth={self.config.depth}"
