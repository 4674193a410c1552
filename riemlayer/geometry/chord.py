"""First logs that need no walk: chords laid on the tangent plane, flat or bent (ours)."""

from __future__ import annotations

import torch
from torch import Tensor

from riemlayer.geometry.walk import NEGLIGIBLE, fade_in

STEEP = 0.1
"""How little of a chord along the normal is left when its tangent part is stretched."""


def lay_flat(normal: Tensor, x: Tensor, cell: float) -> Tensor:
    """Tangent part of chords `x` from a point, stretched to the chord's length: a first Log (ours).

    A chord is shorter than its geodesic and its tangent part shorter still, so |x| is the better
    length. Chords along the normal, which have no direction, shrink to 0. To first order at 0 the
    answer is `x` itself, as in `walk`.

    Args:
        normal: (S, 3) unit normals of the tangent planes.
        x: (S, K, 3).
        cell: size of the planes' cells.
    """
    return _near_identity(x, _flat(normal[:, None], x, cell), cell)


def bend(normal: Tensor, x: Tensor, end: Tensor, cell: float) -> Tensor:
    """Logs of chords `x` along which the normal turns evenly: right to the third order (ours).

    A geodesic whose normal turns by n' = -k t - w b, with normal curvature k and geodesic torsion
    w, leaves its chord to the side by k w |v|^3 / 6, and is longer than it as an arc is. Both are
    read from the normal at the end. To first order at 0 the answer is `x`, as in `walk`.

    Args:
        normal: (S, 3) unit normals at the sources.
        x: (S, K, 3).
        end: (S, K, 3) unit normals where the chords end; their sign has no meaning.
        cell: size of the planes' cells.
    """
    n = normal[:, None]
    t = _flat(n, x, cell)
    b = torch.linalg.cross(n.expand_as(t), t)
    along, aside = ((end * y).sum(-1, keepdim=True) for y in (t, b))
    square = t.square().sum(-1, keepdim=True).clamp_min((NEGLIGIBLE * cell) ** 2)
    sideways = along * aside / (6 * square)
    cosine = (n * end).sum(-1, keepdim=True).abs()
    curved = along.square() / (2 * square * (1 + cosine))  # sin^2 of half the turn along t
    longer = 1 + curved / 6 + 0.075 * curved.square()  # asin(y) / y to the fifth order
    bent = longer * (t + sideways * b) / (1 + sideways.square()).sqrt()
    return _near_identity(x, bent, cell)


def _flat(normal: Tensor, x: Tensor, cell: float) -> Tensor:
    """Tangent part of chords (S, K, 3), stretched to their lengths."""
    height = (x * normal).sum(-1, keepdim=True)
    tangent = x - height * normal
    square = x.square().sum(-1, keepdim=True).clamp_min((NEGLIGIBLE * cell) ** 2)
    up = height.square()
    return (square / (square - up + STEEP * up * (up / square))).sqrt() * tangent


def _near_identity(x: Tensor, log: Tensor, cell: float) -> Tensor:
    """`log`, and near the source `x`."""
    return x + fade_in(x.square().sum(-1, keepdim=True), cell) * (log - x)
