"""Planes of one level of the octree, and a look-up in three levels at once."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import accumulate
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from riemlayer.geometry.moments import NEGLIGIBLE, NEIGHBOURHOOD
from riemlayer.geometry.rims import may_end
from riemlayer.geometry.site import Place, Site
from riemlayer.numerics import dot, segment_sum
from riemlayer.octree import HALF_WIDTH, Level, corners
from riemlayer.octree.build import DENSE_LIMIT, OCTANTS
from riemlayer.octree.interpolate import trilinear

BLEND = 0.5
"""Width, in cells, of the Gaussian that blends the planes around a query."""
FINE, COARSE, ALL = slice(0, 2), slice(2, 3), slice(0, 3)
"""Of the three grids of a scale the fine ones, of which the second is staggered, and the coarse."""


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

    def map(self, change: Callable[[Tensor], Tensor]) -> PlaneLevel:
        """The same with `change` applied to every tensor."""
        return PlaneLevel(self.level.map(change), *map(change, self[1:]))

    def nearest_of_eight(self, x: Tensor, batch: Tensor) -> Tensor:
        """Nearest (Q,) of the eight nodes around `x` (Q, 3); n where there is none."""
        node, weight = corners(self.level, x + self.shift, batch)
        return node.gather(-1, weight.argmax(-1, keepdim=True)).squeeze(-1)

    def spacing(self, x: Tensor, batch: Tensor) -> Tensor:
        """`spacing_of` the nearest of the eight nodes around `x`; no gradient."""
        return spacing_of(F.pad(self.around.detach(), (0, 1))[self.nearest_of_eight(x, batch)])

    def spectra(self, x: Tensor, batch: Tensor) -> Tensor:
        """Spread (Q, 6) of the cloud around `x` along its principal axes, in cells; no gradient.

        Roots of the eigenvalues at the nearest node, and their mean over that node's neighbours:
        how thick, thin or sparse the cloud is at this scale. 0 where there is no node.
        """
        n, node = len(self.level), self.nearest_of_eight(x, batch)
        spread = self.eigenvalues.detach().clamp_min(0).sqrt() / self.level.cell_size
        spread = F.pad(F.pad(spread, (0, 1), value=1), (0, 0, 0, 1))  # and what counts
        around = F.embedding_bag(self.level.neighbours[node.clamp_max(n - 1)], spread, mode="sum")
        around = around * (node < n)[:, None]
        return torch.cat((spread[node, :3], around[:, :3] / around[:, 3:].clamp_min(1)), -1)


class Scale(NamedTuple):
    """Planes at two adjacent levels: fine ones, and coarse ones where fine nodes are missing.

    The fine ones come twice, on two grids of which one is shifted against the other (ours): what
    is blended of both depends less on where the cells happen to lie.
    """

    fine: PlaneLevel
    coarse: PlaneLevel
    staggered: PlaneLevel
    rims: bool
    """Whether walks look for rims of sheets: finer planes have gaps wherever points are sparse."""

    @property
    def levels(self) -> tuple[PlaneLevel, PlaneLevel, PlaneLevel]:
        """In the order of `Grids`."""
        return self.fine, self.staggered, self.coarse

    def with_levels(self, new: dict[int, PlaneLevel]) -> Scale:
        """The same with other levels, by the `id` of those here."""
        fine, staggered, coarse = (new[id(on)] for on in self.levels)
        return Scale(fine, coarse, staggered, self.rims)


class Nodes(NamedTuple):
    """The eight nodes around each of Q queries on each of G grids."""

    node: Tensor
    """(G, 8, Q) columns of `Grids.plane`."""
    weight: Tensor
    """(G, 8, Q) trilinear weights."""
    sharpness: Tensor
    """(G, 1, Q) what a squared distance from a centroid counts in the blend's exponent."""


