"""Slow and plain references for the fast paths, and the small clouds and fields that tests use."""

from __future__ import annotations

import itertools
import math

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from riemlayer import EncodedSurface, ExpLogField
from riemlayer.geometry import LocalPlanes, Walked, local_planes, walk
from riemlayer.octree import HALF_WIDTH, Level, Octree, build_octree, decode_key

# ------------------------------------------------------------------------------------ clouds


def fibonacci_sphere(n: int = 400, dtype: torch.dtype = torch.float64) -> Tensor:
    """(n, 3) evenly spread points of the unit sphere."""
    i = torch.arange(n, dtype=dtype) + 0.5
    z = 1 - 2 * i / n
    r, turn = (1 - z * z).sqrt(), i * (math.pi * (3 - math.sqrt(5)))
    return torch.stack((r * turn.cos(), r * turn.sin(), z), -1)


def lumpy(n: int = 300, dtype: torch.dtype = torch.float64) -> Tensor:
    """(n, 3) irregular cloud around a sphere, of no symmetry, in the cube; another for each n."""
    generator = torch.Generator().manual_seed(n)
    points = F.normalize(torch.randn(n, 3, dtype=dtype, generator=generator), dim=-1)
    swell = 0.8 + 0.1 * (3 * points + torch.tensor([0.3, 1.1, 2.0], dtype=dtype)).sin()
    return points * swell


def packed(*clouds: Tensor) -> tuple[Tensor, Tensor]:
    """Points and batch index of several clouds."""
    index = [torch.full((len(x),), i) for i, x in enumerate(clouds)]
    return torch.cat(clouds), torch.cat(index)


# ------------------------------------------------------------------------------------ fields


def shaken(preset: str, dtype: torch.dtype = torch.float64, strength: float = 1.0) -> ExpLogField:
    """A field of the preset with random weights everywhere, far from its harmless start.

    Layers that start at zero or nearly so (the ends of residual blocks and decoders) take part.
    """
    field = ExpLogField.from_preset(preset).to(dtype).eval()
    with torch.no_grad():
        for parameter in field.parameters():
            width = parameter.shape[0] if parameter.ndim > 1 else 100
            parameter.add_(torch.randn_like(parameter), alpha=strength / math.sqrt(width))
    return field


def encoded(
    preset: str = "tiny", n: int = 300, dtype: torch.dtype = torch.float64
) -> EncodedSurface:
    """A random cloud, encoded by a field with random weights; without a graph."""
    points = lumpy(n, dtype)
    with torch.no_grad():
        return shaken(preset, dtype).encode(points)


def random_octree(depth: int = 3, n: int = 60, shapes: int = 2, coarsest: int = 0) -> Octree:
    """Octree of random clouds that fill the whole cube, walls and corners too."""
    points = (2 * torch.rand(shapes * n, 3, dtype=torch.float64) - 1) * (HALF_WIDTH - 1e-6)
    return build_octree(points, torch.arange(shapes).repeat_interleave(n), depth, coarsest)


def full_octree(depth: int, coarsest: int = 0) -> Octree:
    """Octree with every cell occupied."""
    side = 1 << depth
    cell = torch.cartesian_prod(*[torch.arange(side)] * 3)
    points = (cell + 0.5) * (2 * HALF_WIDTH / side) - HALF_WIDTH
    return build_octree(points, torch.zeros(len(points), dtype=torch.long), depth, coarsest)


# ------------------------------------------------------------------------------------ octree


def nodes(level: Level) -> dict[tuple[int, int, int, int], int]:
    """Node of each occupied (shape, x, y, z)."""
    cell, batch = decode_key(level.key, level.depth)
    rows = torch.cat((batch[:, None], cell), -1).tolist()
    return {(b, x, y, z): i for i, (b, x, y, z) in enumerate(rows)}


def dictionary_neighbours(level: Level) -> Tensor:
    """(n, 27) by looking every cell up in a dictionary."""
    known = nodes(level)
    steps = list(itertools.product((-1, 0, 1), repeat=3))
    rows = [
        [known.get((b, x + i, y + j, z + k), len(known)) for i, j, k in steps]
        for b, x, y, z in known
    ]
    return torch.tensor(rows)


def dictionary_children(coarse: Level, fine: Level) -> Tensor:
    """(m, 8) by looking every cell up in a dictionary."""
    known = nodes(fine)
    steps = list(itertools.product((0, 1), repeat=3))
    rows = [
        [known.get((b, 2 * x + i, 2 * y + j, 2 * z + k), len(known)) for i, j, k in steps]
        for b, x, y, z in nodes(coarse)
    ]
    return torch.tensor(rows)


def to_grid(x: Tensor, level: Level) -> Tensor:
    """Dense grid (B, C, X, Y, Z) of node features (n, C), zero where there is no node."""
    cell, batch = decode_key(level.key, level.depth)
    side = 1 << level.depth
    grid = x.new_zeros(level.batch_size, side, side, side, x.shape[1])
    grid = grid.index_put((batch, *cell.unbind(-1)), x)
    return grid.movedim(-1, 1)


