"""Ground truth of Exp on a mesh: straightest geodesics, the Eq. (8) filter, a distance check."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from riemlayer.data.cut_locus import divergence
from riemlayer.data.manifold import directed_edges, vertex_areas, vertex_normals

Array = NDArray[np.float64]

RADIUS = 0.5
"""Trained tangent radius in the cube."""
JITTER = 0.02
"""Standard deviation of a Sobolev pair along each tangent axis: |jitter| is about 0.03."""
LONGEST = 0.52
"""Bound of |v| after the jitter."""


def trace(
    vertices: Array, faces: NDArray, sources: NDArray, v: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """q = Exp_p(v) by straightest geodesics from mesh vertices (potpourri3d's GeodesicTracer).

    Args:
        vertices, faces: a manifold mesh, (n, 3) and (m, 3).
        sources: vertex indices, (S,).
        v: tangent vectors, (S, K, 3). The tracer follows their projection orthogonal to the
            angle-weighted vertex normal (`manifold.vertex_normals`), so hand in such vectors. The
            angles around a vertex are scaled to a full turn (at a boundary vertex: half a turn).

    Returns:
        End points (S, K, 3), and whether each geodesic has the full length |v| (S, K): False
        where it ran into a boundary.

    Raises:
        ValueError: shapes do not agree, or a source is not a vertex.

    Example:
        >>> square = np.array([[0.0, 0, 0], [1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
        >>> quarters = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]])
        >>> v = np.array([[[0.5, 0.25, 0.0], [2.0, 1.0, 0.0]]])
        >>> q, complete = trace(square, quarters, np.array([0]), v)
        >>> q[0].round(6).tolist(), complete.tolist()
        ([[0.5, 0.25, 0.0], [1.0, 0.5, 0.0]], [[True, False]])
    """
    from potpourri3d import GeodesicTracer

    sources, v = np.asarray(sources), np.asarray(v, dtype=float)
    if v.ndim != 3 or v.shape[-1] != 3 or sources.shape != v.shape[:1]:
        raise ValueError(f"v must have shape (S, K, 3), S = {sources.shape}, got {v.shape}")
    if not np.isfinite(v).all():
        raise ValueError("v must be finite, got NaN or inf (a degenerate face at a source?)")
    if sources.min() < 0 or sources.max() >= len(vertices):
        raise ValueError(f"sources must index the {len(vertices)} vertices, got {sources.max()}")
    tracer = GeodesicTracer(vertices, faces)
    paths = [
        tracer.trace_geodesic_from_vertex(int(source), vector)
        for source, fan in zip(sources, v, strict=True)
        for vector in fan
    ]
    end = np.cumsum([len(path) for path in paths]) - 1
    start = np.concatenate([[0], end[:-1] + 1])
    nodes = np.concatenate(paths)
    step = np.linalg.norm(np.diff(nodes, axis=0, append=nodes[-1:]), axis=1)
    step[end] = 0  # from the end of one path to the start of the next
    length = np.add.reduceat(step, start).reshape(v.shape[:2])
    complete = length >= np.linalg.norm(v, axis=-1) * (1 - 1e-3) - 1e-9
    return nodes[end].reshape(v.shape), complete


def sample_tangent_vectors(normal: Array, K: int, radius: float, rng: np.random.Generator) -> Array:
    """K vectors orthogonal to `normal`; the second half are the first half, jittered (ours).

    Of the first half, every other vector is uniform by area in the disk of `radius`, the rest
    uniform in length. Vector i and i + K/2 are a Sobolev pair, 0.03 apart on average, and none
    is longer than 1.04 radius.

    Args:
        normal: unit normals, (..., 3).
        K: even number of vectors.
        radius: of the disk.
        rng: source of randomness.

    Returns:
        (..., K, 3).

    Example:
        >>> v = sample_tangent_vectors(np.array([0.0, 0, 1]), 8, 0.5, np.random.default_rng(0))
        >>> v.shape, float(abs(v[:, 2]).max())
        ((8, 3), 0.0)
    """
    if K % 2:
        raise ValueError(f"K must be even (vectors come in pairs), got {K}")
    helper = np.where(np.abs(normal[..., :1]) < 0.6, [1.0, 0, 0], [0, 1.0, 0])
    x = np.cross(helper, normal)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    frame = np.stack([x, np.cross(normal, x)], axis=-2)  # (..., 2, 3)
    u = rng.random((*normal.shape[:-1], K // 2))
    length = radius * np.where(np.arange(K // 2) % 2 == 0, np.sqrt(u), u)
    angle = 2 * np.pi * rng.random(length.shape)
    flat = length[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    pair = flat + JITTER * rng.standard_normal(flat.shape)
    bound = LONGEST / RADIUS * radius
    pair *= np.minimum(1, bound / np.linalg.norm(pair, axis=-1, keepdims=True))
    return np.matmul(np.concatenate([flat, pair], axis=-2), frame).astype(float)


def shortest_mask(
    vertices: Array, faces: NDArray, sources: NDArray, v: Array, q: Array
) -> NDArray[np.bool_]:
    """Does |v| agree with the heat-method distance of q within 0.02 + 10 %? (S, K) (ours)

    The distance at q is that of its three nearest vertices, weighted by inverse distance. On an
    icosphere with spacing 0.04 the heat method is off by 0.005 (fast marching: 0.008, and three
    times slower).
    """
    from potpourri3d import MeshHeatMethodDistanceSolver

    solver = MeshHeatMethodDistanceSolver(vertices, faces)
    gap, near = KDTree(vertices).query(q, 3)  # (S, K, 3)
    weight = 1 / (gap + 1e-9)
    weight /= weight.sum(-1, keepdims=True)
    distance = np.stack([solver.compute_distance(int(source)) for source in sources])  # (S, n)
    rows = np.arange(len(sources))[:, None, None]
    length = np.linalg.norm(v, axis=-1)
    return np.abs((distance[rows, near] * weight).sum(-1) - length) <= 0.02 + 0.1 * length


def shape_ground_truth(
    vertices: Array, faces: NDArray, seed: int, S: int = 32, K: int = 768
) -> dict[str, NDArray]:
    """Sources, tangent vectors, traced end points and their masks for one prepared mesh (ours).

    Args:
        vertices, faces: a manifold mesh in the cube, closed or open.
        seed: fixes sources and vectors.
        S: sources, drawn by vertex area among the inner vertices.
        K: vectors a source, even.

    Returns:
        float32 `p` (S, 3), `normal` (S, 3), `v` (S, K, 3), `q` (S, K, 3), `divergence` (S, K)
        and bool `complete`, `shortest` (S, K).
    """
    rng = np.random.default_rng(seed)
    area = vertex_areas(vertices, faces)
    area[_boundary(faces, len(vertices))] = 0
    if (area > 0).sum() < S:
        raise ValueError(f"vertices must have at least S = {S} inner ones, got {(area > 0).sum()}")
    sources = rng.choice(len(vertices), S, replace=False, p=area / area.sum())
    normal = vertex_normals(vertices, faces)[sources]
    v = sample_tangent_vectors(normal, K, RADIUS, rng)
    v = v.astype(np.float32).astype(float)  # exactly what is stored is traced
    q, complete = trace(vertices, faces, sources, v)
    if not np.isfinite(q).all():
        raise ValueError("vertices, faces: a traced geodesic is not finite")
    single = dict(p=vertices[sources], normal=normal, v=v, q=q, divergence=divergence(q, v))
    return {name: x.astype(np.float32) for name, x in single.items()} | {
        "complete": complete,
        "shortest": shortest_mask(vertices, faces, sources, v, q),
    }


def _boundary(faces: NDArray, n: int) -> NDArray[np.int64]:
    half = directed_edges(faces).astype(np.int64)
    key, twin = half[:, 0] * n + half[:, 1], half[:, 1] * n + half[:, 0]
    return np.unique(half[~np.isin(key, twin)])
