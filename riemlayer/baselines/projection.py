"""The linear rivals of appendix D: tangent projection for Log, one projected step for Exp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from riemlayer.baselines.cloud import Array, checked_cloud, pca_normals


@dataclass
class Projection:
    """Log: q - p on the PCA plane at p. Exp: p + v snapped to the nearest point (appendix D).

    Args:
        k: neighbours of the PCA plane.

    Example:
        >>> method = Projection()
        >>> grid = np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0), [0.0]), -1).reshape(-1, 3)
        >>> method.prepare(grid)
        >>> method.log(grid[0], np.array([[3.0, 4.0, 7.0]])).round(6) + 0.0
        array([[3., 4., 0.]])
    """

    k: int = 16

    def prepare(self, points: Array) -> None:
        """Build the search tree of the cloud (N, 3)."""
        from scipy.spatial import KDTree

        self._points = checked_cloud(points)
        self._tree = KDTree(self._points)

    def log(self, p: Array, q: Array) -> Array:
        """Log_p(q) = (I - n n^T)(q - p), n the PCA normal at p."""
        p, offset = np.asarray(p), np.asarray(q) - np.asarray(p)
        normal = pca_normals(self._points, self._tree, p[None], self.k)[0]
        return offset - (offset @ normal)[:, None] * normal

    def exp(self, p: Array, v: Array) -> Array:
        """Exp_p(v) = the point of the cloud nearest to p + v."""
        return self._points[self._tree.query(np.asarray(p) + np.asarray(v))[1]]
