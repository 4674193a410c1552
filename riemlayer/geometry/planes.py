"""Local planes of a cloud: centroid and PCA normal of each octree node, blended between nodes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor

from riemlayer.geometry.grids import ALL, COARSE, FINE, Grids, Nodes, PlaneLevel, Scale
from riemlayer.geometry.moments import Moments
from riemlayer.geometry.site import Place, Site
from riemlayer.numerics import normalise, outer6, smallest_eigenvector, symmetric_eigenvalues
from riemlayer.octree import HALF_WIDTH, Level, Octree, build_octree, nearest_node

PARENT_POINTS = 0.2
"""Weight, in points, of the parent's neighbourhood in a node's moments: it decides only where the
node's own neighbourhood is too sparse for a plane."""
STAGGER = 2 / 3
"""Shift of the second grid, in its finest cells: at the next coarser level a third of a cell."""
FALLBACK = 2e-3
"""Weight of the coarse planes beside the fine ones; they alone count where those are missing."""
FEW = 1024
"""Queries up to which all three grids are looked up at once: one look-up costs more than rows."""
FAR = 1e3
"""Where the plane of "no node" lies: nowhere near a query, so that its weight vanishes."""
HALF_SUPPORT = 0.1
"""Weight of the planes around a query that counts as half a support."""
NOWHERE = 1e-10
"""Weight of the planes around a query below which there are none."""
SPARSE = 0.6
"""Spacing of the points, in coarse cells, from which on gaps between them look like rims."""
NO_PLANE = 1e-3
"""Second eigenvalue, in squared cells, below which a neighbourhood is a point or a line."""


class Sight(NamedTuple):
    """The blended plane at Q places, and how they lie to the sheet."""

    normal: Tensor
    """(Q, 3) unit normals."""
    gap: Tensor
    """(Q, 1) signed distances from the plane."""
    support: Tensor
    """(Q, 1) from 0, where there are no planes, to 1."""
    beside: Tensor
    """(Q, 3) where `x` lies beside the mean of the centroids around it, within the plane: small
    well inside a sheet; outside its rim it points away from it; 0 far from every node."""


