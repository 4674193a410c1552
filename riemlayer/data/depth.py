"""Depth images of a pinhole camera as clouds."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from riemlayer.checks import MIN_POINTS, check_finite
from riemlayer.numerics import normalise

STEEPEST = math.tan(math.radians(80))
"""Slope of a surface seen 80 degrees from its normal; a steeper step between pixels is a jump."""


class DepthCloud(NamedTuple):
    """What a depth image shows."""

    points: Tensor
    """(N, 3) row by row: x right, y down, z ahead of the camera, or as `pose` turns them."""
    normals: Tensor
    """(N, 3) unit normals towards the camera; 0 where a pixel has no neighbour along an axis."""
    pixels: Tensor
    """(N, 2) int64 row and column of each point: `image[tuple(pixels.T)]` are its colours."""


def from_depth(
    depth: Tensor | ArrayLike,
    intrinsics: Tensor | ArrayLike,
    *,
    scale: float = 1.0,
    steepest: float = STEEPEST,
    pose: Tensor | ArrayLike | None = None,
) -> DepthCloud:
    """The cloud that a depth image shows: z K^-1 (column, row, 1) of each pixel (ours).

    Holes (0, negative, NaN or infinite) are left out, and so are the pixels on both sides of a
    depth jump, where cameras report depths between the two surfaces (flying pixels).

    Args:
        depth: (H, W) distances along the optical axis, not along the ray; pixel centres have whole
            coordinates. Differentiable.
        intrinsics: K (3, 3), or (fx, fy, cx, cy), in pixels.
        scale: length of one unit of `depth`: 0.001 for millimetres to metres.
        steepest: largest step in depth between neighbouring pixels, over the distance between
            their rays there; infinity keeps all pixels.
        pose: (4, 4) from the camera to the world, to put several images together.

    Raises:
        ValueError: wrong shapes, intrinsics that do not project, or fewer than 4 pixels left.

    >>> wall = from_depth(torch.full((4, 5), 2.0), (100, 100, 2, 1.5))
    >>> wall.points[0], wall.normals[0]
    (tensor([-0.0400, -0.0300,  2.0000]), tensor([ 0.,  0., -1.]))
    """
    z = _float(depth) * scale
    if z.ndim != 2:
        raise ValueError(f"`depth` must have shape (H, W), got {tuple(z.shape)}")
    if not scale > 0 or not steepest > 0:
        raise ValueError(f"`scale` and `steepest` must be positive, got {scale} and {steepest}")
    inverse = _inverse(intrinsics, z)
    row, column = torch.meshgrid(
        *(torch.arange(k, device=z.device, dtype=z.dtype) for k in z.shape), indexing="ij"
    )
    rays = torch.stack((column, row, torch.ones_like(row)), -1) @ inverse.T  # (H, W, 3)
    seen = z.isfinite() & (z > 0)
    z = torch.where(seen, z, 1.0)
    kept = seen & ~_beside_jumps(z, seen, inverse, steepest)
    if int(kept.sum()) < MIN_POINTS:
        raise ValueError(
            f"`depth` must show at least {MIN_POINTS} pixels of a surface, got {int(kept.sum())} "
            f"of {z.numel()} ({int(seen.sum())} with a depth); check scale and steepest"
        )
    points = z[..., None] * rays
    normals = _normals(points, kept)[kept]
    points, pixels = points[kept], kept.nonzero()
    if pose is None:
        return DepthCloud(points, normals, pixels)
    pose = _float(pose).to(z)
    if pose.shape != (4, 4):
        raise ValueError(f"`pose` must have shape (4, 4), got {tuple(pose.shape)}")
    check_finite("pose", pose)
    turn, shift = pose[:3, :3], pose[:3, 3]
    return DepthCloud(points @ turn.T + shift, normals @ turn.T, pixels)


def _float(x: Tensor | ArrayLike) -> Tensor:
    """As a floating tensor; integers and arrays of other kinds become float32."""
    if not isinstance(x, Tensor):
        array = np.asarray(x)
        x = torch.from_numpy(array if array.dtype == np.float64 else array.astype(np.float32))
    return x if x.is_floating_point() else x.float()


def _inverse(intrinsics: Tensor | ArrayLike, z: Tensor) -> Tensor:
    k = _float(intrinsics).to(z)
    if k.shape == (4,):
        fx, fy, cx, cy = k.tolist()
        k = z.new_tensor([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    if k.shape != (3, 3):
        raise ValueError(f"`intrinsics` must be (3, 3) or (fx, fy, cx, cy), got {tuple(k.shape)}")
    check_finite("intrinsics", k)
    if not (k[0, 0] > 0 and k[1, 1] > 0 and bool((k[2] == k.new_tensor([0, 0, 1])).all())):
        raise ValueError(
            f"`intrinsics` must have positive focal lengths and the last row (0, 0, 1), "
            f"got {k.tolist()}"
        )
    return torch.linalg.inv(k)


def _beside_jumps(z: Tensor, seen: Tensor, inverse: Tensor, steepest: float) -> Tensor:
    """(H, W) bool: pixels of which a neighbour is too much nearer or farther."""
    z, marked = z.detach(), torch.zeros_like(seen)
    for dim, spacing in ((0, inverse[1, 1]), (1, inverse[0, 0])):
        here, there = z.narrow(dim, 0, z.shape[dim] - 1), z.narrow(dim, 1, z.shape[dim] - 1)
        both = seen.narrow(dim, 0, z.shape[dim] - 1) & seen.narrow(dim, 1, z.shape[dim] - 1)
        apart = spacing * torch.minimum(here, there)
        jump = both & ((there - here).abs() > steepest * apart)
        none = torch.zeros_like(seen.narrow(dim, 0, 1))
        marked = marked | torch.cat((jump, none), dim) | torch.cat((none, jump), dim)
    return marked


def _normals(points: Tensor, kept: Tensor) -> Tensor:
    """Unit normals (H, W, 3): products of the differences along the two axes, by kept pixels."""
    down, right = (_difference(points, kept, dim) for dim in (0, 1))
    normal = torch.linalg.cross(down, right)
    flat = (normal == 0).all(-1, keepdim=True)
    towards = torch.where((normal * points).sum(-1, keepdim=True) > 0, -1.0, 1.0)
    return torch.where(flat, 0.0, towards * normalise(torch.where(flat, 1.0, normal)))


def _difference(points: Tensor, kept: Tensor, dim: int) -> Tensor:
    """From the kept neighbour before to the one after along an axis, or to the pixel itself."""
    ahead = [points.roll(-step, dim) for step in (1, -1)]
    valid = []
    for step in (1, -1):
        mask = kept.roll(-step, dim).clone()
        mask.select(dim, -1 if step == 1 else 0).fill_(False)  # nothing beyond the image
        valid.append(mask[..., None])
    after = torch.where(valid[0], ahead[0], points)
    before = torch.where(valid[1], ahead[1], points)
    return after - before
