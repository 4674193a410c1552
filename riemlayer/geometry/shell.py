"""The shell around a cloud that a source beside it lies on, as on the hull of a soup (ours)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from riemlayer.geometry.grids import FINE
from riemlayer.geometry.moments import NEGLIGIBLE
from riemlayer.geometry.planes import LocalPlanes, Sight
from riemlayer.geometry.site import Place, place_of
from riemlayer.numerics import normalise

DISC = 0.7
"""Radius, in cells, of the discs that the shell keeps its distance from."""
SOFT = 0.4
"""Width, in cells, over which distances to several discs are blended."""
LEAST = 1e-6
"""Trilinear weight that discs count with at least: where all others are far, the derivative of the
nearest one's share is one over its weight."""
REACH = 2.0
"""Distance, in cells, from which on there is no shell."""
LOW, HIGH = 0.1, 0.2
"""Heights of a source, in cells, up to which it is on the cloud, and from which on on a shell."""


class Shell(NamedTuple):
    """Level sets of the distance from a cloud, one through each of S sources.

    Each node of the planes stands for a disc around its centroid. Unlike planes, level sets have
    two sides: they lead round rims of sheets and up walls that stand on them. To walks and fans
    they are what planes are, if queries come with the index of their source for a batch.
    """

    planes: LocalPlanes
    shape: Tensor
    """(S,) int64, shape of each source."""
    level: Tensor
    """(S, 1) distance of the sources from the cloud."""

    @classmethod
    def through(cls, planes: LocalPlanes, p: Tensor, shape: Tensor) -> Shell:
        """Through the sources (S, 3)."""
        return cls(planes, shape, distance(planes, p, shape)[0])

    def site(self, source: Place) -> Place:
        """See `LocalPlanes.site`; nothing is gathered here."""
        return source

    def cell(self, source: Place) -> float:
        """Cell size of the planes, the same at all sources."""
        return self.planes.fine.level.cell_size

    def plane(self, p: Tensor, source: Place) -> tuple[Tensor, Tensor]:
        """Unit normals (Q, 3) of the shells at the sources, which lie on them: heights of 0."""
        return distance(self.planes, p, self.shape[place_of(source)])[1], torch.zeros_like(p[:, :1])

    def look(self, x: Tensor, source: Place, towards: Tensor) -> Sight:
        """What a walk on the shells of its sources sees at `x` (Q, 3)."""
        away, normal = distance(self.planes, x, self.shape[place_of(source)])
        near = (away < REACH * self.cell(source)).to(x.dtype)
        gap = near * (away - self.level[place_of(source)])
        return Sight(torch.where(near > 0, normal, towards), gap, near, torch.zeros_like(x))


def distance(planes: LocalPlanes, x: Tensor, batch: Tensor) -> tuple[Tensor, Tensor]:
    """Distance (Q, 1) of `x` (Q, 3) from the discs around it, and its direction (Q, 3).

    A blend over the nodes around `x` of the two fine grids, in which the nearest disc prevails.
    """
    nodes = planes.grids.nodes(x.T, batch, FINE)
    node, weight = (y.flatten(0, 1) for y in nodes[:2])  # (16, Q)
    near = planes.grids.plane.index_select(1, node.flatten())
    centroid, normal = near.view(6, *node.shape).split(3)
    cell = planes.fine.level.cell_size
    chord = x.T[:, None] - centroid
    height = (normal * chord).sum(0) * normal
    flat = chord - height
    spread = _norm(flat, cell)
    away = height + (1 - DISC * cell / spread).clamp_min(0) * flat
    gap = _norm(away, cell)
    nearer = (gap - gap.detach().amin(0)) / (-SOFT * cell)
    weight = weight.clamp_min(LEAST) * nearer.clamp_min(NEGLIGIBLE).exp()
    weight = weight / weight.sum(0)
    outwards = (weight * away / gap).sum(1)
    return (weight * gap).sum(0)[:, None], normalise(outwards.T)


def on_shell(height: Tensor, cell: float) -> Tensor:
    """Share, from 0 to 1, of the shell at sources of these heights above the finest planes."""
    t = ((height.abs() / cell - LOW) / (HIGH - LOW)).clamp(0, 1)
    return t.square() * (3 - 2 * t)


def _norm(x: Tensor, cell: float) -> Tensor:
    """|x| over the first axis, rounded off at 0 below a thousandth of a cell."""
    return (x.square().sum(0) + (1e-3 * cell) ** 2).sqrt()
