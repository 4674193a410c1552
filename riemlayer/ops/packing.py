"""Embeddings of several batches of clouds as one."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from riemlayer.geometry import LocalPlanes, Points
from riemlayer.geometry.grids import PlaneLevel
from riemlayer.heads import Embedding
from riemlayer.octree import Level, Octree, build_octree


def packed(parts: list[tuple[Embedding, int]]) -> Embedding:
    """One batch of several, each with the number of its first cloud."""
    embeddings = [embedding for embedding, _ in parts]
    planes = [x.planes for x in embeddings]
    first = [i for _, i in parts]
    finest = max((scale.fine.level.depth, i) for i, scale in enumerate(planes[0].scales))[1]
    coarsest = min(scale.coarse.level.depth for scale in planes[0].scales)
    octree = _octree([x.scales[finest].fine.level for x in planes], first, coarsest)
    other = _octree([x.scales[finest].staggered.level for x in planes], first, coarsest)
    levels = {
        id(own[0]): _joined(own, other if on == 1 else octree)
        for scale in zip(*(x.scales for x in planes), strict=True)
        for on, own in enumerate(zip(*(x.levels for x in scale), strict=True))
    }
    narrow = [x.narrow for x in embeddings if x.narrow is not None]
    return embeddings[0]._replace(
        z=torch.cat([x.z for x in embeddings]),
        narrow=torch.cat(narrow) if narrow else None,
        level=octree.level(embeddings[0].level.depth),
        planes=LocalPlanes.of([scale.with_levels(levels) for scale in planes[0].scales]),
        points=_points([x.points for x in embeddings], octree),
    )


def _octree(levels: list[Level], first: list[int], coarsest: int) -> Octree:
    """Octree of several batches of which the finest levels, and their first shapes, are known."""
    return build_octree(
        torch.cat([level.centres() for level in levels]),
        torch.cat([level.batch() + i for level, i in zip(levels, first, strict=True)]),
        levels[0].depth,
        coarsest,
    )


def _joined(levels: Sequence[PlaneLevel], octree: Octree) -> PlaneLevel:
    """Planes of several batches at one level; the last row of each stands for "no node"."""
    rows = [x.plane[:, :-1] for x in levels] + [levels[-1].plane[:, -1:]]
    return PlaneLevel(
        octree.level(levels[0].level.depth),
        torch.cat(rows, 1),
        torch.cat([x.eigenvalues for x in levels]),
        torch.cat([x.around for x in levels]),
        *levels[0][4:],
    )


def _points(clouds: Sequence[Points], octree: Octree) -> Points:
    """The points of several batches."""
    sizes = torch.tensor([x.xyz.shape[1] for x in clouds])
    ends = sizes.cumsum(0).tolist()
    start = [x.start[:-2] + end - n for x, end, n in zip(clouds, ends, sizes.tolist(), strict=True)]
    start.append(start[0].new_full((2,), ends[-1]))
    level = octree.level(clouds[0].level.depth)
    return Points(level, torch.cat([x.xyz for x in clouds], 1), torch.cat(start))