def from_grid(grid: Tensor, level: Level) -> Tensor:
    """Node features (n, C) of a dense grid: inverse of `to_grid` on the occupied nodes."""
    cell, batch = decode_key(level.key, level.depth)
    return grid.movedim(1, -1)[(batch, *cell.unbind(-1))]


def dense_conv(x: Tensor, weight: Tensor, bias: Tensor, level: Level) -> Tensor:
    """3x3x3 convolution by `conv3d` on the dense grid; weight (27 C, D) as in `OctreeConv`."""
    kernel = weight.view(3, 3, 3, x.shape[1], -1).permute(4, 3, 0, 1, 2)
    return from_grid(F.conv3d(to_grid(x, level), kernel, bias, padding=1), level)


def dense_down(x: Tensor, weight: Tensor, bias: Tensor, fine: Level, coarse: Level) -> Tensor:
    """2x2x2 convolution of stride 2 by `conv3d`; weight (8 C, D) as in `OctreeDown`."""
    kernel = weight.view(2, 2, 2, x.shape[1], -1).permute(4, 3, 0, 1, 2)
    return from_grid(F.conv3d(to_grid(x, fine), kernel, bias, stride=2), coarse)


def dense_up(x: Tensor, weight: Tensor, bias: Tensor, coarse: Level, fine: Level) -> Tensor:
    """Transposed 2x2x2 convolution by `conv_transpose3d`; weight (C, 8 D) as in `OctreeUp`."""
    kernel = weight.view(x.shape[1], 2, 2, 2, -1).permute(0, 4, 1, 2, 3)
    return from_grid(F.conv_transpose3d(to_grid(x, coarse), kernel, bias, stride=2), fine)


def dense_lookup(features: Tensor, level: Level, x: Tensor) -> Tensor:
    """Trilinear look-up (Q, C) on a full grid of one shape by `grid_sample`."""
    grid = to_grid(features, level)
    at = (x / HALF_WIDTH).flip(-1).view(1, -1, 1, 1, 3)  # the last axis of the grid comes first
    sampled = F.grid_sample(grid, at, padding_mode="border", align_corners=False)
    return sampled[0, :, :, 0, 0].T


# ------------------------------------------------------------------------------------ numerics


def loop_segments(x: Tensor, index: Tensor, size: int, reduce: str) -> Tensor:
    """Sum, mean or maximum of each group of rows; empty groups give 0."""
    out = x.new_zeros(size, x.shape[1])
    for i in range(size):
        rows = x[index == i]
        if len(rows):
            out[i] = {"sum": rows.sum(0), "mean": rows.mean(0), "max": rows.amax(0)}[reduce]
    return out


def loop_weighted_rows(table: Tensor, index: Tensor, weight: Tensor) -> Tensor:
    """sum_k weight[q, k] table[index[q, k]], query by query."""
    rows = [
        torch.stack([w * table[i] for i, w in zip(indices, weights, strict=True)]).sum(0)
        for indices, weights in zip(index, weight, strict=True)
    ]
    return torch.stack(rows)


def matrix(m: Tensor) -> Tensor:
    """Symmetric matrices (..., 3, 3) of six entries (xx, yy, zz, xy, xz, yz)."""
    a, b, c, d, e, f = m.unbind(-1)
    return torch.stack((a, d, e, d, b, f, e, f, c), -1).unflatten(-1, (3, 3))


def grid_sample_triplane(planes: Tensor, x: Tensor) -> Tensor:
    """`sample_triplane` by `grid_sample`: (S, 3, R, R, C), (S, K, 3) -> (S, K, 3 C)."""
    parts = []
    for plane, (i, j) in zip(planes.unbind(1), ((0, 1), (0, 2), (1, 2)), strict=True):
        at = x[..., [j, i]][:, :, None]  # the last axis of the plane comes first
        sampled = F.grid_sample(plane.movedim(-1, 1), at, padding_mode="border", align_corners=True)
        parts.append(sampled.squeeze(-1).mT)
    return torch.cat(parts, -1)


def flat_grid(n=41):
    """Vertices and faces of a square of side 2 in the plane z = 0."""
    x, y = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n), indexing="ij")
    vertices = np.stack([x, y, 0 * x], -1).reshape(-1, 3)
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).reshape(-1)
    faces = [np.stack([a, a + n, a + 1], -1), np.stack([a + 1, a + n, a + n + 1], -1)]
    return vertices, np.concatenate(faces)


def finite(answer: Tensor | tuple) -> bool:
    """No NaN and no infinity in a tensor, or in any of a tuple."""
    if isinstance(answer, tuple):
        return all(map(finite, answer))
    return not answer.is_floating_point() or bool(answer.isfinite().all())


def length(x: np.ndarray) -> np.ndarray:
    """Norms (...) of vectors (..., 3)."""
    return np.linalg.norm(x, axis=-1)


def planes_of(points: Tensor, depth: int = 6) -> LocalPlanes:
    """Planes of one cloud, the fine ones at `depth`."""
    batch = torch.zeros(len(points), dtype=torch.long)
    return local_planes(points, build_octree(points, batch, depth))


def go(planes: LocalPlanes, p: Tensor, v: Tensor, steps: int = 8) -> Walked:
    """A walk over the planes of one cloud."""
    return walk(planes, p, v, torch.zeros(len(p), dtype=torch.long), steps)
