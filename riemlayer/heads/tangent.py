"""The tangent plane at a source, from the points around it and the planes of every scale (ours)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from riemlayer.geometry.points import REACHES, SAYS
from riemlayer.heads.branch import SITE, Embedding, at_sources, sites
from riemlayer.numerics import normalise, product

FIRST = 3.0
"""Logit of the shares of the first planes and of the neighbourhood of most points, untrained."""
PIECE = 1 << 12
"""Points whose neighbourhoods are in memory at once: some hundred points each."""


class TangentPlane(nn.Module):
    """Unit normal at sources: a mean of those of neighbourhoods and planes, weighted as learned.

    Few points tell the normal of a clean cloud best, where it turns or where sheets meet; many do
    where there is noise. The shares are a softmax of what all of them say of themselves and of how
    they differ; neighbourhoods of too few points have none. Untrained, it is nearly a mean of the
    first planes and of the neighbourhood of most points.

    Args:
        scales: of the planes.

    Shapes: sources (S, 3), site (S, 13 scales + 1), what the planes say there -> (S, 3).
    """

    def __init__(self, scales: int, hidden: int = 32) -> None:
        super().__init__()
        n = len(REACHES) + scales
        told = SAYS * len(REACHES) + SITE * scales + 1 + n * (n - 1) // 2
        self.shares = nn.Sequential(
            nn.Linear(told, hidden),
            nn.GELU(),
            nn.Linear(hidden, hidden),
            nn.GELU(),
            last := nn.Linear(hidden, n),
        )
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        nn.init.constant_(last.bias[:1], FIRST)
        nn.init.constant_(last.bias[-1:], FIRST)

    def forward(
        self,
        field: Embedding,
        p: Tensor,
        shape: Tensor,
        site: Tensor,
        seen: Sequence[tuple[Tensor, Tensor]],
    ) -> Tensor:
        near = field.points.normals(p, shape, field.planes.scales[0].coarse)
        normals = torch.stack([normal for normal, *_ in (*seen, *near)], 1)  # (S, n, 3)
        cosines = product(normals, normals.mT)
        n = normals.shape[1]
        first, second = torch.triu_indices(n, n, 1, device=p.device)
        differ = 1 - cosines[:, first, second].square()
        told = torch.cat((*(x.says for x in near), site, differ), -1)
        enough = torch.cat([torch.ones_like(p[:, :1])] * len(seen) + [x.enough for x in near], -1)
        with torch.autocast(p.device.type, enabled=False):
            share = enough * self.shares(told).softmax(-1)
        side = torch.where(cosines[:, 0] < 0, -torch.ones_like(share), torch.ones_like(share))
        return normalise(((share * side)[..., None] * normals).sum(1))


def tangent_normals(
    plane: TangentPlane | None, field: Embedding, p: Tensor, shape: Tensor
) -> Tensor:
    """Unit normals (Q, 3) at points (Q, 3) of the cube; of the blended planes without a `plane`."""
    if plane is None:
        return field.planes.normal(p, shape)
    normals = []
    for at, of in zip(p.split(PIECE), shape.split(PIECE), strict=True):
        seen = at_sources(field.planes, at, of)
        normals.append(plane(field, at, of, sites(field, at, of, seen), seen))
    return torch.cat(normals)
