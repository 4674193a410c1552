"""What the network makes of the local planes: turned, shifted and weighed (ours)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from riemlayer.backbone.conv import OctreeConv
from riemlayer.geometry.planes import LocalPlanes, PlaneLevel
from riemlayer.numerics import matrix6, normalise, outer6, weighted_rows
from riemlayer.octree import Level, interpolate

LOCAL = 21
"""Channels that a node's planes are described by."""
REACH = 0.5
"""Cells that a centroid is shifted by at most, along each axis."""


class PlaneCorrection(nn.Module):
    """Corrected planes of a level: PCA's, plus what the embedding knows of the surface (ours).

    PCA rounds edges, mixes sheets that are close and believes stray points. Each node sees the
    embedding around it, its own plane and those of its neighbours, and answers with a symmetric
    matrix M, a shift s and a weight w: its normal n becomes n + M n, normalised, whatever its sign;
    its centroid c becomes c + s; and w, from 0 to 2, is what it counts in blends. Walks and fans go
    over these planes, so the losses of Exp and Log teach them. Untrained, they are PCA's.

    Shapes: z (n', C) of `leaves` -> the planes of `planes.fine`, which may lie at a finer level.
    """

    def __init__(self, embedding: int, width: int) -> None:
        super().__init__()
        self.embedding = nn.Linear(embedding, width)
        self.local = nn.Linear(LOCAL, width, bias=False)
        self.norm, self.conv = nn.LayerNorm(width), OctreeConv(width, width)
        self.out = nn.Linear(width, 10)
        nn.init.zeros_(self.conv.weight)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, z: Tensor, leaves: Level, planes: LocalPlanes) -> PlaneLevel:
        level, batch = planes.fine.level, planes.fine.level.batch()
        centroid, normal, weight = planes.fine.plane.split((3, 3, 1))
        c, n = centroid[:, :-1].T, normal[:, :-1].T
        seen, _ = interpolate(self.embedding(z), leaves, c.to(z.dtype), batch)
        x = F.gelu(seen + self.local(describe(planes, c, n, batch)))
        x = x + self.conv(F.gelu(self.norm(x)), level)
        turn, shift, counts = self.out(F.gelu(x)).to(n.dtype).split((6, 3, 1), -1)
        n = normalise(n + (matrix6(turn) @ n[..., None]).squeeze(-1))
        c = c + (REACH * level.cell_size) * (shift / REACH).tanh()
        plane = torch.cat((c, n, 2 * counts.sigmoid() * weight[:, :-1].T), -1).T
        return planes.fine._replace(plane=F.pad(plane, (0, 1)))


def describe(planes: LocalPlanes, c: Tensor, n: Tensor, batch: Tensor) -> Tensor:
    """What is told of each node's plane (n, LOCAL), without units and without sign.

    Its normal, the spread of its points, its centroid's place in the cell; the normal of the
    blended planes there and the way down to them; and the mean spread of its neighbours.
    """
    level, spread = planes.fine.level, planes.fine.spread()
    n_around, gap = planes.at(c, batch, n)
    near = level.neighbours
    exists = (near < len(level)).to(spread.dtype)
    share = exists / exists.sum(-1, keepdim=True)
    around = weighted_rows(spread, near.clamp_max(len(level) - 1), share)
    place, down = (c - level.centres().to(c.dtype)) / level.cell_size, gap / level.cell_size
    return torch.cat((outer6(n), spread, place, outer6(n_around), down.abs(), around[:, 1:]), -1)
