"""A cloud as a surface of small discs: normals, sizes, and how a log map runs across each disc."""

from __future__ import annotations

import numpy as np

Array = np.ndarray

STEEPEST = 3.0
"""A log map that changes faster than this across a disc is torn there (cut locus): drawn flat."""


def neighbourhoods(points: Array, k: int = 12, chunk: int = 1024) -> tuple[Array, float]:
    """Indices (N, k) of the nearest points, and the median distance to the fourth one."""
    import torch

    x = torch.from_numpy(points).float()
    near = [torch.cdist(part, x).topk(min(k, len(x)), largest=False) for part in x.split(chunk)]
    spacing = torch.cat([part.values for part in near])[:, min(4, len(x) - 1)].median()
    return torch.cat([part.indices for part in near]).numpy(), float(spacing)


def pca_normals(points: Array, neighbours: Array) -> Array:
    """Unit normals (N, 3): the direction in which the neighbours (N, k) spread least."""
    offset = points[neighbours] - points[neighbours].mean(1, keepdims=True)
    return np.linalg.eigh(offset.transpose(0, 2, 1) @ offset)[1][..., 0]


def slopes(points: Array, log: Array, neighbours: Array) -> Array:
    """Least-squares derivative (N, 2, 3) of a log map (N, 2) along the surface."""
    dx = points[neighbours] - points[:, None]
    dy = log[neighbours] - log[:, None]
    moment = dx.transpose(0, 2, 1) @ dx
    moment += 1e-2 * np.trace(moment, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    slope = np.linalg.solve(moment, dx.transpose(0, 2, 1) @ dy).transpose(0, 2, 1)
    return slope * (np.linalg.norm(slope, axis=(1, 2)) < STEEPEST)[:, None, None]


def discs(points: Array, normals: Array, radius: float, corners: int = 10) -> tuple[Array, Array]:
    """Offsets (N, corners, 3) of the rims of tangent discs, and their faces (N, corners)."""
    axis = np.eye(3)[np.abs(normals).argmin(1)]
    first = np.cross(normals, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normals, first)
    angle = 2 * np.pi * np.arange(corners)[:, None] / corners
    offset = np.cos(angle) * first[:, None] + np.sin(angle) * second[:, None]
    return radius * offset, np.arange(len(points) * corners).reshape(-1, corners)
