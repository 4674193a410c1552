"""Connected pieces of a cloud."""

from __future__ import annotations

import torch
from torch import Tensor

NEAR = 8
"""Nearest others that a point may be joined to: with fewer a random cloud falls apart."""
GAP = 4.0
"""Chords longer than this, in spacings of the sparser of their ends, join nothing."""


@torch.no_grad()
def pieces(points: Tensor, near: Tensor) -> Tensor:
    """Connected piece (N,) int64 of each point, counted from 0 (ours).

    Points are joined to their nearest others, but for chords four times as long as the spacing at
    either end. A narrower gap is not to be told from sparse sampling, and what has fewer than four
    points belongs to whatever is nearest.

    Args:
        points: (N, 3).
        near: (N, K) indices of each point's nearest others.

    >>> x = torch.tensor([0.0, 1, 2, 3, 4, 50, 51, 52, 53, 54])[:, None] * torch.ones(3)
    >>> pieces(x, torch.cdist(x, x).topk(5, largest=False)[1][:, 1:])
    tensor([0, 0, 0, 0, 0, 1, 1, 1, 1, 1])
    """
    here = torch.arange(len(points), device=points.device)[:, None].expand_as(near)
    chord = (points[near] - points[:, None]).norm(dim=-1)
    spacing = _spacing(chord)
    kept = chord <= GAP * torch.maximum(spacing[:, None], spacing[near])
    one, other = here[kept], near[kept]
    label = here[:, 0]
    while True:  # the smallest number spreads along links, and from each root to all of its piece
        a, b = label[one], label[other]
        low = torch.minimum(a, b).repeat(4)
        new = label.scatter_reduce(0, torch.cat((a, b, one, other)), low, "amin")
        new = new[new]
        if torch.equal(new, label):
            return label.unique(return_inverse=True)[1]
        label = new


def _spacing(chord: Tensor) -> Tensor:
    """Third smallest chord (N,) that is not 0: copies of a point say nothing about its spacing."""
    apart = torch.where(chord > 0, chord, torch.inf).sort(-1)[0]
    third = apart[:, : min(3, chord.shape[1])]
    return torch.where(third.isfinite(), third, 0).amax(-1)
