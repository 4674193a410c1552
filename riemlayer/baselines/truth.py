"""The true log map as a method: the floor that no Log can beat on a curved surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from riemlayer.baselines.cloud import Array
from riemlayer.baselines.mesh import SurfaceInterpolation


@dataclass
class TrueLog:
    """Log_p read from a table of true log maps at the vertices, linear on the triangles."""

    def prepare_truth(self, vertices: Array, faces: Array, sources: Array, log: Array) -> None:
        """Take in the mesh (n, 3), (m, 3), source vertices (P,) and their log maps (P, n, 3)."""
        self._interpolate = SurfaceInterpolation(vertices, faces)
        self._table = dict(zip(np.asarray(sources).tolist(), np.asarray(log), strict=True))

    def log(self, p: Array, q: Array) -> Array:
        """Log_p(q) of the tabulated source nearest to p.

        Raises:
            ValueError: the vertex nearest to p is none of the sources.
        """
        source = self._interpolate.nearest_vertex(p)
        if source not in self._table:
            raise ValueError(f"p must be a source of the table, got a point near vertex {source}")
        return self._interpolate(self._table[source], q)
