"""Mesh rivals through potpourri3d, for inputs that have faces, and values between vertices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from riemlayer.baselines.cloud import Array


class SurfaceInterpolation:
    """Linear interpolation of vertex values on a triangle mesh.

    Unlike a fit over nearby vertices it never mixes the two sides of a thin wall.

    Args:
        vertices: (n, 3) positions.
        faces: (m, 3) vertex indices.
        k: triangles tried for a query, nearest centroids first.
    """

    def __init__(self, vertices: Array, faces: Array, k: int = 8):
        from scipy.spatial import KDTree

        self._vertices, self._faces = np.asarray(vertices), np.asarray(faces)
        self._vertex_tree = KDTree(self._vertices)
        self._face_tree = KDTree(self._vertices[self._faces].mean(1))
        self._k = min(k, len(self._faces))

    def nearest_vertex(self, p: Array) -> int:
        """Index of the vertex nearest to p (3,)."""
        return int(self._vertex_tree.query(np.asarray(p))[1])

    def __call__(self, values: Array, queries: Array) -> Array:
        """Values (K, C) at queries (K, 3); at a vertex exactly its own value (n, C)."""
        distance, vertex = self._vertex_tree.query(queries)
        result = values[vertex]
        between = distance > 0
        queries = np.asarray(queries)[between]
        near = self._face_tree.query(queries, k=self._k)[1]
        triangles = self._faces[near.reshape(-1, self._k)]
        corners = self._vertices[triangles]
        weights = _barycentric(corners, queries[:, None])
        gap = np.linalg.norm((weights[..., None] * corners).sum(2) - queries[:, None], axis=-1)
        best = np.arange(len(queries)), gap.argmin(1)
        result[between] = (weights[best][..., None] * values[triangles[best]]).sum(1)
        return result


@dataclass
class MeshHeat:
    """Log map of `MeshVectorHeatSolver` from the vertex nearest to p, as ambient vectors.

    Args:
        strategy: "AffineLocal" (potpourri3d's default) or "VectorHeat", the original method.
    """

    strategy: str = "AffineLocal"

    def prepare_mesh(self, vertices: Array, faces: Array) -> None:
        """Build the solver of a manifold mesh and solve once, which factorises its matrices."""
        import potpourri3d

        self._interpolate = SurfaceInterpolation(vertices, faces)
        self._solver = potpourri3d.MeshVectorHeatSolver(
            np.asarray(vertices, np.float64), np.asarray(faces, np.int64)
        )
        self._frames = self._solver.get_tangent_frames()[:2]
        self._solver.compute_log_map(0, self.strategy)
        self._solved = -1

    def log(self, p: Array, q: Array) -> Array:
        """Log_p(q) by one solve over the whole mesh, kept while p stays the same."""
        source = self._interpolate.nearest_vertex(p)
        if source != self._solved:
            axes = np.stack([axis[source] for axis in self._frames])
            local = self._solver.compute_log_map(source, self.strategy)
            self._values, self._solved = np.asarray(local) @ axes, source
        return self._interpolate(self._values, q)


@dataclass
class MeshTracer:
    """Exp by `GeodesicTracer` from the vertex nearest to p: straightest geodesics, one by one."""

    def prepare_mesh(self, vertices: Array, faces: Array) -> None:
        """Build the tracer of a manifold mesh."""
        import potpourri3d

        self._interpolate = SurfaceInterpolation(vertices, faces)
        self._tracer = potpourri3d.GeodesicTracer(
            np.asarray(vertices, np.float64), np.asarray(faces, np.int64)
        )

    def exp(self, p: Array, v: Array) -> Array:
        """Exp_p(v), the last point of every traced geodesic."""
        source = self._interpolate.nearest_vertex(p)
        trace = self._tracer.trace_geodesic_from_vertex
        return np.stack([trace(source, x)[-1] for x in np.asarray(v, np.float64)])


def _barycentric(corners: Array, x: Array) -> Array:
    """Weights (..., 3) of x (..., 3) in triangles (..., 3, 3), moved to the nearest valid ones."""
    a, b = corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]
    c = x - corners[..., 0, :]
    aa, ab, bb = (a * a).sum(-1), (a * b).sum(-1), (b * b).sum(-1)
    area = np.maximum(aa * bb - ab * ab, np.finfo(corners.dtype).tiny)
    ac, bc = (a * c).sum(-1), (b * c).sum(-1)
    second, third = (bb * ac - ab * bc) / area, (aa * bc - ab * ac) / area
    weights = np.stack([1 - second - third, second, third], -1).clip(0)
    return weights / weights.sum(-1, keepdims=True)
