"""What the rivals share: PCA planes of a cloud and carrying values from its points to others."""

from __future__ import annotations

import numpy as np
import torch

from riemlayer.checks import check_points

Array = np.ndarray


def checked_cloud(points: Array) -> Array:
    """The cloud (N, 3) as a float64 array of its own.

    Raises:
        TypeError, ValueError: `points` is no cloud, as `riemlayer.checks.check_points` says.
    """
    cloud = torch.as_tensor(points)
    check_points(cloud)
    return cloud.detach().cpu().numpy().astype(np.float64)


def pca_normals(points: Array, tree, queries: Array, k: int) -> Array:
    """Unit normals (K, 3) at queries (K, 3): least principal axis of the k nearest points.

    The sign is arbitrary.

    Args:
        points: (N, 3) cloud.
        tree: its `scipy.spatial.KDTree`.
        queries: (K, 3) positions.
        k: number of neighbours.
    """
    neighbours = points[tree.query(queries, k=min(k, len(points)))[1]]
    centred = neighbours - neighbours.mean(1, keepdims=True)
    return np.linalg.eigh(centred.transpose(0, 2, 1) @ centred)[1][:, :, 0]


def mean_spacing(points: Array, tree, k: int) -> float:
    """Mean distance of a point to its k nearest others: the cloud's average edge length."""
    return float(tree.query(points, k=min(k + 1, len(points)))[0][:, 1:].mean())


def carry_over(points: Array, values: Array, tree, queries: Array, k: int) -> Array:
    """Values at queries (K, C) by a weighted affine fit over the k nearest points (ours).

    A query that is a point of the cloud gets that point's value unchanged. The affine part lives
    in the neighbourhood's plane (its two main axes), which keeps the fit well posed on a surface.

    Args:
        points: (N, 3) cloud.
        values: (N, C) values at its points.
        tree: its `scipy.spatial.KDTree`.
        queries: (K, 3) positions.
        k: number of neighbours.
    """
    distance, index = tree.query(queries, k=min(k, len(points)))
    result = values[index[:, 0]]
    away = distance[:, 0] > 0
    if not away.any():
        return result
    distance, index, queries = distance[away], index[away], queries[away]
    weight = np.exp(-0.5 * (distance / distance.mean(1, keepdims=True)) ** 2)
    weight /= weight.sum(1, keepdims=True)
    centre = (weight[..., None] * points[index]).sum(1)
    offset = points[index] - centre[:, None]
    moment = np.einsum("nk,nki,nkj->nij", weight, offset, offset)
    spread, axes = np.linalg.eigh(moment)
    plane = axes[:, :, 1:]
    local = offset @ plane
    spread = np.maximum(spread[:, 1:], 1e-3 * spread[:, 2:] + np.finfo(float).tiny)
    at_query = ((queries - centre)[:, None] @ plane)[:, 0] / spread
    weight = weight * (1 + np.einsum("nki,ni->nk", local, at_query))
    result[away] = np.einsum("nk,nkc->nc", weight, values[index])
    return result