class Grids(NamedTuple):
    """The planes of all levels, laid out for a look-up in three of them at once.

    Which three a query is looked up in says its place: place // batch_size is the scale, whose
    fine, staggered and coarse level they are, and place % batch_size the shape.
    """

    levels: tuple[Level, ...]
    which: tuple[tuple[int, ...], ...]
    """The three levels of each of W scales."""
    plane: Tensor
    """(6, sum of n + 1) of one level after the other."""
    around: Tensor
    """(sum of n + 1,) see `PlaneLevel`; 0 of "no node"."""
    may_end: Tensor
    """(sum of n + 1,) bool, see `rims.may_end`; only of the coarse levels of scales with rims."""
    first: tuple[int, ...]
    """Where each level begins there."""
    cells: Tensor | None
    """The levels' dense grids one after the other, int32 into `plane`; None: too large."""
    scaling: Tensor
    """(3, 4, W) cells per unit length; what is added to a coordinate in cells, with the level's
    shift in it; the coordinate, in cells, of the outermost cells' centres; what a squared distance
    from a centroid counts in the blend's exponent."""
    strides: Tensor
    """(3, 4, W) int32: steps in `cells` to the next x, y, z and shape."""
    corners: Tensor
    """(3, 8, W) int32: entries there of the eight cells at the lowest corner of the first shape."""
    least: Tensor
    """() least weight, with the sign of its normal: minus infinity, or 0 where the other side does
    not count (`PlaneLevel.other_side`)."""

    @classmethod
    def of(cls, scales: Sequence[Scale]) -> Grids:
        """Those of some scales, of which levels may be shared."""
        levels = list({id(on): on for scale in scales for on in scale.levels}.values())
        number = {id(on): i for i, on in enumerate(levels)}
        coarse = {id(scale.coarse): scale.coarse for scale in scales if scale.rims}
        rims = {i: may_end(on.level, on.plane) for i, on in coarse.items()}
        which = [tuple(number[id(on)] for on in scale.levels) for scale in scales]
        own = [on.level for on in levels]
        sizes = [len(level) + 1 for level in own]
        first = tuple(accumulate(sizes, initial=0))[:-1]
        sides = [(1 << level.depth) + 2 for level in own]  # a border of one empty cell
        volumes = [level.batch_size * side**3 for level, side in zip(own, sides, strict=True)]
        begin = torch.tensor(list(accumulate(volumes, initial=0))[:-1])
        strides = torch.tensor([[side * side, side, 1, side**3] for side in sides])
        corners = begin[:, None] + strides[:, :3] @ (OCTANTS + 1).T
        strides, corners = (y.int().to(levels[0].plane.device) for y in (strides, corners))
        shift = torch.stack([on.shift for on in levels])
        unit, last, sharpness = shift.new_tensor(
            [
                (1 / level.cell_size, (1 << level.depth) - 1, -0.5 / (BLEND * level.cell_size) ** 2)
                for level in own
            ]
        ).T
        scaling = torch.stack((unit, (shift + HALF_WIDTH) * unit - 0.5, last, sharpness), 1)
        chosen = torch.tensor(which, device=shift.device)
        scaling, strides, corners = (
            y[chosen].permute(1, 2, 0).contiguous() for y in (scaling, strides, corners)
        )
        return cls(
            tuple(own),
            tuple(which),
            torch.cat([on.plane for on in levels], 1),
            torch.cat([F.pad(on.around.detach(), (0, 1)) for on in levels]),
            torch.cat([rims.get(id(on), torch.zeros_like(on.plane[0]).bool()) for on in levels]),
            first,
            _joined([level.grid for level in own], first),
            scaling,
            strides,
            corners,
            torch.where(levels[0].other_side < 0, -torch.inf, 0.0).to(shift),
        )

    def site(self, place: Place) -> Site:
        """What look-ups must know of places (Q,)."""
        if isinstance(place, Site):
            return place
        each, scale = (self.scaling, self.strides, self.corners), self.scale_of(place)
        if len(self.which) > 1:
            each = tuple(y[..., scale] for y in each)
        scaling, strides, corners = each
        if self.levels[0].batch_size > 1:
            corners = corners + self.shape_of(place).int() * strides[:, 3:]
        return Site(place, scale, scaling, strides[:, :3], corners)

    def nodes(self, x: Tensor, place: Place, grids: slice) -> Nodes:
        """Those around `x` (3, Q) on some of the three grids."""
        at = self.site(place)
        unit, first, last, sharpness = at.scaling[grids, :, None].unbind(1)
        t = torch.addcmul(first, x, unit)  # (G, 3, Q)
        cell, weight = trilinear(t.clamp(torch.zeros_like(t), last))
        if self.cells is None:
            return Nodes(self._searched(cell, at.place, grids), weight, sharpness)
        lowest = (cell * at.strides[grids]).sum(1, keepdim=True, dtype=torch.int32)
        index = (lowest + at.corners[grids]).flatten()
        return Nodes(self.cells.index_select(0, index).view(weight.shape), weight, sharpness)

    def nearest(self, nodes: Nodes) -> Tensor:
        """Normal (Q, 3) of the nearest of the eight nodes on the first grid; 0 without any."""
        return self.plane[3:, self._nearest(nodes)].T

    def spacing(self, nodes: Nodes) -> Tensor:
        """`spacing_of` the nearest of the eight nodes (Q,) on the first grid, in its cells."""
        return spacing_of(self.around[self._nearest(nodes)])

    def ends(self, nodes: Nodes) -> Tensor:
        """Whether the sheet may end (Q,) at one of the eight nodes on the first grid."""
        return self.may_end[nodes.node[0]].any(0)

    def _nearest(self, nodes: Nodes) -> Tensor:
        node, weight = nodes.node[0], nodes.weight[0].detach()
        best = (weight * (self.around[node] > 0)).argmax(0, keepdim=True)
        return node.gather(0, best).squeeze(0)

    def scale_of(self, place: Place) -> Tensor:
        """Scale (Q,) of each place (Q,)."""
        if isinstance(place, Site):
            return place.scale
        size = self.levels[0].batch_size
        return place if size == 1 else place.div(size, rounding_mode="floor")

    def shape_of(self, place: Tensor) -> Tensor:
        """Shape (Q,) of each place (Q,)."""
        return place.remainder(self.levels[0].batch_size)

    def _searched(self, cell: Tensor, place: Tensor, grids: slice) -> Tensor:
        """Nodes (G, 8, Q) at cells (G, 3, Q), level by level."""
        node = place.new_zeros(len(cell), 8, len(place))
        scale, shape = self.scale_of(place), self.shape_of(place)
        for w, triple in enumerate(self.which):
            rows = (scale == w).nonzero().squeeze(-1)
            for g, i in enumerate(triple[grids]):
                found = self.levels[i].octants(cell[g, :, rows], shape[rows])
                node[g, :, rows] = found.long() + self.first[i]
        return node

    def blend(self, nodes: Nodes, x: Tensor, towards: Tensor) -> Tensor:
        """Sums (8, G, Q) of oriented normals, signed distances of `x` (3, Q), the weights, and the
        offsets of `x` from the centroids over the eight `nodes` of each grid."""
        node, weight, sharpness = nodes
        near = self.plane.index_select(1, node.flatten()).view(6, *node.shape)
        centroid, normal = near.split(3)  # (3, G, 8, Q)
        offset = x[:, None, None] - centroid
        exponent = dot(offset, offset, 0) * sharpness
        weight = weight * exponent.clamp_min(NEGLIGIBLE).exp()
        agree = dot(normal.detach(), towards.detach()[:, None, None], 0)
        sign = torch.maximum(torch.copysign(weight, agree), self.least)
        weight, distance = sign.abs(), sign * dot(normal, offset, 0)
        normal, beside = (sign * normal).sum(2), (weight * offset).sum(2)
        return torch.cat((normal, distance.sum(1)[None], weight.sum(1)[None], beside))


def _joined(grids: list[Tensor | None], first: Sequence[int]) -> Tensor | None:
    """Dense grids one after the other, with `first` added to each; None where too large."""
    dense = [grid for grid in grids if grid is not None]
    if len(dense) < len(grids) or sum(map(len, dense)) > DENSE_LIMIT:
        return None
    whole = torch.cat(dense)
    for part, k in zip(whole.split([len(grid) for grid in dense]), first, strict=True):
        part += k
    return whole


def spacing_of(around: Tensor) -> Tensor:
    """Distance from point to point, in cells, if the points `around` a node were a grid on a sheet;
    infinite where there is no node, around which there are 0."""
    return NEIGHBOURHOOD * (2 * math.pi / around).sqrt()
