"""Moments of a cloud's points around any place, which tell its tangent plane more sharply."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from riemlayer.geometry.grids import PlaneLevel, spacing_of
from riemlayer.numerics import dot, outer6, smallest_eigenvector, symmetric_eigenvalues
from riemlayer.octree import HALF_WIDTH, Level, Octree
from riemlayer.octree.build import NEIGHBOURS, cell_of

REACHES = (1.5, 2.6)
"""Radii of the neighbourhoods, in distances from point to point: of about 7 and 21 points."""
CLOSEST = 0.15
"""Least distance from point to point, in cells: points of denser clouds are left out, so that what
is asked of them costs no more."""
TIE = 1e-3
"""Second eigenvalue, in squared radii, below which a neighbourhood is a point or a line."""
FLAT = 1e-12
"""Least eigenvalue, in squared radii, below which a neighbourhood is flat."""
ENOUGH = 0.05
"""Moment about the axis of least but one, in squared radii, of points that are enough: of seven
around a place it is 0.2."""
SAYS = 6
"""Channels that a neighbourhood says of itself."""


class Neighbourhood(NamedTuple):
    """What the points around Q places say of the tangent plane there."""

    normal: Tensor
    """(Q, 3) unit normals without a sign."""
    says: Tensor
    """(Q, SAYS) how many points count, how they spread, how far the place is from their mean, and
    the radius."""
    enough: Tensor
    """(Q, 1) 1 where they span a plane, down to 0 where they are too few or on a line."""


class Points(NamedTuple):
    """A packed cloud, sorted by the nodes of one level of its octree, without what is too dense."""

    level: Level
    xyz: Tensor
    """(3, M) in the order of the nodes."""
    start: Tensor
    """(n + 2,) int64, where the points of each node begin; those of "no node" at the end: none."""

    @classmethod
    def of(cls, points: Tensor, octree: Octree, plane: PlaneLevel) -> Points:
        """Sort `points` (N, 3), from which `octree` was built, by the nodes of `plane`."""
        node, order = octree.node(plane.level.depth).sort(stable=True)
        count = node.bincount(minlength=len(plane.level) + 1)
        rank = torch.arange(len(node), device=node.device) - (count.cumsum(0) - count)[node]
        share = (spacing_of(plane.around.detach().double()) / CLOSEST).square().clamp_max(1)[node]
        kept = (share * (rank + 1)).ceil() > (share * rank).ceil()  # evenly, and the first
        count = torch.zeros_like(count).index_add(0, node, kept.long())
        start = torch.cat((count.new_zeros(1), count.cumsum(0)))
        return cls(plane.level, points[order[kept]].T.contiguous(), start)

    def map(self, change: Callable[[Tensor], Tensor]) -> Points:
        """The same with `change` applied to every tensor."""
        return Points(self.level.map(change), change(self.xyz), change(self.start))

    def within(self, x: Tensor, shape: Tensor, radius: Tensor) -> tuple[Tensor, Tensor]:
        """Row (P,) and offset (3, P) from `x` (Q, 3) of every point within a radius (Q,) of it.

        The radius is at most one cell: so far the 27 nodes around a place reach.
        """
        inside = x.detach().clamp(-HALF_WIDTH, HALF_WIDTH)
        cell = cell_of(inside, self.level.depth).clamp_max((1 << self.level.depth) - 1)
        node = self.level.around(cell, shape, NEIGHBOURS.to(x.device))
        rows, near = (node < len(self.level)).nonzero(as_tuple=True)
        node = node[rows, near]
        first, count = self.start[node], self.start[node + 1] - self.start[node]
        end = count.cumsum(0)
        step, row = torch.stack((first - (end - count), rows)).repeat_interleave(count, 1)
        point = step + torch.arange(len(step), device=x.device)
        offset = self.xyz.index_select(1, point) - x.T.index_select(1, row)
        limit = radius.square().index_select(0, row)
        away = offset.detach()
        near = (dot(away, away, 0) < limit).nonzero().squeeze(-1)
        return row.index_select(0, near), offset.index_select(1, near)

    def normals(self, x: Tensor, shape: Tensor, plane: PlaneLevel) -> list[Neighbourhood]:
        """Neighbourhoods of `x` (Q, 3) of each radius in `REACHES`.

        Weights are (1 - d^2 / h^2)^2 within the radius h: normals move smoothly with `x`.

        Args:
            plane: of the same level; it knows how dense the cloud is.
        """
        spacing = plane.spacing(x.detach(), shape).clamp(CLOSEST, 1.0)
        radii = [(reach * spacing).clamp_max(1.0) for reach in REACHES]  # in cells
        row, offset = self.within(x, shape, self.level.cell_size * radii[-1])
        sums = _sums(offset / self.level.cell_size, row, radii)
        mass, mean, scatter = sums.split((1, 3, 6), -1)  # (Q, ...) of each radius, in turn
        some = mass.clamp_min(1e-6)
        mean = mean / some
        covariance = (scatter / some - outer6(mean)).double()
        values = symmetric_eigenvalues(covariance.detach())
        alone = values[:, 1:2] < TIE
        tie = covariance.new_tensor([2.0, 1, 0, 0, 0, 0]) * (10 * TIE)
        settled = torch.where(alone, covariance + tie, covariance)
        spectrum = symmetric_eigenvalues(settled)
        normal = smallest_eigenvector(settled, spectrum[:, 0]).to(x.dtype)
        values = torch.where(alone, values, spectrum)[:, :2].to(x.dtype)
        spread = values.clamp_min(FLAT).sqrt()
        away = (mean * normal).sum(-1, keepdim=True).abs(), mean.square().sum(-1, keepdim=True)
        says = torch.cat((mass / (mass + 4), spread, *away, torch.cat(radii)[:, None]), -1)
        enough = (mass * values[:, 1:] / ENOUGH).clamp(0, 1)
        parts = (y.chunk(len(radii)) for y in (normal, says, enough))
        return [Neighbourhood(*part) for part in zip(*parts, strict=True)]


def _sums(offset: Tensor, row: Tensor, radii: Sequence[Tensor]) -> Tensor:
    """Sums (R Q, 10) over rows of the weights of `offset` (3, P), of them times offsets and times
    their products, in units of each of R radii (Q,) in turn.

    Added up by columns, which is faster than by rows.
    """
    x, y, z = offset
    square = dot(offset, offset, 0)
    moments = torch.stack((torch.ones_like(x), x, y, z, x * x, y * y, z * z, x * y, x * z, y * z))
    sums = []
    for h in radii:
        weight = (1 - square / h.square().index_select(0, row)).clamp_min(0).square()
        total = moments.new_zeros(10, len(h)).index_add(1, row, moments * weight)
        sums.append(total.T / torch.stack([torch.ones_like(h)] + [h] * 3 + [h * h] * 6, -1))
    return torch.cat(sums)
