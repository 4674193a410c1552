"""Geodesic walking over the local planes of a cloud (appendix D), vectorised and differentiable."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from riemlayer.geometry.planes import LocalPlanes
from riemlayer.numerics import in_columns, normalise

ANCHOR = 0.3
"""Length, in cells, within which a walk leaves p along v itself, to first order."""
STEEP = 0.1
"""Share of a chord's squared height that counts as length when its tangent part is stretched."""
NEGLIGIBLE = 0.05
"""Length, in cells, below which a vector has less and less of a direction."""


class Walked(NamedTuple):
    """Where a walk ended."""

    point: Tensor
    """(Q, 3) end point."""
    vector: Tensor
    """(Q, 3) v carried along by parallel transport: |v| times the end direction."""
    normal: Tensor
    """(Q, 3) unit normal at the end; its sign is arbitrary at the start and kept along the walk."""


def walk(
    planes: LocalPlanes,
    p: Tensor,
    v: Tensor,
    batch: Tensor,
    steps: int = 8,
    normal: Tensor | None = None,
) -> Walked:
    """Walk from `p` along `v` over the local planes in `steps` equal steps (appendix D).

    Each step goes straight ahead, drops onto the plane found there, and turns the direction by the
    smallest rotation that takes the last normal to the new one: parallel transport, where the paper
    projects and renormalises. In 8 steps this is as accurate as projection in steps of half the
    spacing. Where no plane is near the walk goes straight on.

    Exact at the origin: walk(p, 0) = p with the identity as its differential, because the departure
    from p + v is faded in with |v|^2 over `ANCHOR` cells.

    Args:
        planes: of the cloud.
        p: (Q, 3) starts, in the cube.
        v: (Q, 3) tangent vectors.
        batch: (Q,) int64, shape of each start.
        steps: number of steps; 8 for the trained radius, |v| over half the spacing for a fine walk.
        normal: (Q, 3) what `planes.normal` answers at `p`, where it is known already.
    """
    if normal is None:
        normal = planes.normal(p, batch)
    square = v.square().sum(-1, keepdim=True)
    negligible = (NEGLIGIBLE * planes.fine.level.cell_size) ** 2
    tilt = (normal * v).sum(-1, keepdim=True) / square.clamp_min(negligible)
    normal = normalise(normal - tilt * v)
    x, carried, normal = (in_columns(y) for y in (p, v, normal))
    for _ in range(steps):
        x, carried, normal = advance(planes, x, carried, normal, batch, 1 / steps)
    return Walked(p + v + fade_in(square, planes) * (x - p - v), carried, normal)


def advance(
    planes: LocalPlanes, x: Tensor, carried: Tensor, normal: Tensor, batch: Tensor, share: float
) -> tuple[Tensor, Tensor, Tensor]:
    """One step of a walk, by a share of the carried vector: point, vector and normal (Q, 3)."""
    x = torch.add(x, carried, alpha=share)
    ahead, gap = planes.at(x, batch, normal)
    x = torch.addcmul(x, gap, ahead, value=-1)
    return x, turn(carried, normal, ahead), ahead


def lay_flat(planes: LocalPlanes, normal: Tensor, x: Tensor) -> Tensor:
    """Tangent part of chords `x` from a point, stretched to the chord's length: a first Log (ours).

    A chord is shorter than its geodesic and its tangent part shorter still, so |x| is the better
    length. Chords along the normal, which have no direction, shrink to 0. To first order at 0 the
    answer is `x` itself, as in `walk`.

    Args:
        planes: of the cloud.
        normal: (S, 3) unit normals of the tangent planes.
        x: (S, K, 3).
    """
    height = (x * normal[:, None]).sum(-1, keepdim=True)
    tangent = x - height * normal[:, None]
    square = x.square().sum(-1, keepdim=True)
    spread = (square - (1 - STEEP) * height.square()).clamp_min(torch.finfo(x.dtype).tiny)
    stretch = (square.clamp_min(torch.finfo(x.dtype).tiny) / spread).sqrt()
    return x + fade_in(square, planes) * (stretch * tangent - x)


def fade_in(square: Tensor, planes: LocalPlanes) -> Tensor:
    """0 at the source with zero slope, 1 beyond `ANCHOR` cells, from squared lengths."""
    return square / (square + (ANCHOR * planes.fine.level.cell_size) ** 2)


def turn(w: Tensor, n: Tensor, m: Tensor) -> Tensor:
    """Rotate vectors `w`, orthogonal to `n`, by the smallest rotation that takes `n` to `m`.

    Length is kept. Between opposite normals, where the rotation is undefined, the denominator is
    held above 0.2.
    """
    cosine = (n * m).sum(-1, keepdim=True)
    length = (w * m).sum(-1, keepdim=True) / (1 + cosine).clamp_min(0.2)
    return torch.addcmul(w, length, n + m, value=-1)
