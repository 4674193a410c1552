"""A mesh made ready to be drawn: normals that respect sharp edges, and triangles short enough."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from riemlayer.viz.view import to_numpy, unit

Array = np.ndarray

CREASE = 0.77
"""Cosine of the angle between two faces (40 degrees) from which on their common edge is sharp."""
LIMIT = 400_000
"""Triangles at which `subdivide` stops."""


class Creased(NamedTuple):
    """A mesh whose vertices are doubled where it has sharp edges."""

    vertex: Array
    """(n,) the vertex of the mesh that each drawn vertex is."""
    normals: Array
    """(n, 3) unit"""
    faces: Array
    """(M, 3) drawn vertices."""


def crease(points: Array, faces: Array) -> Creased:
    """Normals by corner: the area-weighted mean over those faces around that are nearly coplanar.

    Example:
        >>> tent = crease(np.eye(4, 3), np.array([[0, 1, 2], [1, 0, 3]]))
        >>> len(tent.vertex), tent.faces.shape
        (6, (2, 3))
    """
    a, b, c = points[faces].transpose(1, 0, 2)
    areas = np.cross(b - a, c - a)
    units = unit(areas)
    corner = faces.ravel()
    order = np.argsort(corner, kind="stable")  # corners, vertex by vertex
    count = np.bincount(corner, minlength=len(points))
    start = np.cumsum(count) - count
    around = count[corner]  # corners at the vertex of each corner
    one = np.repeat(np.arange(len(corner)), around)
    shift = np.arange(len(one)) - np.repeat(np.cumsum(around) - around, around)
    other = order[start[corner[one]] + shift]
    alike = (units[one // 3] * units[other // 3]).sum(-1) >= CREASE
    normals = np.stack(
        [np.bincount(one[alike], areas[other[alike] // 3, i], len(corner)) for i in range(3)], -1
    )
    lost = np.linalg.norm(normals, axis=1) < 1e-300  # faces without an area
    normals = unit(np.where(lost[:, None], [0.0, 0.0, 1.0], normals))
    key = np.column_stack([corner, np.round(normals * 512).astype(np.int64)])
    _, first, index = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return Creased(corner[first], normals[first], index.reshape(-1, 3))


def subdivide(points: Any, faces: Any, longest: float) -> tuple[Array, Array]:
    """The same surface with no edge above `longest`: what a map is sampled on (ours).

    A log map is linear only across triangles that are small beside its radius. Edges are halved, so
    neighbours stay joined; it stops at 400,000 triangles.

    Args:
        points: (N, 3)
        faces: (M, 3)
        longest: length of an edge that may stay.

    Returns:
        Points (N', 3), the given ones first, and faces (M', 3).

    Example:
        >>> points, faces = subdivide([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], longest=0.8)
        >>> len(points), len(faces)
        (6, 4)
    """
    points, faces = to_numpy(points, float), to_numpy(faces, np.int64)
    if not longest > 0:
        raise ValueError(f"`longest` must be positive, got {longest}")
    while len(faces) < LIMIT:
        pairs = np.sort(np.stack([faces, np.roll(faces, -1, 1)], -1), -1)  # (M, 3, 2)
        length = np.linalg.norm(points[pairs[..., 0]] - points[pairs[..., 1]], axis=-1)
        split = length > longest
        if not split.any():
            break
        edges, index = np.unique(pairs[split], axis=0, return_inverse=True)
        middle = np.full(faces.shape, -1)
        middle[split] = len(points) + index.ravel()
        points = np.concatenate([points, points[edges].mean(1)])
        faces = _divided(faces, middle)
    return points, faces


def _divided(faces: Array, middle: Array) -> Array:
    """Faces (M', 3) after the edges with a middle (M, 3), -1 for none, are halved."""
    count = (middle >= 0).sum(1)
    parts = [faces[count == 0]]
    # turn each triangle so that its split edges come first: ab; ab and bc; all
    first = np.where(count == 1, (middle >= 0).argmax(1), ((middle < 0).argmax(1) + 1) % 3)
    turned = (first[:, None] + np.arange(3)) % 3
    faces, middle = np.take_along_axis(faces, turned, 1), np.take_along_axis(middle, turned, 1)
    a, b, c, x, y, z = (*faces.T, *middle.T)
    for n, triangles in {
        1: ((a, x, c), (x, b, c)),
        2: ((a, x, c), (x, y, c), (x, b, y)),
        3: ((a, x, z), (x, b, y), (z, y, c), (x, y, z)),
    }.items():
        parts += [np.stack(abc, 1)[count == n] for abc in triangles]
    return np.concatenate(parts)
