"""What the operations on whole surfaces accept: clouds, single points, weights."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from riemlayer import checks
from riemlayer.calculus import Calculus


def check_cloud(surface: Calculus, points: Any) -> None:
    """`points` (N, 3) with N >= 1 go with the surface.

    Raises:
        TypeError, ValueError: naming `points`.
    """
    surface.check(points=points)
    checks.check_shapes(points=(points, "N 3"))
    if not len(points):
        raise ValueError("points must hold at least 1 point, got (0, 3)")


def check_point(surface: Calculus, **named: Any) -> None:
    """Each argument, given by its name, is one point or vector (3,) that goes with the surface.

    Raises:
        TypeError, ValueError: naming the argument.
    """
    for name, x in named.items():
        surface.check(**{name: x})
        if x.shape != (3,):
            raise ValueError(f"{name} must be one point (3,), got {tuple(x.shape)}")


def shares(points: Tensor, weights: Any) -> Tensor:
    """Weights (..., K) of points (..., K, 3), divided by their sum; equal ones for None.

    Raises:
        TypeError, ValueError: naming `weights`.
    """
    if weights is None:
        return torch.full_like(points[..., 0], 1 / points.shape[-2])
    checks.check_tensor("weights", weights)
    checks.check_finite("weights", weights)
    checks.check_same_device("weights", weights, points)
    try:
        w = weights.expand(points.shape[:-1])
    except RuntimeError:
        raise ValueError(
            f"weights must expand to {tuple(points.shape[:-1])}, one for each point, "
            f"got {tuple(weights.shape)}"
        ) from None
    if bool((w < 0).any()) or bool((w.sum(-1) <= 0).any()):
        raise ValueError("weights must be at least 0 and not all 0")
    return w / w.sum(-1, keepdim=True)
