"""Planes of one level of the octree, and a look-up in several levels at once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from riemlayer.geometry.moments import NEGLIGIBLE, NEIGHBOURHOOD
from riemlayer.numerics import segment_sum
from riemlayer.octree import HALF_WIDTH, Level, corners
from riemlayer.octree.interpolate import trilinear

BLEND = 0.5
"""Width, in cells, of the Gaussian that blends the planes around a query."""


class PlaneLevel(NamedTuple):
    """Planes of the n nodes of a level; a last one, far away, stands for "no node"."""

    level: Level
    plane: Tensor
    """(6, n + 1): centroid, and unit normal; its sign has a meaning where the points' normals were
    given."""
    eigenvalues: Tensor
    """(n, 3) of the local covariance, ascending."""
    around: Tensor
    """(n,) points in the neighbourhood, weighted by a Gaussian: how dense the cloud is there."""
    other_side: Tensor
    """() what a plane counts whose normal points the other way: -1, for signs have no meaning; 0
    where they have one, so that the other side of a thin sheet is not seen."""
    shift: Tensor
    """() what is added to every coordinate before its node is looked up: 0 but for a staggered
    grid."""

    def facing(self, normals: Tensor, node: Tensor) -> PlaneLevel:
        """The same planes, turned to the side of most of their points' normals (N, 3) (ours)."""
        mean = segment_sum(normals, node, len(self.level))
        centroid, normal = self.plane.split(3)
        agree = (normal[:, :-1].T * mean).sum(-1)
        sign = F.pad(torch.where(agree < 0, -1.0, 1.0).to(normal.dtype), (0, 1))
        plane = torch.cat((centroid, normal * sign))
        return self._replace(plane=plane, other_side=torch.zeros_like(self.other_side))

    def nearest_of_eight(self, x: Tensor, batch: Tensor) -> Tensor:
        """Nearest (Q,) of the eight nodes around `x` (Q, 3); n where there is none."""
        node, weight = corners(self.level, x + self.shift, batch)
        return node.gather(-1, weight.argmax(-1, keepdim=True)).squeeze(-1)

    def nearest(self, x: Tensor, batch: Tensor) -> Tensor:
        """Normal (Q, 3) of the nearest of the eight nodes around `x`; 0 where there is none."""
        return self.plane[3:, self.nearest_of_eight(x, batch)].T

    def spacing(self, x: Tensor, batch: Tensor) -> Tensor:
        """Distance (Q,) from point to point, in cells, if the nearest node's were a grid on a
        sheet; no gradient. Infinite where there is no node.
        """
        around = F.pad(self.around.detach(), (0, 1))[self.nearest_of_eight(x, batch)]
        return NEIGHBOURHOOD * (2 * math.pi / around).sqrt()

    def spectra(self, x: Tensor, batch: Tensor) -> Tensor:
        """Spread (Q, 6) of the cloud around `x` along its principal axes, in cells; no gradient.

        Roots of the eigenvalues at the nearest node, and their mean over that node's neighbours:
        how thick, thin or sparse the cloud is at this scale. 0 where there is no node.
        """
        n, node = len(self.level), self.nearest_of_eight(x, batch)
        around = self.level.neighbours[node.clamp_max(n - 1)]  # (Q, 27)
        index = torch.cat((node[:, None], around), -1)
        exists = ((index < n) & (node < n)[:, None])[..., None]
        variance = self.eigenvalues.detach()[index.clamp_max(n - 1)].clamp_min(0)
        spread = variance.sqrt() * exists / self.level.cell_size  # (Q, 28, 3)
        mean = spread[:, 1:].sum(1) / exists[:, 1:].sum(1).clamp_min(1)
        return torch.cat((spread[:, 0], mean), -1)


class Grids(NamedTuple):
    """The planes of several levels G, laid out for a look-up in all of them at once."""

    levels: tuple[Level, ...]
    plane: Tensor
    """(6, sum of n + 1) of one level after the other."""
    per_unit: Tensor
    """(G, 1, 1) cells per unit length."""
    first: Tensor
    """(G, 1, 1) what is added to a coordinate in cells: a level's shift is in it."""
    last: Tensor
    """(G, 1, 1) coordinate, in cells, of the outermost cells' centres."""
    sharpness: Tensor
    """(G, 1, 1) what a squared distance from a centroid counts in the blend's exponent."""
    other_side: Tensor
    """() see `PlaneLevel`."""

    @classmethod
    def of(cls, levels: Sequence[PlaneLevel]) -> Grids:
        """Those of some levels."""
        cells = [on.level.cell_size for on in levels]
        shifts = torch.stack([on.shift for on in levels])[:, None, None]
        per_unit, last, sharpness = shifts.new_tensor(
            [
                [1 / cell for cell in cells],
                [(1 << on.level.depth) - 1 for on in levels],
                [-0.5 / (BLEND * cell) ** 2 for cell in cells],
            ]
        )[..., None, None]
        first = (shifts + HALF_WIDTH) * per_unit - 0.5
        plane = torch.cat([on.plane for on in levels], 1)
        own = tuple(on.level for on in levels)
        return cls(own, plane, per_unit, first, last, sharpness, levels[0].other_side)

    def nodes(self, x: Tensor, batch: Tensor) -> tuple[Tensor, Tensor]:
        """Planes (6, G, 8, Q) of the eight nodes around `x` (3, Q) on each grid, and trilinear
        weights (G, 8, Q)."""
        t = torch.addcmul(self.first, x, self.per_unit)  # (G, 3, Q)
        cells, weight = trilinear(t.clamp(torch.zeros_like(self.last), self.last))
        nodes, rows = [], 0
        for level, cell in zip(self.levels, cells, strict=True):
            nodes.append(level.octants(cell, batch) + rows)
            rows += len(level) + 1
        near = self.plane.index_select(1, torch.cat(nodes).flatten())
        return near.view(6, *weight.shape), weight

    def blend(self, x: Tensor, batch: Tensor, towards: Tensor, offsets: bool = False) -> Tensor:
        """Sums (5, G, Q) of oriented normals, signed distances of `x` (3, Q), and the weights.

        Each over the eight nodes around `x` on one grid; with `offsets` three more rows, the
        offsets of `x` from their centroids.
        """
        near, weight = self.nodes(x, batch)
        centroid, normal = near.split(3)  # (3, G, 8, Q)
        offset = x[:, None, None] - centroid
        exponent = offset.square().sum(0) * self.sharpness
        weight = weight * exponent.clamp_min(NEGLIGIBLE).exp()
        agree = (normal.detach() * towards.detach()[:, None, None]).sum(0)
        sign = weight * torch.where(agree < 0, self.other_side, 1.0)
        normal, weight = sign * normal, sign.abs()
        sums = [normal.sum(2), (normal * offset).sum((0, 2))[None], weight.sum(1)[None]]
        if offsets:
            sums.append((offset * weight).sum(2))
        return torch.cat(sums)
