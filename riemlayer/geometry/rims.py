"""Where a sheet may end: nodes whose neighbours leave a gap around them."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional as F

from riemlayer.geometry.frames import frame_of
from riemlayer.octree import Level

CLOSE = 0.3
"""Distance, in cells, from a node within which a neighbour's direction says nothing."""
GAP = math.radians(110)
"""Angle without a neighbour from which on a sheet may end at a node."""


@torch.no_grad()
def may_end(level: Level, plane: Tensor) -> Tensor:
    """Whether a sheet may end (n + 1,) at each node of a level; False of "no node" (ours).

    What counts is the largest angle, in the plane of the node, between the directions of two
    neighbours that follow one another. Interior nodes have no large one; nodes at rims do, and
    those of sheets and tubes that are narrower than a cell.

    Args:
        plane: (6, n + 1) centroids and normals, see `PlaneLevel`.
    """
    n, near = len(level), level.neighbours  # (n, 27)
    centroid, normal = plane.T.split(3, -1)
    offset = (centroid[near] - centroid[:n, None]) / level.cell_size
    e1, e2, _ = frame_of(normal[:n])[:, None].unbind(-1)
    x, y = (offset * e1).sum(-1), (offset * e2).sum(-1)
    known = (near < n) & (x.square() + y.square() > CLOSE**2)
    angle = torch.atan2(y, x)
    first = angle.masked_fill(~known, torch.inf).amin(-1, keepdim=True)
    angle = torch.where(known, angle, first).sort(-1).values
    following = torch.cat((angle[:, 1:], first + 2 * math.pi), -1)
    inside = (following - angle).amax(-1) < GAP  # NaN without a neighbour: not inside
    return F.pad(~inside, (0, 1))
