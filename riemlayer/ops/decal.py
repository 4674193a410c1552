"""Textures on a cloud without an unwrapping: UV from a log map."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from riemlayer.calculus import Calculus
from riemlayer.numerics import product
from riemlayer.ops.arguments import check_point
from riemlayer.ops.stitching import stitch_log


class Decal(NamedTuple):
    """Where a square picture lies on a surface."""

    uv: Tensor
    """(N, 2) texture coordinates: (0, 0) is the picture's lower left corner, (1, 1) the upper
    right one."""
    inside: Tensor
    """(N,) bool: the point is under the picture."""


def decal(surface: Calculus, p: Tensor, up: Tensor, size: float, points: Tensor) -> Decal:
    """UV of a square picture that is stuck on at p, undistorted there (Sec. 3.4, Fig. 4).

    A picture that reaches beyond the trained radius is carried by a stitched log map. Seen along
    the surface's normal at p: whether that is from outside, a cloud does not know.

    Args:
        surface: an encoded surface of one shape.
        p: (3,) the picture's centre.
        up: (3,) direction of the picture's upper edge; its tangent part counts.
        size: side of the picture, user's units.
        points: (N, 3) on the surface.

    Raises:
        TypeError, ValueError: size is not positive, `up` is normal to the surface at p, or a point
            or vector has another shape or dtype or is not finite.
    """
    check_point(surface, p=p)
    check_point(surface, up=up)
    if not size > 0:
        raise ValueError(f"size must be positive, got {size}")
    above = surface.to_2d(p, surface.project(p, up))
    length = float(above.detach().norm())
    if length < 1e-3 * float(up.detach().norm()) or length == 0:
        raise ValueError(f"up must have a part in the tangent plane at p, got {up.tolist()}")
    y = above / length
    x = torch.stack((y[1], -y[0]))
    corner, reach = size / math.sqrt(2), float(surface.radius_at(p))
    depth = 0 if corner < reach else math.ceil(2 * (corner / reach - 1)) + 1
    stitched = stitch_log(surface, p, points, depth)
    uv = product(stitched.coordinates, torch.stack((x, y), -1)) / size + 0.5
    inside = stitched.covered & ((uv >= 0) & (uv <= 1)).all(-1)
    return Decal(uv, inside)
