"""The place on a shape that is nearest to a point in space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def nearest_on_shape(x: Array, points: Array, faces: NDArray[np.int64] | None) -> Array:
    """(3,) nearest to x (3,): on the triangles of a mesh, or among the points of a cloud."""
    near = (
        points
        if faces is None
        else nearest_on_triangles(x, *(points[faces[:, i]] for i in range(3)))
    )
    return near[np.square(near - x).sum(-1).argmin()]


def nearest_on_triangles(x: Array, a: Array, b: Array, c: Array) -> Array:
    """(M, 3) nearest to x (3,) on each triangle abc, degenerate ones too.

    The foot of the perpendicular where it falls inside, else the nearest place on the three edges.
    """
    edges = np.stack([nearest_on_segments(x, *pair) for pair in ((a, b), (b, c), (c, a))], 1)
    best = np.square(edges - x).sum(-1).argmin(1)
    rim = np.take_along_axis(edges, best[:, None, None], 1)[:, 0]  # (M, 3)
    u, v, w = b - a, c - a, x - a
    uu, uv, vv = (u * u).sum(-1), (u * v).sum(-1), (v * v).sum(-1)
    uw, vw = (u * w).sum(-1), (v * w).sum(-1)
    determinant = uu * vv - uv * uv
    safe = np.where(determinant > 0, determinant, 1)
    s, t = (vv * uw - uv * vw) / safe, (uu * vw - uv * uw) / safe
    inside = (determinant > 0) & (s >= 0) & (t >= 0) & (s + t <= 1)
    return np.where(inside[:, None], a + s[:, None] * u + t[:, None] * v, rim)


def nearest_on_segments(x: Array, a: Array, b: Array) -> Array:
    """(M, 3) nearest to x (3,) on each segment from a to b."""
    along = b - a
    square = np.square(along).sum(-1)
    t = ((x - a) * along).sum(-1) / np.where(square > 0, square, 1)
    return a + t.clip(0, 1)[:, None] * along
