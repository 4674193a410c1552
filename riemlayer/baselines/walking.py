"""Heuristic walking, the paper's rival for Exp ("Tracing", appendix D)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from riemlayer.baselines.cloud import Array, checked_cloud, mean_spacing, pca_normals


@dataclass
class Walking:
    """Steps along the cloud: move, nearest point, its PCA plane, project, turn (appendix D).

    All vectors of a source walk at once; each takes whole steps and a last shorter one.

    Args:
        k: neighbours of the PCA planes.
        step: step length in mean edge lengths of the cloud (the paper: 0.5).
        spacing_k: neighbours that define the mean edge length.

    Example:
        >>> method = Walking()
        >>> grid = np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0), [0.0]), -1).reshape(-1, 3)
        >>> method.prepare(grid)
        >>> method.exp(grid[0], np.array([[3.0, 4.0, 0.0]])).round(6)
        array([[3., 4., 0.]])
    """

    k: int = 16
    step: float = 0.5
    spacing_k: int = 6

    def prepare(self, points: Array) -> None:
        """Build the search tree, the step length and every point's PCA normal."""
        from scipy.spatial import KDTree

        self._points = checked_cloud(points)
        self._tree = KDTree(self._points)
        self._step = self.step * mean_spacing(self._points, self._tree, self.spacing_k)
        self._normals = pca_normals(self._points, self._tree, self._points, self.k)

    def exp(self, p: Array, v: Array) -> Array:
        """Exp_p(v) by walking |v| along the cloud."""
        v = np.asarray(v, np.float64)
        remaining = np.linalg.norm(v, axis=-1)
        direction = v / np.maximum(remaining, np.finfo(v.dtype).tiny)[:, None]
        position = np.broadcast_to(np.asarray(p, np.float64), v.shape).copy()
        moving = np.flatnonzero(remaining != 0)
        while len(moving):
            length = np.minimum(remaining[moving], self._step)
            position[moving], direction[moving] = self._advance(
                position[moving], direction[moving], length[:, None]
            )
            remaining[moving] -= length
            moving = moving[remaining[moving] > 0]
        return position

    def _advance(self, position: Array, direction: Array, length: Array) -> tuple[Array, Array]:
        """One step: new positions on the plane of the nearest point, directions turned into it."""
        position = position + length * direction
        nearest = self._tree.query(position)[1]
        normal = self._normals[nearest]
        height = ((position - self._points[nearest]) * normal).sum(-1, keepdims=True)
        turned = direction - (direction * normal).sum(-1, keepdims=True) * normal
        norm = np.linalg.norm(turned, axis=-1, keepdims=True)
        return position - height * normal, np.where(norm > 1e-6, turned / np.maximum(norm, 1e-6), 0)
