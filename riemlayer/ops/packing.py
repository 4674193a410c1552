"""Embeddings of several batches of clouds as one."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from riemlayer.geometry import LocalPlanes
from riemlayer.geometry.grids import PlaneLevel
from riemlayer.heads import Embedding
from riemlayer.octree import Level, Octree, build_octree


def packed(parts: list[tuple[Embedding, int]]) -> Embedding:
    """One batch of several, each with the number of its first cloud."""
    embeddings = [embedding for embedding, _ in parts]
    scales = [*zip(*(x.scales for x in embeddings), strict=True)]
    first = [i for _, i in parts]
    finest = max(scales, key=lambda scale: scale[0].fine.level.depth)
    coarsest = min(scale[0].coarse.level.depth for scale in scales)
    octree = _octree([x.fine.level for x in finest], first, coarsest)
    other = _octree([x.staggered.level for x in finest], first, coarsest)
    narrow = [x.narrow for x in embeddings if x.narrow is not None]
    planes, *others = (
        LocalPlanes.of(
            _joined([x.fine for x in scale], octree),
            _joined([x.coarse for x in scale], octree),
            _joined([x.staggered for x in scale], other),
            scale[0].rims,
        )
        for scale in scales
    )
    return embeddings[0]._replace(
        z=torch.cat([x.z for x in embeddings]),
        narrow=torch.cat(narrow) if narrow else None,
        level=octree.level(embeddings[0].level.depth),
        planes=planes,
        others=tuple(others),
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
