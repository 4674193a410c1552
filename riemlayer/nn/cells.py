"""Points that are far apart along the surface, and the cells of those nearest to each."""

from __future__ import annotations

import math
from heapq import heapify, heappop, heappush
from typing import NamedTuple

import torch
from torch import Tensor

from riemlayer.ops import LocalGeometry


class Cells(NamedTuple):
    """Kept points of a packed cloud, and which of them each point belongs to."""

    index: Tensor
    """(M,) int64, ascending: the kept points."""
    assignment: Tensor
    """(N,) int64 in [0, M): the nearest kept point, of the same cloud."""
    distance: Tensor
    """(N,) distance to it along edges; infinite where no path leads there."""
    batch: Tensor
    """(M,) int64, cloud of each kept point."""


@torch.no_grad()
def geodesic_cells(geometry: LocalGeometry, counts: list[int]) -> Cells:
    """Farthest points and their geodesic Voronoi cells, cloud by cloud (ours).

    Distances are those of shortest paths over the valid edges (Dijkstra): unlike |Log| they hold
    beyond the trained radius, and the next farthest point costs only as much as its cell is large.
    They exceed the geodesic ones by a few percent, as paths over edges are not straight. The first
    point is the one whose neighbours are farthest, so that the order of the points does not matter.
    Points that no path joins to a kept one go to the first kept of their cloud.

    Runs in plain Python on the CPU, about a second for 10,000 points: keep the answer where a cloud
    is pooled more than once.

    Args:
        geometry: of a packed cloud.
        counts: points to keep of each cloud, from 1 to all.

    Raises:
        ValueError: there is not one count for each cloud, or one is out of range.

    >>> from riemlayer import ExpLogField
    >>> from riemlayer.ops import local_geometry
    >>> points = torch.nn.functional.normalize(torch.randn(300, 3), dim=-1)
    >>> geometry = local_geometry(ExpLogField.from_preset("tiny").encode(points), k=8)
    >>> cells = geodesic_cells(geometry, [20])
    >>> cells.index.shape, cells.assignment.shape
    (torch.Size([20]), torch.Size([300]))
    """
    sizes = geometry.batch.bincount().tolist()
    if len(counts) != len(sizes) or not all(
        1 <= k <= n for k, n in zip(counts, sizes, strict=True)
    ):
        raise ValueError(f"counts must have an entry in [1, n] for n of {sizes}, got {counts}")
    links = _links(geometry)
    index, owner, distance = [], [], []
    first = 0
    for size, count in zip(sizes, counts, strict=True):
        seed = int(geometry.radius[first : first + size].argmax())
        kept, own, far = _farthest(links[first : first + size], first, count, seed)
        index += kept
        owner += own
        distance += far
        first += size
    device = geometry.batch.device
    chosen = torch.tensor(index, device=device)
    kept, place = chosen.sort()
    rank = torch.empty_like(place)
    rank[place] = torch.arange(len(place), device=device)
    start = torch.tensor([0, *counts[:-1]], device=device).cumsum(0)
    assignment = rank[torch.tensor(owner, device=device) + start[geometry.batch]]
    far = geometry.r.new_tensor(distance)
    return Cells(kept, assignment, far, geometry.batch[kept])


def _links(geometry: LocalGeometry) -> list[list[tuple[int, float]]]:
    """Where edges lead from each point, either way, and their lengths."""
    links: list[list[tuple[int, float]]] = [[] for _ in range(geometry.points)]
    sender, receiver = geometry.edge_index[:, geometry.valid].tolist()
    for i, j, r in zip(sender, receiver, geometry.r[geometry.valid].tolist(), strict=True):
        links[i].append((j, r))
        links[j].append((i, r))
    return links


def _farthest(
    links: list[list[tuple[int, float]]], first: int, count: int, seed: int
) -> tuple[list[int], list[int], list[float]]:
    """Kept points of one cloud, whose points are numbered from `first`, in order of choice.

    Returns:
        The kept points, and of each point the place of its owner among them and the distance.
    """
    distance, owner = [math.inf] * len(links), [0] * len(links)
    waiting = [(-math.inf, i) for i in range(len(links))]  # farthest first; may be out of date
    heapify(waiting)
    kept, source = [], seed
    while True:
        distance[source], owner[source] = 0.0, len(kept)
        front = [(0.0, source)]
        while front:
            d, i = heappop(front)
            if d > distance[i]:
                continue
            if i != source:
                heappush(waiting, (-d, i))
            for j, r in links[i]:
                reach, j = d + r, j - first
                if reach < distance[j]:
                    distance[j], owner[j] = reach, len(kept)
                    heappush(front, (reach, j))
        kept.append(first + source)
        if len(kept) == count:
            return kept, owner, distance
        d, source = heappop(waiting)
        while -d != distance[source]:
            d, source = heappop(waiting)
