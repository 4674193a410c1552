"""Tangent frames and the isometries between them."""

from __future__ import annotations

import torch
from torch import Tensor

from riemlayer.numerics import normalise


def frame_of(normal: Tensor) -> Tensor:
    """Right-handed orthonormal frames (..., 3, 3), columns e1, e2 and the unit normal (..., 3).

    Duff et al. 2017: deterministic, and smooth but where the normal's z component changes sign.
    """
    x, y, z = normal.unbind(-1)
    sign = torch.where(z < 0, -1.0, 1.0).to(z.dtype)
    a = -1 / (sign + z)
    b = x * y * a
    first = torch.stack((1 + sign * x * x * a, sign * b, -sign * x), -1)
    second = torch.stack((b, sign + y * y * a, -y), -1)
    return torch.stack((first, second, normal), -1)


def angle_of(x: Tensor) -> Tensor:
    """Angle in (-pi, pi] of vectors (..., 2); 0, with gradient 0, for the zero vector.

    So for all that are so short that the gradient, 1 / |x|, would not be finite.
    """
    along = torch.tensor([1.0, 0.0], dtype=x.dtype, device=x.device)
    limit = torch.finfo(x.dtype)
    x = torch.where(x.square().sum(-1, keepdim=True) < limit.tiny / limit.eps, along, x)
    return torch.atan2(x[..., 1], x[..., 0])


def nearest_isometry(m: Tensor) -> Tensor:
    """Orthogonal matrices (..., 2, 2) nearest to m: rotations, or reflections where det m < 0."""
    a, b, c, d = m.flatten(-2).unbind(-1)
    flip = a * d - b * c < 0
    sign = torch.where(flip, -1.0, 1.0).to(m.dtype)
    cosine, sine = a + sign * d, c - sign * b
    x = normalise(torch.stack((cosine, sine), -1))
    cosine, sine = x.unbind(-1)
    columns = torch.stack((cosine, sine), -1), torch.stack((-sign * sine, sign * cosine), -1)
    return torch.stack(columns, -1)
