"""The true log map as a method: the floor that no Log can beat on a curved surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from riemlayer.baselines.cloud import Array, carry_over


@dataclass
class TrueLog:
    """Log_p read from a table of true log maps at the vertices of the true mesh.

    Args:
        k: neighbours of the affine fit that answers between the vertices.
    """

    k: int = 8

    def prepare_truth(self, vertices: Array, sources: Array, log: Array) -> None:
        """Take in vertices (n, 3), source vertices (P,) int and their log maps (P, n, 3)."""
        from scipy.spatial import cKDTree

        self._vertices = np.asarray(vertices)
        self._tree = cKDTree(self._vertices)
        self._sources, self._log = self._vertices[np.asarray(sources)], np.asarray(log)

    def log(self, p: Array, q: Array) -> Array:
        """Log_p(q) of a tabulated source.

        Raises:
            ValueError: p is none of the sources.
        """
        distance = np.linalg.norm(self._sources - np.asarray(p), axis=-1)
        source = int(distance.argmin())
        if distance[source] > 0:
            raise ValueError(
                f"p must be a source of the table, got a point {distance[source]:.3g} away from one"
            )
        return carry_over(self._vertices, self._log[source], self._tree, np.asarray(q), self.k)
