"""Moments of a cloud's points in the nodes of an octree, and in their neighbourhoods."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from riemlayer.numerics import outer6, segment_sum, weighted_rows
from riemlayer.octree import Level

NEIGHBOURHOOD = 0.85
"""Width, in cells, of the Gaussian that weights the neighbours' moments."""
NEGLIGIBLE = -80.0
"""Exponents are held above this: where `exp` underflows it is 30 times slower."""


class Moments(NamedTuple):
    """Points of each of n groups: how many, where, and how they scatter.

    Second moments are taken about a point nearby: about the origin they would lose four digits.
    """

    mass: Tensor
    """(n, 1)"""
    centroid: Tensor
    """(n, 3)"""
    scatter: Tensor
    """(n, 6) sum of the outer products of the offsets from the centroid."""

    def merged(self, group: Tensor, size: int) -> Moments:
        """Moments of `size` larger groups, given the one (n,) that each group belongs to."""
        mass = segment_sum(self.mass, group, size)
        centroid = segment_sum(self.mass * self.centroid, group, size) / mass
        offset = self.centroid - centroid[group]
        scatter = segment_sum(self.scatter + self.mass * outer6(offset), group, size)
        return Moments(mass, centroid, scatter)

    def around(self, level: Level) -> Moments:
        """Sums over 27 neighbours, weighted by the distance between centroids."""
        index = level.neighbours.flatten()
        own = torch.cat((self.mass, self.centroid), -1)
        near = torch.cat((own, own.new_zeros(1, 4))).T.index_select(1, index).view(4, -1, 27)
        offset = near[1:] - self.centroid.T[..., None]  # (3, n, 27)
        exponent = offset.square().sum(0) * (-0.5 / (NEIGHBOURHOOD * level.cell_size) ** 2)
        weight = exponent.clamp_min(NEGLIGIBLE).exp()
        scatter = torch.cat((self.scatter, self.scatter.new_zeros(1, 6)))
        scatter = weighted_rows(scatter, level.neighbours, weight)
        weight = near[0] * weight
        mass = weight.sum(-1, keepdim=True)
        mean = (weight * offset).sum(-1).T / mass
        x, y, z = offset - mean.T[..., None]
        xw, yw, zw = weight * x, weight * y, weight * z
        pairs = (xw * x, yw * y, zw * z, xw * y, xw * z, yw * z)
        scatter = scatter + torch.stack([pair.sum(-1) for pair in pairs], -1)
        return Moments(mass, self.centroid + mean, scatter)