class LocalPlanes(NamedTuple):
    """Planes of a packed batch of B clouds, at one scale or several.

    Where one asks is said by a `place` for each query, which names a shape and a scale: of the
    first scale it is the number of the shape, of the next B more, and so on.
    """

    scales: tuple[Scale, ...]
    grids: Grids
    """Those of all scales: fine, staggered, coarse."""
    cells: Tensor
    """(W,) cell sizes of the fine levels."""
    rims: Tensor
    """(W,) bool, see `Scale`."""

    @classmethod
    def of(cls, scales: Sequence[Scale]) -> LocalPlanes:
        """Those of some scales."""
        grids = Grids.of(scales)
        cells = grids.plane.new_tensor([scale.fine.level.cell_size for scale in scales])
        rims = torch.tensor([scale.rims for scale in scales], device=cells.device)
        return cls(tuple(scales), grids, cells, rims)

    @property
    def fine(self) -> PlaneLevel:
        """Of the first scale."""
        return self.scales[0].fine

    def places(self, shape: Tensor, scales: int) -> Tensor:
        """Places (scales S,) of shapes (S,) at each of the first scales, one after the other."""
        size = self.fine.level.batch_size
        first = torch.arange(0, scales * size, size, device=shape.device)
        return (first[:, None] + shape).flatten()

    def site(self, place: Tensor) -> Site:
        """What may be asked for instead of places (Q,), again and again, by a walk."""
        return self.grids.site(place)

    def cell(self, place: Place) -> Tensor:
        """Cell size (Q, 1) of the fine level at each place."""
        return self.cells[self.grids.scale_of(place), None]

    def has_rims(self, place: Place) -> Tensor:
        """Whether walks look for rims at each place, (Q,) bool."""
        return self.rims[self.grids.scale_of(place)]

    def look(self, x: Tensor, place: Place, towards: Tensor) -> Sight:
        """What a walk sees at `x` (Q, 3), coming with the normal `towards`.

        Normals take the sign that agrees with `towards` (Q, 3). The weights are trilinear times a
        Gaussian of the distance to the centroid, so the nearer of two sheets prevails. Far from
        every node the normal is `towards` and the distance 0.
        """
        which = ALL if len(x) <= FEW else FINE
        sums = self._blended(self.grids.nodes(x.T, place, which), x, place, towards)
        normal, gap = _plane_of(sums, towards)
        weight = sums[4]
        support = (weight / (weight + HALF_SUPPORT))[:, None]
        offset = torch.where(weight > NOWHERE, sums[5:] / weight.clamp_min(NOWHERE), 0.0).T
        beside = offset - (offset * normal).sum(-1, keepdim=True) * normal
        return Sight(normal, gap, support, beside)

    def _blended(self, nodes: Nodes, x: Tensor, place: Place, towards: Tensor) -> Tensor:
        """`Grids.blend` over the fine grids, and over the coarse one where they have little."""
        fine, coarse = self.grids.blend(nodes, x.T, towards.T).split((2, len(nodes.node) - 2), 1)
        sums = fine.sum(1)
        thin = sums[4].detach() < 30 * FALLBACK
        if coarse.shape[1]:
            return torch.addcmul(sums, thin.to(x.dtype), coarse.squeeze(1), value=FALLBACK)
        rows = thin.nonzero().squeeze(-1)
        if not len(rows):
            return sums
        x, towards = x[rows].T, towards[rows].T
        coarse = self.grids.blend(self.grids.nodes(x, place[rows], COARSE), x, towards)
        return sums.index_add(1, rows, coarse.squeeze(1), alpha=FALLBACK)

    def normal(self, p: Tensor, place: Tensor) -> Tensor:
        """Unit normals (Q, 3) at `p`, with the sign of the nearest node's; the z axis far away."""
        return self.plane(p, place)[0]

    def plane(self, p: Tensor, place: Place, side: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """`normal` (Q, 3) at `p`, and the height (Q, 1) of `p` above the plane there.

        A fixed direction would not do for the sign: around a wall that it lies in, signs would be
        arbitrary and the normals of neighbouring nodes cancel.

        Args:
            side: (Q, 3) what gives the sign where no fine node is near, instead of a coarse one.
        """
        nodes = self.grids.nodes(p.T, place, FINE)
        towards = self.grids.nearest(nodes)
        lost = (towards == 0).all(-1, keepdim=True)
        if bool(lost.any()):
            if side is None:
                side = self.grids.nearest(self.grids.nodes(p.T, place, COARSE))
                z_axis = side.new_tensor([0.0, 0.0, 1.0])
                side = torch.where((side == 0).all(-1, keepdim=True), z_axis, side)
            towards = torch.where(lost, side, towards)
        return _plane_of(self._blended(nodes, p, place, towards), towards)

    def may_end(self, x: Tensor, place: Place) -> Tensor:
        """Whether the sheet may end (Q,) near `x`: points are dense there, and leave a gap."""
        nodes = self.grids.nodes(x.T, place, COARSE)
        return self.grids.ends(nodes) & (self.grids.spacing(nodes) < SPARSE)

    def drop(self, x: Tensor, shape: Tensor, rounds: int = 3) -> Tensor:
        """Points (Q, 3) moved onto the planes around them; from afar via the nearest node."""
        nodes = (self.grids.nodes(x.T, shape, which) for which in (FINE, COARSE))
        near = torch.cat([self.grids.nearest(y) for y in nodes], -1)
        lost = (near == 0).all(-1).nonzero().squeeze(-1)
        if len(lost):
            node = nearest_node(self.fine.level, x.detach()[lost], shape[lost])
            x = x.index_put((lost,), self.fine.plane[:3, node].T)
        for _ in range(rounds):
            normal, gap = self.plane(x, shape)
            x = x - gap * normal
        return x

    def map(self, change: Callable[[Tensor], Tensor]) -> LocalPlanes:
        """The same with `change`, such as a move to another device, applied to every tensor."""
        levels = {id(on): on.map(change) for scale in self.scales for on in scale.levels}
        return LocalPlanes.of([scale.with_levels(levels) for scale in self.scales])

    def point_features(self, points: Tensor, node: Tensor) -> Tensor:
        """What the stem is told of each point's plane: (N, 11), without units and without sign.

        Normal (6 products), two ratios of eigenvalues, offset from the centroid in cells.
        """
        plane = self.fine
        values = plane.eigenvalues[node]
        ratios = (values[:, :2] / values[:, 2:].clamp_min(1e-12)).clamp(0, 1)
        centroid, normal = plane.plane.T[node].split(3, -1)
        offset = (points - centroid) / plane.level.cell_size
        return torch.cat((outer6(normal), ratios, offset), -1)


def _plane_of(sums: Tensor, towards: Tensor) -> tuple[Tensor, Tensor]:
    """Unit normal (Q, 3) and signed distance (Q, 1) of blended sums (5, Q)."""
    normal, distance, weight = sums[:3], sums[3], sums[4]
    normal = torch.where(weight > NOWHERE, normal, towards.T)
    return normalise(normal.T), (distance / weight.clamp_min(NOWHERE))[:, None]


def local_planes(points: Tensor, octree: Octree) -> LocalPlanes:
    """Planes of the two finest levels of `octree` by PCA (appendix D: normals by PCA).

    Args:
        points: (N, 3) in the cube, the points that `octree` was built from; differentiable.
    """
    return planes_at_scales(points, octree, (0,))


def planes_at_scales(
    points: Tensor,
    octree: Octree,
    above: Sequence[int],
    normals: Tensor | None = None,
    rims: int = 1,
) -> LocalPlanes:
    """Local planes at several scales (ours).

    Args:
        points: (N, 3) in the cube, the points that `octree` was built from; differentiable.
        above: how many levels above the finest nodes of the octree those of each scale are.
        normals: (N, 3) oriented unit normals of the points: they give the planes' normals a sign.
        rims: at how many of the coarsest scales walks look for rims.
    """
    scales = max(above) + 1
    cell = octree.level(octree.depth).cell_size
    shift, edge = STAGGER * cell, HALF_WIDTH - 0.1 * cell
    coarsest = octree.levels[0]
    moved = (points.detach() + shift).clamp_max(edge)
    shape = coarsest.batch()[octree.node(coarsest.depth)]
    other = build_octree(moved, shape, octree.depth, octree.depth - scales)
    every = _plane_levels(points, octree, scales, 0.0, normals)
    staggered = _plane_levels(points, other, scales - 1, shift, normals)
    return LocalPlanes.of(
        [Scale(every[i], every[i + 1], staggered[i], i >= scales - rims) for i in above]
    )


def _plane_levels(
    points: Tensor, octree: Octree, scales: int, shift: float, normals: Tensor | None
) -> list[PlaneLevel]:
    """Planes of the finest `scales` + 1 levels, the finest first."""
    levels = [octree.level(octree.depth - i) for i in range(scales + 2)]
    single = Moments(torch.ones_like(points[:, :1]), points, points.new_zeros(len(points), 6))
    moments = [single.merged(octree.leaf, len(levels[0]))]
    for fine, coarse in pairwise(levels):
        assert fine.parent is not None  # the octree goes below these levels
        moments.append(moments[-1].merged(fine.parent, len(coarse)))
    around = [m.around(level) for m, level in zip(moments, levels, strict=True)]
    planes = [
        _plane_level(levels[i], moments[i], around[i], around[i + 1], shift)
        for i in range(scales + 1)
    ]
    if normals is not None:
        planes = [x.facing(normals, octree.node(x.level.depth)) for x in planes]
    return planes


def _plane_level(
    level: Level, moments: Moments, around: Moments, wide: Moments, shift: float
) -> PlaneLevel:
    """Planes of a level: its moments, those of its neighbourhoods and of its parents'."""
    assert level.parent is not None
    share = PARENT_POINTS / (around.mass + PARENT_POINTS)
    apart = wide.centroid[level.parent] - around.centroid
    covariance = (1 - share) * (around.scatter / around.mass + share * outer6(apart))
    covariance = covariance + share * (wide.scatter / wide.mass)[level.parent]
    covariance = _settled(covariance, level.cell_size)
    exact = covariance.double()  # the normal of few points hangs on the last digits
    eigenvalues = symmetric_eigenvalues(exact)
    normal = smallest_eigenvector(exact, eigenvalues[:, 0]).to(covariance.dtype)
    eigenvalues = eigenvalues.to(covariance.dtype)
    plane = torch.cat((moments.centroid, normal), -1)
    nowhere = plane.new_tensor([[FAR, 0, 0, 0, 0, 0]])
    plane = torch.cat((plane, nowhere)).T.contiguous()
    constants = eigenvalues.new_tensor([-1.0, shift])
    return PlaneLevel(level, plane, eigenvalues, around.mass.squeeze(-1), *constants)


def _settled(covariance: Tensor, cell_size: float) -> Tensor:
    """Covariances (n, 6) whose flattest direction does not depend on rounding.

    Where the points around span no plane (one or two of them, or a line), that direction becomes
    the one nearest to the z axis among those orthogonal to the points.
    """
    tie = covariance.new_tensor([2.0, 1, 0, 0, 0, 0]) * (10 * NO_PLANE * cell_size**2)
    flat = symmetric_eigenvalues(covariance)[:, 1:2] >= NO_PLANE * cell_size**2
    return torch.where(flat, covariance, covariance + tie)
