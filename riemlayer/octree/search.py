"""Exact nearest neighbours and radius search in packed clouds, on the keys of their octree (ours).

A query looks at the points of 27 nodes: its own and the neighbours. Every point within its distance
to the border of that block, its `reach`, is among them. What needs more than the reach goes on at
the next coarser level, and at the end to all points of the shape.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from riemlayer import checks
from riemlayer.octree.build import HALF_WIDTH, NEIGHBOURS, Level, Octree, cell_of

CROWD = 2
"""Candidates for each neighbour asked for from which on a block is searched: with fewer, the reach
seldom holds k points."""
PAIRS = 1 << 18
"""Pairs of query and candidate compared at once: about 20 MB."""


class Block(NamedTuple):
    """Where the candidates of m queries lie in the cloud, sorted by node: s runs of points each."""

    start: Tensor
    """(m, s)"""
    count: Tensor
    """(m, s)"""
    reach: Tensor
    """(m,) distance up to which no point of the shape is missing."""

    def rows(self, index: Tensor) -> Block:
        """The same of some queries."""
        return Block(*(x[index] for x in self))


class Cloud(NamedTuple):
    """A packed cloud sorted by the nodes of its octree, at every level."""

    octree: Octree
    points: Tensor
    order: Tensor
    """(N,) index of each sorted point in the cloud as it came."""

    @classmethod
    def of(cls, octree: Octree, points: Tensor) -> Cloud:
        """Sort `points`."""
        order = octree.leaf.argsort()
        return cls(octree, points[order], order)

    def block(self, level: Level, queries: Tensor, batch: Tensor) -> Block:
        """The 27 nodes around each query, or around the place in the cube next to it."""
        last, side = (1 << level.depth) - 1, level.cell_size
        cell = cell_of(queries.clamp(-HALF_WIDTH, HALF_WIDTH), level.depth).clamp_max(last)
        count = self.octree.node(level.depth).bincount(minlength=len(level) + 1)
        node = level.around(cell, batch, NEIGHBOURS.to(cell.device))  # (m, 27)
        low = queries - ((cell - 1) * side - HALF_WIDTH)
        high = (cell + 2) * side - HALF_WIDTH - queries
        low = low.masked_fill(cell <= 1, torch.inf)  # nothing lies beyond the cube
        high = high.masked_fill(cell >= last - 1, torch.inf)
        rounding = 16 * torch.finfo(queries.dtype).eps * (HALF_WIDTH + queries.abs().amax(-1))
        reach = torch.minimum(low, high).amin(-1) - rounding
        return Block((count.cumsum(0) - count)[node], count[node], reach)

    def whole(self, queries: Tensor, batch: Tensor) -> Block:
        """All points of each query's shape."""
        count = self.shape_sizes()
        start = count.cumsum(0) - count
        reach = queries.new_full(batch.shape, torch.inf)
        return Block(start[batch][:, None], count[batch][:, None], reach)

    def shape_sizes(self) -> Tensor:
        """(batch_size,) points of each shape."""
        level = self.octree.levels[0]
        return level.batch()[self.octree.node(level.depth)].bincount(minlength=level.batch_size)

    def within(
        self, block: Block, queries: Tensor
    ) -> Iterator[tuple[Tensor, Tensor, Tensor, Tensor]]:
        """Candidates within their query's reach, part by part.

        Yields:
            The rows (r,) of a part, and its pairs: place among the rows (P,), ascending, sorted
            point (P,) and distance (P,).
        """
        total = block.count.sum(-1)
        doublings = total.double().clamp_min(1).log2().ceil().long()
        for d in doublings.unique().tolist():
            alike = (doublings == d).nonzero().squeeze(-1)
            for rows in alike.split(max(1, PAIRS >> d)):
                yield rows, *self._pairs(block.rows(rows), total[rows], queries[rows])

    def _pairs(self, block: Block, total: Tensor, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        count = block.count.flatten()
        shift = block.start.flatten() - (count.cumsum(0) - count)
        point = shift.repeat_interleave(count)
        point += torch.arange(len(point), device=point.device)
        row = torch.arange(len(x), device=x.device).repeat_interleave(total)
        offset = self.points.index_select(0, point) - x.index_select(0, row)
        a, b, c = offset.square_().unbind(-1)
        distance = (a + b + c).sqrt_()  # several times faster than `norm` over three columns
        kept = (distance <= block.reach.index_select(0, row)).nonzero().squeeze(-1)
        row, point, distance = (x.index_select(0, kept) for x in (row, point, distance))
        return row, point, distance


@torch.no_grad()
def knn(
    octree: Octree, points: Tensor, queries: Tensor, k: int, query_batch: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """The k nearest points of the same shape, exactly: indices (Q, k), distances (Q, k) ascending.

    A query that is itself a point finds itself, at distance 0. Fastest where the finest level holds
    few points a node.

    Args:
        octree: of `points`.
        points: (N, 3) in the cube, as the octree was built from them.
        queries: (Q, 3) anywhere.
        k: how many.
        query_batch: (Q,) int64, shape of each query; 0 by default.

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came; also where a
            shape has fewer than k points.

    >>> from riemlayer.octree import build_octree
    >>> points = torch.tensor([[0.0, 0, 0], [0.5, 0, 0], [0.9, 0, 0]])
    >>> octree = build_octree(points, torch.zeros(3, dtype=torch.long), depth=3)
    >>> knn(octree, points, points[2:], k=2)[0]
    tensor([[2, 1]])
    """
    query_batch = _checked(octree, points, queries, query_batch)
    cloud = Cloud.of(octree, points)
    _check_k(k, cloud.shape_sizes(), query_batch)
    index = query_batch.new_empty(len(queries), k)
    distance = queries.new_empty(len(queries), k)
    left = torch.arange(len(queries), device=queries.device)
    for level in (*reversed(octree.levels), None):
        x, batch = queries[left], query_batch[left]
        block = cloud.whole(x, batch) if level is None else cloud.block(level, x, batch)
        dense = block.count.sum(-1) >= (k if level is None else CROWD * k)
        tried, found = left[dense], [left[~dense]]
        for rows, row, point, near in cloud.within(block.rows(dense), x[dense]):
            count = row.bincount(minlength=len(rows))
            sure = count >= k
            nearest, place = _smallest(near, row, count, k)
            to = tried[rows[sure]]
            distance[to], index[to] = nearest[sure], cloud.order[point[place[sure]]]
            found.append(tried[rows[~sure]])
        left = torch.cat(found)
        if not len(left):
            break
    return index, distance


@torch.no_grad()
def radius_search(
    octree: Octree,
    points: Tensor,
    queries: Tensor,
    radius: float,
    query_batch: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """All pairs of a query and a point of its shape at most `radius` apart, exactly.

    Args:
        octree: of `points`.
        points: (N, 3) in the cube, as the octree was built from them.
        queries: (Q, 3) anywhere.
        radius: in the units of the cube, not negative.
        query_batch: (Q,) int64, shape of each query; 0 by default.

    Returns:
        Query (E,), point (E,) and distance (E,) of each pair, sorted by query, then by distance.

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.

    >>> from riemlayer.octree import build_octree
    >>> points = torch.tensor([[0.0, 0, 0], [0.5, 0, 0], [0.9, 0, 0]])
    >>> octree = build_octree(points, torch.zeros(3, dtype=torch.long), depth=3)
    >>> radius_search(octree, points, points[1:], 0.45)[:2]
    (tensor([0, 0, 1, 1]), tensor([1, 2, 2, 1]))
    """
    query_batch = _checked(octree, points, queries, query_batch)
    if not radius >= 0:
        raise ValueError(f"`radius` must be a number of at least 0, got {radius}")
    cloud = Cloud.of(octree, points)
    left = torch.arange(len(queries), device=queries.device)
    parts = [(left[:0], left[:0], queries[:0, 0])]
    for level in (*reversed([x for x in octree.levels if x.cell_size > radius]), None):
        x, batch = queries[left], query_batch[left]
        block = cloud.whole(x, batch) if level is None else cloud.block(level, x, batch)
        enough = block.reach >= radius
        tried, left = left[enough], left[~enough]
        block = block.rows(enough)._replace(reach=block.reach.new_full((len(tried),), radius))
        for rows, row, point, near in cloud.within(block, x[enough]):
            parts.append((tried[rows[row]], cloud.order[point], near))
        if not len(left):
            break
    query, point, distance = map(torch.cat, zip(*parts, strict=True))
    order = distance.argsort()
    order = order[query[order].argsort(stable=True)]
    return query[order], point[order], distance[order]


def _smallest(x: Tensor, row: Tensor, count: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """The k smallest of the `count` (r,) values `x` (P,) of each row, ascending, and their places.

    Rows that have fewer than k are filled up with infinities, whose places have no meaning.
    """
    start, width = count.cumsum(0) - count, max(k, int(count.max()))
    padded = x.new_full((len(count), width), torch.inf)
    slot = (
        torch.arange(len(x), device=x.device)
        + (torch.arange(len(count), device=x.device) * width - start)[row]
    )
    padded.view(-1)[slot] = x
    value, column = padded.topk(k, largest=False)
    return value, start[:, None] + column


def _checked(octree: Octree, points: Tensor, queries: Tensor, batch: Tensor | None) -> Tensor:
    checks.check_vectors("queries", queries, like=points)
    if queries.ndim != 2:
        raise ValueError(f"`queries` must have shape (Q, 3), got {tuple(queries.shape)}")
    if points.shape != (len(octree.leaf), 3):
        raise ValueError(
            f"`points` must be the ({len(octree.leaf)}, 3) points that the octree was built from, "
            f"got {tuple(points.shape)}"
        )
    if batch is None:
        return torch.zeros(len(queries), dtype=torch.long, device=queries.device)
    checks.check_index("query_batch", batch, octree.levels[0].batch_size, like=queries)
    if batch.shape != queries.shape[:1]:
        raise ValueError(
            f"`query_batch` must have shape ({len(queries)},), one index for each query, "
            f"got {tuple(batch.shape)}"
        )
    return batch


def _check_k(k: int, sizes: Tensor, query_batch: Tensor) -> None:
    if k < 1:
        raise ValueError(f"`k` must be at least 1, got {k}")
    least = sizes[query_batch.unique()].min() if len(query_batch) else sizes.max()
    if k > int(least):
        raise ValueError(
            f"`k` must not exceed the number of points of a shape, got {k} where a shape has "
            f"{int(least)}; ask for fewer, or leave that shape's queries out"
        )
