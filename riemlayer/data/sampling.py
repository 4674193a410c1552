"""Points on the surface of a raw mesh: uniform by area, and blue noise."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

CANDIDATES = 8
"""Uniform samples drawn for each point of blue noise."""
START = 0.85
"""First radius of the discs, in distances of the densest packing; random discs fit at 0.75."""
DECAY = 0.97
"""Factor by which the radius shrinks when no further disc fits."""


def sample_surface(vertices: NDArray, faces: NDArray, n: int, rng: np.random.Generator) -> NDArray:
    """n points drawn uniformly by area from the surface, (n, 3) (ours)."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    if not area.sum() > 0:
        raise ValueError("faces must have an area, all of them are degenerate")
    cumulative = np.cumsum(area / area.sum())
    index = np.searchsorted(cumulative, rng.random(n)).clip(max=len(faces) - 1)
    s, t = rng.random((2, n, 1))
    s, t = np.where(s + t > 1, 1 - s, s), np.where(s + t > 1, 1 - t, t)
    return a[index] + s * (b - a)[index] + t * (c - a)[index]


def sample_poisson(vertices: NDArray, faces: NDArray, n: int, seed: int = 0) -> NDArray[np.float64]:
    """n points of blue noise (Poisson discs) on any triangle mesh (Sec. 4, "Raw ShapeNet").

    Dart throwing with a shrinking radius (McCool and Fiume 1992) among uniform samples, so that
    exactly n points come out. Discs are Euclidean: two sheets nearer than a disc share its points.
    The mesh may be non-manifold, self-intersecting or in pieces; only areas count.

    Args:
        vertices, faces: (N, 3) and (m, 3), in any unit.
        n: how many points.
        seed: the same seed gives the same points.

    Raises:
        ValueError: n is not positive, no mesh, or one without area.

    >>> square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    >>> x = sample_poisson(square, np.array([[0, 1, 2], [0, 2, 3]]), 50)
    >>> apart = np.linalg.norm(x[:, None] - x, axis=2) + np.eye(50)
    >>> x.shape, bool((apart > 0.08).all())
    ((50, 3), True)
    """
    from scipy.spatial import KDTree

    from riemlayer.data.meshes import check_mesh

    if n < 1:
        raise ValueError(f"n must be at least 1, got {n}")
    vertices, faces = np.asarray(vertices, float), np.asarray(faces)
    check_mesh(vertices, faces)
    origin, size = vertices.min(0), float(np.ptp(vertices, axis=0).max()) or 1.0
    scaled = (vertices - origin) / size
    a, b, c = (scaled[faces[:, i]] for i in range(3))
    area = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)
    candidates = sample_surface(scaled, faces, CANDIDATES * n, np.random.default_rng(seed))
    radius = START * math.sqrt(2 / math.sqrt(3) * area / n)
    chosen = np.zeros(0, np.int64)
    gap = np.full(len(candidates), np.inf)  # of each candidate to the nearest chosen one
    while True:
        far = np.flatnonzero(gap > radius)
        new = far[_apart(candidates[far], radius)][: n - len(chosen)]
        chosen = np.concatenate([chosen, new])
        if len(chosen) == n:
            return origin + size * candidates[chosen]
        if len(new):
            gap = np.minimum(gap, KDTree(candidates[new]).query(candidates)[0])
        gap[new] = -1.0
        radius *= DECAY


def _apart(points: NDArray, radius: float) -> NDArray[np.bool_]:
    """(m,) bool: which points (m, 3) throwing darts in their order accepts at that radius.

    The lexicographically first maximal independent set, in parallel rounds: a point is in when all
    its earlier neighbours are out.
    """
    from scipy.spatial import KDTree

    accepted, open_ = np.zeros(len(points), bool), np.ones(len(points), bool)
    if not len(points):
        return accepted
    pairs = KDTree(points).query_pairs(radius, output_type="ndarray")  # (E, 2)
    earlier, later = np.sort(pairs, axis=1).T
    while open_.any():
        waits = np.zeros(len(points), bool)
        waits[later] = True
        new = open_ & ~waits
        accepted |= new
        open_ &= ~new
        open_[later[new[earlier]]] = False
        both = open_[earlier] & open_[later]
        earlier, later = earlier[both], later[both]
    return accepted
